"""Inner motion that a force makes on lines above those in use."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from invid.effects.laws.beyond_band import LEAST_DIFFERENCE, beyond_band, motion_of_force, solve_beyond_band
from invid.model.parameters import ChainStructure
from invid.model.place import mass_places, spring_places

MASSES, SPRINGS = (0.05, 0.12, 0.3), (700.0, 500.0)
LAST, SAMPLES, STEP = 80, 512, 1.0 / 512.0


class _View(SimpleNamespace):
    def set_hidden_motion(self, pattern: Any, lines: np.ndarray | None) -> None:
        self.hidden = lines


def _view(*, transient: bool = False) -> Any:
    record = SimpleNamespace(
        transient=transient,
        lines=np.arange(LAST + 1),
        wave_omega=2 * np.pi * np.fft.rfftfreq(SAMPLES, STEP),
    )
    return _View(
        record=record,
        structure=ChainStructure((3,), ("A1",), viscous=False, grounded=()),
        springs=np.array(SPRINGS),
        masses=np.array(MASSES),
    )


def _exact(pattern: Any, omega: np.ndarray) -> np.ndarray:
    """bᵀ Z⁻¹ b of the whole chain, its motor free."""
    masses, springs = np.diag(MASSES), np.zeros((3, 3))
    for q, k in enumerate(SPRINGS):
        b = np.zeros(3)
        b[q], b[q + 1] = 1.0, -1.0
        springs += k * np.outer(b, b)
    along = np.zeros(3)
    for at, sign in pattern:
        along[at] = sign
    return np.array([along @ np.linalg.solve(springs - w**2 * masses, along) for w in omega])


@pytest.mark.parametrize("place", [*spring_places(_view().structure), *mass_places(_view().structure)[1:]])
def test_it_is_that_of_the_chain_above_its_modes(place: Any) -> None:
    view = _view()
    found = beyond_band(view, place)
    assert found is not None
    assert not found[: LAST + 1].any()
    omega = view.record.wave_omega[LAST + 40 :]
    exact = _exact(place.pattern(view.structure), omega)
    assert np.abs(found[LAST + 40 :] - exact).max() < 0.05 * np.abs(exact).max()


def test_motors_are_measured() -> None:
    assert beyond_band(_view(), mass_places(_view().structure)[0]) is None


def test_a_jump_between_the_ends_of_a_record_that_does_not_close_does_not_ring() -> None:
    view = _view(transient=True)
    compliance = beyond_band(view, spring_places(view.structure)[0])
    assert compliance is not None
    time = np.arange(SAMPLES) * STEP
    wave = np.sin(2 * np.pi * 150 * time)
    moved = motion_of_force(view, compliance, wave + 5.0 * time / time[-1])
    assert np.abs(moved - motion_of_force(view, compliance, wave)).max() < 1e-3 * np.abs(moved).max()


def test_nothing_is_said_next_to_a_resonance() -> None:
    view = _view()
    view.springs = np.array([7e4, 500.0])  # 36 Hz becomes 212 Hz, beyond the band
    place = spring_places(view.structure)[0]
    found = beyond_band(view, place)
    assert found is not None
    inertia = view.record.wave_omega**2 / (1 / MASSES[0] + 1 / MASSES[1])
    near = np.abs(7e4 - inertia) < LEAST_DIFFERENCE * np.maximum(7e4, inertia)
    assert near.any()
    assert not found[near].any()
    assert np.isfinite(found).all()


def test_force_and_motion_agree_within_an_eighth_and_the_view_is_left_as_it_was() -> None:
    view = _view()
    place = spring_places(view.structure)[0]
    compliance = beyond_band(view, place)
    assert compliance is not None
    time = np.arange(SAMPLES) * STEP
    seen = 0.02 * (np.sin(2 * np.pi * 60 * time) + np.sin(2 * np.pi * 71 * time))
    pattern = place.pattern(view.structure)

    def resisting() -> np.ndarray:
        hidden = getattr(view, "hidden", None)
        d = seen if hidden is None else seen + np.fft.irfft(hidden, SAMPLES)
        return 4e5 * d**3

    def off(wave: np.ndarray) -> float:
        own = 4e5 * (seen - np.fft.irfft(compliance * np.fft.rfft(wave), SAMPLES)) ** 3
        return float(np.linalg.norm(own - wave))

    before = off(resisting())
    wave = solve_beyond_band(view, pattern, compliance, resisting)
    assert off(wave) < before / 6.0
    assert view.hidden is None
