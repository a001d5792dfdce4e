"""The hidden plant itself: physics with known answers, so that a failure of the diagnosis is its own."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.causes import CATALOGUE, OUTSIDE
from hidden.generator import make, make_case
from hidden.integrator import Law, integrate
from hidden.measurement import excess_db
from hidden.plants import random_plant
from hidden.setup import draw_setup

H = 1e-4


def march(
    mass: float,
    stiffness: float,
    laws: list[tuple[Law, tuple[float, ...]]],
    *,
    x: float = 0.0,
    v: float = 0.0,
    force: float | np.ndarray = 0.0,
    steps: int = 20_000,
) -> tuple[np.ndarray, np.ndarray]:
    """One mass on a spring to ground; position and commanded torque at every step."""
    load, still = np.atleast_1d(force).reshape(-1, 1).astype(float), np.zeros((1, 1))
    position, torque, _, _ = integrate(
        steps, 1, H, np.array([[1 / (2 * mass + 0.5 * H * H * stiffness)]]), np.array([[2 * mass]]),
        np.array([[stiffness]]), np.array([0]), load, still, still,
        np.zeros(1), np.zeros(1), False, np.array([x]), np.array([v]),
        np.array([int(law) for law, _ in laws]), np.zeros(len(laws), dtype=np.int64),
        np.full(len(laws), -1), np.array([list(p) + [0.0] * (4 - len(p)) for _, p in laws]).reshape(-1, 4),
        0.0, steps, 0,
    )  # fmt: skip
    return position[:, 0], torque[:, 0]


def test_a_sliding_mass_stops_where_work_says_and_stays() -> None:
    position, _ = march(2.0, 0.0, [(Law.DRY, (3.0, 3.0, 0.0, 0.0))], v=1.5)
    assert position[-1] == pytest.approx(0.5 * 2.0 * 1.5**2 / 3.0, rel=1e-3)
    assert np.ptp(position[-1000:]) == 0.0


def test_a_force_below_the_dry_friction_moves_nothing_and_one_above_does() -> None:
    stuck, _ = march(2.0, 0.0, [(Law.DRY, (3.0, 3.0, 0.0, 0.0))], force=2.9)
    assert np.ptp(stuck) == 0.0
    moved, _ = march(2.0, 0.0, [(Law.DRY, (3.0, 3.0, 0.0, 0.0))], force=4.0)
    assert moved[-1] == pytest.approx(0.5 * (4.0 - 3.0) / 2.0 * 2.0**2, rel=1e-3)


def test_static_friction_holds_what_moving_friction_would_not() -> None:
    stribeck = [(Law.STRIBECK, (3.0, 2.0, 0.01))]
    assert np.ptp(march(1.0, 0.0, stribeck, force=2.5)[0]) == 0.0
    assert march(1.0, 0.0, stribeck, force=2.5, v=1.0)[0][-1] > 2.0


def test_an_undamped_mass_on_a_spring_keeps_its_energy_and_frequency() -> None:
    position, _ = march(2.0, 200.0, [], x=1.0)
    t = np.arange(position.size) * H
    np.testing.assert_allclose(position, np.cos(10.0 * t), atol=2e-5)


def test_an_impact_gives_its_impulse() -> None:
    position, _ = march(2.0, 0.0, [(Law.IMPACT, (1.0, 0.5, 0.02))], v=1.0)
    speed = np.diff(position)[-1] / H
    assert speed == pytest.approx(1.0 - 1.0 / 2.0, rel=0.02)


def test_a_late_torque_acts_late_by_the_delay_and_the_record_does_not_show_it() -> None:
    pulse = np.zeros(10_000)
    pulse[2000:2100] = 1.0
    late, torque = march(1.0, 0.0, [(Law.DELAY, (0.05,))], force=pulse, steps=10_000)
    np.testing.assert_array_equal(torque, pulse)
    assert np.ptp(late[:2500]) == 0.0
    prompt, _ = march(1.0, 0.0, [], force=pulse, steps=10_000)
    np.testing.assert_allclose(late[2500:], prompt[2000:-500], atol=1e-9)


def test_null_data_leave_nothing_beside_the_integrators_own_error() -> None:
    for seed in (1, 2, 3):
        rng = np.random.default_rng(seed)
        setup = draw_setup(rng, random_plant(rng, ("A1", "A2"), (2, 3)))
        assert excess_db(setup, ()) < -25


def test_a_seed_is_a_case_bit_for_bit() -> None:
    first, again = make_case(6), make_case(6)
    assert first[1].effects == again[1].effects
    for a, b in zip(first[0].experiments, again[0].experiments, strict=True):
        np.testing.assert_array_equal(a.position, b.position)
        np.testing.assert_array_equal(a.torque, b.torque)


def test_sizes_hit_the_decibels_asked_for() -> None:
    for cause in ("coulomb_friction", "backlash", "torque_lag", "coupling_stiffness"):
        _, truth = make(cause, seed=21, motors=2, masses=(2, 2), target_db=20.0)
        assert truth.db == pytest.approx(20.0, abs=3.0), cause


@pytest.mark.parametrize("cause", sorted(CATALOGUE | OUTSIDE))
def test_every_cause_makes_a_finite_record(cause: str) -> None:
    recording, truth = make(cause, seed=31, motors=2, masses=(2, 2), target_db=15.0, periods=2)
    assert truth.effects[0].cause == cause
    for e in recording.experiments:
        assert np.isfinite(e.position).all()
        assert np.isfinite(e.torque).all()
        assert np.abs(e.position).max() < 20.0
