"""Inner motion and forces that depend on it are brought into agreement where substitution runs away."""

from __future__ import annotations

import warnings
from types import SimpleNamespace

import numpy as np

from invid.effects.laws.sign import clip_law
from invid.likelihood.inner_motion import solve_inner_motion
from invid.numerics.anderson import Secants


class _View(SimpleNamespace):
    def set_inner_motion(self, feedback: np.ndarray, jumps: np.ndarray | None = None) -> None:
        self.feedback = feedback

    def closing_jumps(self, extra: np.ndarray) -> np.ndarray:
        return np.zeros(0)

    def without_response(self, gap: np.ndarray) -> np.ndarray:
        return gap


def _view(lines: int) -> _View:
    base = np.ones((lines, 1), dtype=complex)
    return _View(
        base=base,
        feedback=np.zeros_like(base),
        acting=np.zeros_like(base),
        secants=Secants(),
        jumps=np.zeros(0),
        closing=None,
        may_agree=True,
    )


def test_a_few_directions_that_substitution_blows_up_are_settled() -> None:
    rng = np.random.default_rng(1)
    lines = 60
    gain = np.full(lines, 0.1, dtype=complex)
    gain[[7, 8, 30]] = [-6.0, 9.0j, -3.0 + 2.0j]  # clamped resonances: plain substitution diverges
    driven = rng.normal(size=lines) + 1j * rng.normal(size=lines)
    exact = driven / (1.0 - gain)
    view = _view(lines)

    def forces() -> tuple[np.ndarray, np.ndarray]:
        motion = view.feedback[:, 0]
        back = (driven + gain * motion)[:, None]
        return 2.0 * back, back

    total = solve_inner_motion(view, forces, 12)
    assert np.abs(view.feedback[:, 0] - exact).max() < 1e-3 * np.abs(exact).max()
    assert np.abs(total[:, 0] - 2.0 * exact).max() < 2e-2 * np.abs(exact).max()


def test_what_cannot_be_settled_ends_at_the_least_disagreement_and_stays_finite() -> None:
    view = _view(4)

    def forces() -> tuple[np.ndarray, np.ndarray]:
        back = 50.0 * (view.feedback + 1.0) ** 3
        return back, back

    with warnings.catch_warnings():
        warnings.simplefilter("error")  # NumPy's words about overflow reached the technician's terminal
        total = solve_inner_motion(view, forces, 12)
    assert np.isfinite(total).all()
    assert np.isfinite(view.feedback).all()


def test_a_gap_that_is_crossed_within_a_sample_has_the_mean_of_what_happens_between() -> None:
    # A triangle crosses ±0.5 between its samples; finer samples of the same triangle are the truth.
    coarse = np.array([-4.0, -1.3, 1.4, 4.1, 1.4, -1.3])
    fine = np.interp(np.arange(0, 6, 1 / 200), np.arange(7), np.append(coarse, coarse[0]))
    clipped = np.clip(fine, -0.5, 0.5)
    around = [np.mean(np.roll(clipped, 200 - 200 * k)[:400]) for k in range(6)]
    assert np.abs(clip_law(coarse, 0.5) - around).max() < 5e-3


def test_more_directions_than_are_remembered_are_settled_by_newtons_steps() -> None:
    """Every line below the resonance of a load behind a gap runs away, not one or two."""
    rng = np.random.default_rng(2)
    lines = 80
    gain = np.full(lines, 0.05, dtype=complex)
    gain[:40] = rng.uniform(1.5, 6.0, 40) * np.exp(2j * np.pi * rng.uniform(size=40))
    driven = rng.normal(size=lines) + 1j * rng.normal(size=lines)
    view = _view(lines)

    def forces() -> tuple[np.ndarray, np.ndarray]:
        motion = view.feedback[:, 0]
        back = (driven + gain * motion + 0.02 * np.abs(motion) * motion)[:, None]
        return back, back

    solve_inner_motion(view, forces, 12)
    rest = forces()[1] - view.feedback
    assert np.abs(rest).max() < 1e-3 * np.abs(view.feedback).max()
