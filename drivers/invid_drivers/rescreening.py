"""``screen_cell``: a record of seconds against the accepted model; only what it refutes is measured again."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from invid.comparison.screening import Screening, refit_from, screen, update_model
from invid.config import CellConfig
from invid.errors import NotIdentifiableError
from invid.model.document import Model, parameter_vector
from invid.planning.belief import Belief, from_model
from invid.planning.expected_covariance import Noise, parameter_scale
from invid.planning.goal import GoalPlan, informative_band, plan_for_goal
from invid.recording import Outcome, Recording, read_recording, write_recording
from invid.sweep import Progress
from invid_drivers.measurement import MeasurementResult, measure_to_file

SCREEN_GOAL = 0.01
"""Relative uncertainty that the screening record is laid out for."""
LEAST_GOAL = 5e-4
"""Changed parameters are measured again as well as the accepted model knew them, but not beyond this."""


@dataclass(frozen=True, eq=False)
class Rescreening:
    """Outcome of a screening, and of the measurement that it made necessary."""

    result: MeasurementResult
    screening: Screening
    model: Model | None
    """The accepted model with its changed parts measured again; ``None`` where nothing was."""
    axes: tuple[str, ...] = ()
    band_hz: tuple[float, float] | None = None
    duration_s: float = 0.0
    """Robot time of both measurements [s]."""
    reached: float | None = None
    """Relative standard deviation of the worst changed parameter."""

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            **self.screening.to_json(),
            "duration_s": self.duration_s,
            "remeasured": None
            if self.model is None
            else {
                "axes": list(self.axes),
                "band_Hz": None if self.band_hz is None else list(self.band_hz),
                "parameters": list(self.screening.refuted),
                "worst_relative_std": self.reached,
            },
        }


def screening_plan(config: CellConfig, belief: Belief, noise: Noise) -> GoalPlan:
    """The plan of a screening: one block on all axes."""
    design = plan_for_goal(config, belief, noise, SCREEN_GOAL)
    plan = design.plan.first(design.needed)
    return replace(design, plan=plan, amplitudes=design.amplitudes[: design.needed])


def screen_cell(  # noqa: PLR0913 - what a person may wish of a run
    config: CellConfig,
    model: Model,
    out: Path,
    *,
    noise: Noise,
    goal: float | None = None,
    max_duration_s: float = 120.0,
    progress: Callable[[Progress], None] | None = None,
    stop: threading.Event | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Rescreening:
    """Screen, and measure again what changed; ``out`` then holds the records of both."""
    belief = from_model(model, config)
    design = screening_plan(config, belief, noise)
    result = measure_to_file(config, out, progress=progress, stop=stop, plan=design.plan)
    record = read_recording(out)
    found = screen(record, model)
    tell(found.sentence)
    if found.verdict != "changed" or found.fit is None:
        return Rescreening(result, found, None, duration_s=result.duration_s)
    changed = tuple(a for a in model.axes if any(a in part_axes(p, model.axes) for p in found.parts))
    now = replace(belief, chains=found.fit.chains, source="the screening record")
    wanted = goal if goal is not None else max(LEAST_GOAL, _worst(model, found.refuted))

    def plan_on(axes: tuple[str, ...]) -> tuple[tuple[float, float], GoalPlan]:
        band = informative_band(config, now, noise, found.refuted, axes)
        plan = plan_for_goal(
            config,
            now,
            noise,
            wanted,
            axes=axes,
            names=found.refuted,
            band=band,
            max_duration_s=max_duration_s,
            seed=2,
        )
        return band, plan

    axes = changed
    band, again = plan_on(axes)
    if not again.reachable and len(axes) < len(model.axes):
        # A held axis needs torque for every motion that its neighbours force on it; shaken, it follows.
        every = plan_on(model.axes)
        if every[1].expected.worst[1] < again.expected.worst[1]:
            axes, (band, again) = model.axes, every
    new: list[Model] = []

    def go_on(recording: Recording) -> bool:
        try:
            fit = refit_from(joined(record, recording), now.chains)
        except NotIdentifiableError:
            return True
        new[:] = [update_model(model, found, fit)]
        return _worst(new[0], found.refuted) > wanted

    part = out.with_name(out.name + ".again")
    try:
        second = measure_to_file(config, part, progress=progress, stop=stop, plan=again.plan, go_on=go_on)
        both = joined(record, read_recording(part))
    finally:
        part.unlink(missing_ok=True)
    write_recording(both, out)
    go_on(replace(both, experiments=both.experiments[len(record.experiments) :]))
    if not new:
        raise NotIdentifiableError("the changed parts could not be identified again: identify the cell anew")
    return Rescreening(
        second,
        found,
        new[0],
        axes,
        band,
        result.duration_s + second.duration_s,
        _worst(new[0], found.refuted),
    )


def part_axes(part: str, axes: Sequence[str]) -> tuple[str, ...]:
    """The axis of a branch, the two of a coupling (axis names may hold hyphens)."""
    if part in axes:
        return (part,)
    return next(((a, b) for a in axes for b in axes if f"{a}-{b}" == part), ())


def joined(first: Recording, second: Recording) -> Recording:
    """One recording with the experiments of both, numbered anew."""
    experiments = tuple(
        replace(e, key=f"{k:03d}") for k, e in enumerate((*first.experiments, *second.experiments))
    )
    return replace(first, experiments=experiments, outcome=Outcome.COMPLETED)


def _worst(model: Model, wanted: Sequence[str]) -> float:
    """Largest relative standard deviation of the named parameters."""
    names, _ = parameter_vector(model.chains)
    if model.covariance is None:
        return float("inf")
    std = dict(zip(model.parameter_names, np.sqrt(np.maximum(np.diag(model.covariance), 0.0)), strict=True))
    scale = dict(zip(names, parameter_scale(model.chains), strict=True))
    return max((float(std[n] / scale[n]) for n in wanted), default=0.0)
