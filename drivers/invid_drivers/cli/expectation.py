"""What a dry run says of the uncertainty to expect, as one document and as text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from invid.config import CellConfig
from invid.model.diagnosis_document import load_model
from invid.model.document import units
from invid.planning import Plan
from invid.planning.belief import Belief, from_model, guess
from invid.planning.detection import DetectionLimit, detection_limits
from invid.planning.expected_covariance import Expected, Noise, expected

NOTHING = (
    "no expected uncertainty: neither --model nor an inertia (inertia_kgm2, mass_kg) for every axis in the "
    "config; after a first identification give its model"
)


def belief_of(config: CellConfig, model: Path | None) -> Belief | None:
    """The plant by the last model, or a guess that says so; ``None`` where there is nothing to guess from."""
    if model is None:
        return guess(config)
    return from_model(load_model(model), config, source=f"the model {model}")


def expectation(config: CellConfig, plan: Plan, belief: Belief | None, noise: Noise) -> Expected | None:
    """Expected covariance of a plan; ``None`` where there is no belief or nothing to identify from."""
    if belief is None or not any(e.role == "identify" and e.frequencies_hz.size for e in plan.recorded):
        return None
    return expected(config, plan, belief, noise)


def limits_of(
    config: CellConfig, plan: Plan, belief: Belief | None, noise: Noise
) -> tuple[DetectionLimit, ...]:
    """Sizes of causes that a plan is expected to show; empty where there is nothing to foretell by."""
    periodic = [e for e in plan.recorded if e.frequencies_hz.size]
    return detection_limits(config, periodic, belief, noise) if belief is not None and periodic else ()


def limits_text(limits: Sequence[DetectionLimit]) -> str:
    """Detection limits as text for a person."""
    lines = ["  the smallest that it would show, with 95 % probability (of interest):"]
    for cause in dict.fromkeys(limit.cause for limit in limits):
        own = [limit for limit in limits if limit.cause == cause]
        sizes = [
            f"{limit.axis} {limit.size:.2g} ({limit.interest:.2g})"
            if np.isfinite(limit.size)
            else f"{limit.axis} not seen"
            for limit in own
        ]
        lines.append(f"    {cause.replace('_', ' '):<18}{', '.join(sizes)} {own[0].unit}")
    return "\n".join(lines)


def expected_text(found: Expected, *, linear: bool) -> str:
    """Expected standard deviations as text for a person."""
    unit = units(linear)
    of = {
        "mass": unit["mass"],
        "spring": unit["stiffness"],
        "damper": unit["damping"],
        "coupling": unit["mass"],
    }
    of["ground_spring"] = unit["stiffness"]
    lines = [
        f"  expected standard deviations, from {found.belief}; noise {found.noise}",
        f"  {'parameter':<18}{'value':>10}  {'± std':<10}{'relative':>9}  unit",
    ]
    for name, value, std, relative in zip(found.names, found.values, found.std, found.relative, strict=True):
        kind = next(k for k in of if k in name)
        shown = (f"{std:.2g}", f"{100 * relative:.2g} %") if np.isfinite(std) else ("not seen", "")
        lines.append(f"  {name:<18}{value:>10.4g}  {shown[0]:<10}{shown[1]:>9}  {of[kind]}")
    name, worst = found.worst
    figure = f"{100 * worst:.2g} %" if np.isfinite(worst) else "not seen by this plan"
    lines.append(f"  worst of masses, springs and couplings: {name}, {figure}")
    return "\n".join(lines)
