"""Run a job's measurement: check, wait to be armed, move, record."""

from __future__ import annotations

import math
from typing import Any

from invid.config import CellConfig
from invid.errors import ConfigError
from invid.model.document import model_from_json
from invid.planning import Plan
from invid.planning.belief import Belief, from_model
from invid.planning.goal import Reached, judge_of
from invid.planning.screening import screening_plan
from invid.wording.sentence import sentence
from invid_drivers.measurement import measure_to_file
from invid_drivers.protocol import AxisStates
from invid_drivers.readiness import ask, loads_to_support, support_sentence
from invid_drivers.simulated.config import sensor_noise
from invid_drivers.stopping_budgets import Wish
from invid_service.jobs.folder import LastWords
from invid_service.jobs.progress import MotionProgress
from invid_service.jobs.protocol import Job, Known, Measured, Planned, RunnerLine, Running, plain


def measure(job: Job, line: RunnerLine) -> dict[str, Any]:
    """Check, wait to be armed, move and write ``recording.h5``; return what was seen meanwhile."""
    if job.config is None:
        raise ConfigError("the job has no configuration")
    config = CellConfig.model_validate(job.config)
    accepted = None if job.model is None else model_from_json(job.model, source="accepted model")
    if accepted is not None and accepted.axes != tuple(a.name for a in config.axes):
        accepted = None
    model = None if accepted is None else from_model(accepted, config, source=sentence("the accepted model"))
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

    def seen(states: AxisStates) -> None:
        line.tell(states)
        LastWords(states).write(job.folder)

    shown = MotionProgress(line, job.expected_analysis_s)

    def reached(found: Reached) -> None:
        if found.trustworthy and math.isfinite(found.relative):
            shown.known = Known(relative_std=found.relative, shown=found.shown, asked=len(found.limits))

    with shown.told():
        result = measure_to_file(
            config,
            target,
            wish,
            progress=shown.moved,
            seen=seen,
            stop=line.stop,
            judge=None if short or job.tuning else judge_of(config, reached),
        )
    line.check_stop()
    LastWords(end="the measurement was complete").write(job.folder)
    measured: dict[str, Any] = plain(result.to_json())
    del measured["recording"]
    line.tell(Measured(measured))
    return measured


def _short_plan(config: CellConfig, model: Belief | None, amplitude_scale: float) -> Plan:
    """Return the plan of a screening."""
    if model is None:
        raise ConfigError("there is no accepted model of these axes, so nothing can have changed since it")
    return screening_plan(config, model, sensor_noise(config), amplitude_scale=amplitude_scale)


def told_plan(plan: Plan, job: Job) -> dict[str, Any]:
    """Return the plan as a person sees it before arming, with what was chosen for this run."""
    return {**plain(plan.to_json()), "amplitude": job.amplitude, "purpose": job.purpose}
