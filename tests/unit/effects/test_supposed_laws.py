"""Every law that a search supposes keeps its promises, those of files of their own as well."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from invid.diagnosis.unknown_forces.scoring import bounded_fall
from invid.effects.registry import registered_effects
from invid.effects.supposed_laws import SUPPOSED, SpotMotion, supposed_laws

EFFECTS = Path(__file__).parents[2] / "effects"
FURTHER = [EFFECTS / "quadratic_drag.py", EFFECTS / "end_cushion.py"]


def motions() -> list[SpotMotion]:
    """Two records, one after the other."""
    rng = np.random.default_rng(5)
    out = []
    for start in (3.0, 20.0):
        time = start + np.arange(2001) / 200.0
        lines = 2 * np.pi * np.arange(1, 6) * 0.3
        phase = rng.uniform(0, 6, 5)
        position = 0.2 * np.sin(lines * time[:, None] + phase).sum(axis=1)
        velocity = 0.2 * (lines * np.cos(lines * time[:, None] + phase)).sum(axis=1)
        torque = 4.0 * rng.standard_normal(time.size)
        out.append(SpotMotion(position, velocity, position, time, torque, 500.0, 3.0))
    return out


with registered_effects(FURTHER):
    LAWS = supposed_laws(linear=False)


def test_friction_by_direction_is_told_from_its_parts() -> None:
    law = next(law for law in SUPPOSED if {"dry", "viscous", "offset"} == set(law.beside))
    true = {
        "coulomb_positive": 1.3,
        "coulomb_negative": 0.4,
        "viscous_positive": 0.7,
        "viscous_negative": 0.2,
    }
    parts = np.array([0.25, 0.85, 0.45, 0.45])  # even, dry, viscous, constant
    assert law.parameters(parts, (), 1.0) == pytest.approx(true)
    moved = motions()[0]
    v = moved.velocity
    forward = true["coulomb_positive"] + true["viscous_positive"] * v
    backward = -true["coulomb_negative"] + true["viscous_negative"] * v
    named = parts[0] * law.waves(moved, ())[:, 0] + parts[1] * np.sign(v) + parts[2] * v + parts[3]
    assert named == pytest.approx(np.where(v > 0, forward, backward))


def test_the_fall_within_bounds_is_the_least_square_there() -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        columns, rest = rng.standard_normal((30, 2)), rng.standard_normal(30)
        limits = [(0.0, 0.3), (-np.inf, np.inf)]
        fall = bounded_fall(columns.T @ columns, columns.T @ rest, limits)
        grid = np.linspace(0.0, 0.3, 301)
        best = min(
            float(left @ left - (left @ columns[:, 1]) ** 2 / (columns[:, 1] @ columns[:, 1]))
            for left in (rest + b * columns[:, 0] for b in grid)
        )
        assert fall == pytest.approx(rest @ rest - best, abs=1e-3)
