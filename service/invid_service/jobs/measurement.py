"""Run a job's measurement: check, wait to be armed, move, record."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from invid.config import CellConfig
from invid.errors import ConfigError
from invid.model.document import model_from_json
from invid.planning import Plan
from invid.planning.belief import Belief, from_model
from invid_drivers.foretelling import sensor_noise
from invid_drivers.goal import Reached, judge_of
from invid_drivers.measurement import measure_to_file
from invid_drivers.readiness import ask, loads_to_support, support_sentence
from invid_drivers.screening import screening_plan
from invid_drivers.stopping_budgets import Wish
from invid_service.jobs.analysis_progress import BEGINS
from invid_service.jobs.line import Line, plain
from invid_service.jobs.protocol import Job, Known, Measured, Planned, Progress, Running

_SETTLED_S = 2.0
"""Robot time after which the pace of the motion so far says how long the rest takes."""


class Pace:
    """Estimate of the time left by the clock: a simulated cell runs ahead of the plan, a busy one behind."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._first: tuple[float, float] | None = None

    def left(self, planned_s: float) -> float:
        """Return the seconds left by the clock where the plan has ``planned_s`` left."""
        now = self._clock()
        if self._first is None:
            self._first = now, planned_s
        began, whole = self._first
        done = whole - planned_s
        return planned_s * (now - began) / done if done > _SETTLED_S else planned_s


def measure(job: Job, line: Line) -> dict[str, Any]:
    """Check, wait to be armed, move and write ``recording.h5``; return what was seen meanwhile."""
    if job.config is None:
        raise ConfigError("the job has no configuration")
    config = CellConfig.model_validate(job.config)
    accepted = None if job.model is None else model_from_json(job.model, source="accepted model")
    if accepted is not None and accepted.axes != tuple(a.name for a in config.axes):
        accepted = None
    model = None if accepted is None else from_model(accepted, config, source="the accepted model")
    short = _short_plan(config, model, job.amplitude_scale) if job.mode == "screen" else None
    wish = Wish(job.axes, job.amplitude_scale, model, short)
    found = ask(config, wish).require()
    document = {**told_plan(found.plan, job), "budgets": [b.to_json() for b in found.budgets]}
    support = loads_to_support(config)
    document["support"] = {"axes": list(support), "text": support_sentence(support)} if support else None
    document["warnings"] = [*document["warnings"], *found.said]
    line.tell(Planned(plan=plain(document), arm=job.arm))
    del found
    while not (job.arm or line.armed.is_set()):
        line.stop.wait(0.05)
        line.check_stop()
    line.check_stop()
    line.tell(Running())
    target = job.folder / "recording.h5"

    pace, known = Pace(), list[Known]()

    def tell(found: Reached) -> None:
        if found.trustworthy and math.isfinite(found.relative):
            known.append(Known(relative_std=found.relative, shown=found.shown, asked=len(found.limits)))

    def progress(p: Any) -> None:
        left = pace.left(float(p.eta_s))
        after = job.expected_analysis_s
        line.progress(
            Progress(
                fraction=float(p.fraction) * BEGINS,
                phase=str(p.phase),
                axis=p.axis,
                frequency=p.frequency,
                eta_s=None if after is None else left + after,
                motion_left_s=left,
                known=known[-1] if known else None,
            )
        )

    result = measure_to_file(
        config,
        target,
        wish,
        progress=progress,
        stop=line.stop,
        judge=None if short else judge_of(config, tell),
    )
    line.check_stop()
    seen: dict[str, Any] = plain(result.to_json())
    del seen["recording"]
    line.tell(Measured(measurement=seen))
    return seen


def _short_plan(config: CellConfig, model: Belief | None, amplitude_scale: float) -> Plan:
    """Return the plan of a screening."""
    if model is None:
        raise ConfigError("there is no accepted model of these axes, so nothing can have changed since it")
    return screening_plan(config, model, sensor_noise(config), amplitude_scale=amplitude_scale).plan


def told_plan(plan: Plan, job: Job) -> dict[str, Any]:
    """Return the plan as a person sees it before arming, with what was chosen for this run."""
    document: dict[str, Any] = plain(plan.to_json())
    said = []
    if job.amplitude == "gentler":
        said.append("gentler: every torque is half of what would be planned")
    if job.purpose is not None:
        said.append(job.purpose)
    return {
        **document,
        "amplitude": job.amplitude,
        "purpose": job.purpose,
        "warnings": [*said, *document["warnings"]],
    }
