"""Nothing is sure where a record does not show what its sensors' noise alone would leave."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import two_masses

from invid.diagnosis.diagnose import diagnose
from invid.diagnosis.limits.floor_doubts import doubt_floors
from invid.model.diagnosis_document import Finding, Verdict, diagnosis_from_json, diagnosis_to_json
from invid.model.document import EffectTerm, Estimate
from invid.recording.model import Experiment, Role


def _pair(make: Callable[[Experiment, int], Experiment]) -> list[Experiment]:
    roles = (Role.IDENTIFY, Role.VALIDATE)
    return [make(two_masses.from_rest(k, role, f"{k:03d}"), k) for k, role in enumerate(roles)]


@pytest.mark.campaign
def test_scatter_between_periods_is_no_floor() -> None:
    """A torque that no two periods share stood in the floor, and nothing was missing beneath it."""

    def rough(e: Experiment, seed: int) -> Experiment:
        rng = np.random.default_rng(seed)
        bins = np.zeros(two_masses.PERIOD // 2 + 1, complex)
        lines = np.arange(1, 120, 2)
        bins[lines] = np.exp(2j * np.pi * rng.random(lines.size)) * two_masses.PERIOD / 5
        asked = np.tile(np.fft.irfft(bins), 6)
        push = np.repeat(rng.standard_normal(asked.size // 32), 32)
        position, torque = two_masses.held(asked, two_masses.STEP, two_masses.HOLD, rate=1.0, beside=push)
        noisy = torque + two_masses.NOISE * rng.standard_normal(torque.size)
        time = np.arange(asked.size) * two_masses.STEP
        columns = (c[:, None] for c in (position, noisy, torque))
        return replace(
            e, time=time, **dict(zip(("position", "torque", "torque_demand"), columns, strict=True))
        )

    found = diagnose(two_masses.recording(*_pair(rough)))
    (left,) = found.residual
    # The sensors' own, or none where a search that was cut short has not found out what they are.
    assert left.noise_floor is None or left.noise_floor < 0.1 * left.after
    assert found.verdict in (Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED)
    assert all(f.confidence <= 0.5 for f in found.findings)
    unknown = replace(found, residual=(replace(left, noise_floor=None),))
    assert diagnosis_from_json(diagnosis_to_json(unknown)).residual[0].noise_floor is None


def test_a_floor_that_is_scatter_is_none_and_what_stands_on_it_is_in_doubt(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recording = two_masses.recording(*_pair(lambda e, _: e))
    torque = {"torque": Estimate(0.4, 0.01, "N·m")}
    sure = Finding(EffectTerm("coulomb_friction", "A1", torque, "mass 1"), 0.99, 1.0, 0.1, 0.9)
    found = replace(diagnose(recording), findings=(sure,))
    state = SimpleNamespace(dof=1000, cost=1000.0, held=None)
    monkeypatch.setattr("invid.diagnosis.limits.floor_doubts.scatter_share", lambda held, axis: 0.6)
    doubted = doubt_floors(found, SimpleNamespace(final=state, base=state), recording)  # type: ignore[arg-type]
    assert doubted.residual[0].noise_floor is None
    assert [f.confidence for f in doubted.findings] == [0.5]
    assert any("scatters from period to period" in w for w in doubted.warnings)


def test_one_short_period_makes_nothing_sure() -> None:
    def cut(e: Experiment, _: int) -> Experiment:
        columns = ("time", "position", "torque", "torque_demand")
        return replace(e, **{name: getattr(e, name)[: two_masses.PERIOD] for name in columns})

    found = diagnose(two_masses.recording(*_pair(cut)))
    assert found.residual[0].noise_floor is None
    assert all(f.confidence <= 0.5 for f in found.findings)
    assert "likely, not certain" in found.headline
    assert "nicht sicher" in found.headlines["de"]


def test_records_that_repeat_to_their_sensors_noise_keep_their_floor() -> None:
    found = diagnose(two_masses.recording(*_pair(lambda e, _: e)))
    assert found.residual[0].noise_floor is not None
    assert "not certain" not in found.headline
