"""Every law that a search supposes keeps its promises, those of files of their own as well."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from invid.diagnosis.unknown_forces.scoring import bounded_fall, spots_of
from invid.effects.registry import CATALOGUE, registered_effects
from invid.effects.supposed_laws import SUPPOSED, SpotMotion, SupposedLaw, supposed_laws
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.plant import Structure

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


@pytest.mark.parametrize("law", LAWS, ids=lambda law: f"{type(law).__name__} {law.cause}")
def test_a_law_has_waves_bounds_and_parameters_that_fit_each_other(law: SupposedLaw) -> None:
    moved = motions()
    bounds = law.bounds(moved)
    shapes = law.shapes(moved)
    assert shapes
    for shape in shapes:
        waves = law.waves(moved[0], shape)
        assert waves.shape == (moved[0].time.size, len(law.low))
        assert np.isfinite(waves).all()
        assert len(bounds) == len(shape)
        for value, (low, high) in zip(shape, bounds, strict=True):
            assert low - 1e-9 <= value <= high + 1e-9
    assert len(law.limits(moved)) == len(law.low)
    sizes = np.ones(len(law.low) + len(law.beside))
    names = {*law.parameters(sizes, shapes[0], 500.0), *([law.counts] if law.counts else [])}
    assert names == set(law.effect.parameters) - set(law.effect.optional)
    assert {Part(p) for p in (*law.covers, *law.beside)} <= set(Part)


def test_every_law_stands_where_its_cause_may_and_those_of_one_cause_share_its_places() -> None:
    structure = Structure((1, 3, 2))
    for cause in {law.cause for law in LAWS}:
        spots = [s for law in LAWS if law.cause == cause for s in spots_of(law, structure)]
        assert spots
        assert len(set(spots)) == len(spots)


def test_linear_axes_have_no_law_of_the_angle() -> None:
    linear = {law.cause for law in supposed_laws(linear=True)}
    rotary = {e.cause for e in CATALOGUE if e.rotary}
    assert not linear & rotary
    assert {law.cause for law in SUPPOSED} - linear == rotary & {law.cause for law in SUPPOSED}


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
