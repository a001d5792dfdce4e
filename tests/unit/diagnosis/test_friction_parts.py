"""Which laws a motor's friction is said to consist of, judged on motions with a friction made here."""

from __future__ import annotations

import numpy as np

from invid.diagnosis.rules.friction_parts import friction_parts
from invid.model.place import Place

MOTOR = Place("mass", 0, 1)
ROWS, NOISE = 4000, 0.45
WIDTH, SLOW = 0.01, 0.2


def named(
    seed: int, *, dry: float = 0.0, viscous: float = 0.0, rise: float = 0.0
) -> dict[str, tuple[float, float]]:
    """The causes named from the least-squares fit of the whole law to a noisy friction torque, each with its
    first parameter and the deviation of that beside plain dry and viscous friction."""
    rng = np.random.default_rng(seed)
    v = 0.3 * np.sin(rng.uniform(0, 2 * np.pi, ROWS)) + 0.2 * np.sin(rng.uniform(0, 2 * np.pi, ROWS))
    sign, bend = np.tanh(v / WIDTH), np.exp(-((v / SLOW) ** 2))
    torque = (dry + rise * bend) * sign + viscous * v + NOISE * rng.standard_normal(ROWS)
    parts = np.column_stack([sign, v, sign * bend, sign**2, np.abs(v), sign**2 * bend])
    size = np.linalg.lstsq(parts, torque, rcond=None)[0]
    shapes = np.column_stack(
        [
            size[2] * sign * bend * 2.0 * (v / SLOW) ** 2,
            -(size[0] + size[2] * bend) * (1.0 - sign**2) * v / WIDTH,
        ]
    )
    columns = np.hstack([parts, shapes])
    x = np.concatenate((size, np.log([SLOW, WIDTH])))
    found = friction_parts(x, NOISE**2 * np.linalg.inv(columns.T @ columns), MOTOR)
    dry_std, viscous_std = NOISE * np.sqrt(np.diag(np.linalg.inv(parts[:, :2].T @ parts[:, :2])))
    std = {"viscous_friction": float(viscous_std)}
    return {t.effect.cause: (float(v[0]), std.get(t.effect.cause, float(dry_std))) for t, v in found}


def test_viscous_friction_of_eight_deviations_is_named_beside_dry_friction_in_every_run() -> None:
    """In the whole law its deviation is five times as large, and it passes for a part of the rise."""
    errors = []
    for seed in range(100):
        found = named(seed, dry=0.4, viscous=0.4)
        assert found.keys() == {"coulomb_friction", "viscous_friction"}
        errors += [(value - 0.4) / std for value, std in found.values()]
    assert 0.8 < np.std(errors) < 1.2
    assert abs(np.mean(errors)) < 0.25


def test_dry_friction_alone_is_named_alone() -> None:
    """In a thousandth of the runs a part that is not there counts as significant, of three parts that may."""
    more = sum(named(seed, dry=0.4).keys() != {"coulomb_friction"} for seed in range(300))
    assert more <= 3


def test_a_rise_at_slow_speed_is_named_where_no_viscous_friction_hides_it() -> None:
    assert all(named(seed, dry=0.4, rise=0.3).keys() == {"stribeck_friction"} for seed in range(50))


def test_no_friction_is_named_where_there_is_none() -> None:
    assert sum(bool(named(seed)) for seed in range(300)) <= 3
