"""Records as others write them: what they do not say, or say wrongly, must not give a small wrong error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_cell import LinearCell, deviations, record

from invid.diagnosis.diagnose import diagnose
from invid.identification.identify import identify
from invid.signals.spectra import all_spectra

ONE = LinearCell([[1.0, 2.0]], [[1500.0]], [[0.8]])
TWO = LinearCell([[1.0, 2.0], [1.5, 2.5]], [[1500.0], [2500.0]], [[0.8], [1.0]], {(0, 1): 0.4})
SUMS = np.array([3.0, 4.0])


def hold(hz: float, ratio: float, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gains P and D of a position hold of so many hertz."""
    w = 2 * np.pi * hz
    return sums * w**2, 2 * ratio * sums * w


def worst(found: dict[str, float]) -> float:
    return max(abs(z) for z in found.values())


@pytest.mark.campaign
def test_a_low_passed_torque_channel_is_recognised_and_costs_no_parameter() -> None:
    recording = record(
        TWO, seed=5, rate=1000.0, gain=20 * SUMS, damping=5 * SUMS, said=20 * SUMS, in_drive=False,
        time_constant=0.002, period=8000,
    )  # fmt: skip
    model = identify(recording)
    assert model.fit["trustworthy"]
    # 4.5 standard deviations: one false alarm in fifteen thousand runs of nine parameters
    assert worst(deviations(model, TWO)) < 4.5
    assert model.fit["torque_lag_s"]["A1"]["value"] == pytest.approx(0.002, rel=0.05)
    assert any("A1: the recorded torque is low-passed" in w for w in model.warnings)


def test_a_stiff_hold_that_the_file_denies_widens_the_motor_mass() -> None:
    gain, damping = hold(5.0, 0.7, SUMS[:1])
    model = identify(record(ONE, seed=7, rate=500.0, gain=gain, damping=damping, said=np.zeros(1)))
    # The sampled hold's damping is 13 % of the motor's mass.
    assert worst(deviations(model, ONE)) < 4.5


@pytest.mark.parametrize("in_drive", [True, False])
def test_a_demand_with_the_hold_in_it_does_not_tell_when_the_hold_acts(in_drive: bool) -> None:
    """Read at the end of its sample a command acts half a sample early and a hold inside the drive does not:
    D·h/2 was in the motor's mass, 260 deviations."""
    gain, damping = hold(1.5, 0.7, SUMS[:1])
    shown = record(
        ONE, seed=9, rate=1000.0, gain=gain, damping=damping, said=gain, in_drive=in_drive, demand_at_end=True
    )
    model = identify(shown)
    assert worst(deviations(model, ONE)) < 4.5
    if in_drive:
        return
    by_master = tuple(replace(e, attributes={"hold_by": "master"}) for e in shown.experiments)
    told = identify(replace(shown, experiments=by_master))
    assert worst(deviations(told, ONE)) < 4.5
    assert told.std.masses[0][0] < 0.3 * model.std.masses[0][0]


@pytest.mark.campaign
def test_holds_that_no_record_shows_cost_the_motors_of_uncoupled_axes_nothing_unsaid() -> None:
    """A held axis rests while others are shaken; D·h/2 of its hold was in its motor's mass, 45 deviations."""
    apart = LinearCell(TWO.masses, TWO.springs, TWO.dampers)
    gain, damping = hold(1.0, 0.7, SUMS)
    recording = record(
        apart,
        seed=8,
        rate=500.0,
        gain=gain,
        damping=damping,
        said=np.full(2, np.nan),
        together=False,
        period=3000,
    )
    experiments = tuple(replace(e, excited_axis=i) for i, e in enumerate(recording.experiments))
    recording = replace(recording, experiments=experiments)
    model = identify(recording)
    assert worst(deviations(model, apart)) < 4.5
    found = diagnose(recording, model=model)
    assert found.findings == ()
    assert worst(deviations(found.model, apart)) < 4.5
    assert found.model.std.masses[0][0] < 0.03 * apart.masses[0][0]


@pytest.mark.parametrize("rate", [1000.0])
def test_axes_shaken_one_at_a_time_without_being_named_are_told_from_those_held(rate: float) -> None:
    gain, damping = hold(2.0, 0.7, SUMS)
    recording = record(
        TWO, seed=11, rate=rate, gain=gain, damping=damping, said=np.full(2, np.nan), together=False
    )
    assert [s.driven.tolist() for s in all_spectra(recording)] == [[True, False], [False, True]]
    model = identify(recording)
    assert worst(deviations(model, TWO)) < 4.5
