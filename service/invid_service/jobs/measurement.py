"""Run a job's measurement: check, wait to be armed, move, record."""

from __future__ import annotations

import math
import threading
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
from invid_drivers.protocol import AxisStates, Known, Line, Measured, Planned, Running, RunProgress
from invid_drivers.readiness import ask, loads_to_support, support_sentence
from invid_drivers.screening import screening_plan
from invid_drivers.stopping_budgets import Wish
from invid_service.jobs.analysis_progress import BEGINS, Tell
from invid_service.jobs.countdown import Countdown, Ticker
from invid_service.jobs.last_words import LastWords
from invid_service.jobs.protocol import Job, plain

STANDS_S = 1.5
"""The motion says where it is ten times a second: after so long without a word it stands between two runs."""
LOOK_S = 10.0
"""What a look between two runs is thought to take until one was seen: the case study on two cores."""
_SETTLED_S = 2.0
"""Robot time after which the pace of the motion so far says how long the rest takes."""


class MotionProgress(Ticker):
    """Reports how far a motion is, and every second how long it takes, also while it stands between two runs.

    Time left is what the plan has left at the pace of the clock so far (a simulated cell runs ahead of it, a
    busy one behind), with what the looks between the runs still to come take. How far it is changes with the
    motion alone: by that the service sees that it does not hang.
    """

    def __init__(
        self, tell: Tell, runs: int, after_s: float | None, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__()
        self._tell, self._clock, self._after = tell, clock, after_s
        self._countdown = Countdown(clock)
        self._first: tuple[float, float] | None = None
        self._last: tuple[float, Any] | None = None
        self._stood, self._looks, self._looks_left = 0.0, 0, max(runs - 1, 0)
        self._known: Known | None = None
        self._lock = threading.Lock()

    def moved(self, progress: Any) -> None:
        """Take what the motion says of itself (``invid.sweep.Progress``)."""
        with self._lock:
            now = self._clock()
            if self._first is None:
                self._first = now, float(progress.eta_s)
            if self._last is not None and now - self._last[0] > STANDS_S:
                self._stood += now - self._last[0]
                self._looks += 1
                self._looks_left = max(self._looks_left - 1, 0)
            self._last = now, progress
        self.say()

    def knows(self, found: Reached) -> None:
        """Take what the runs so far tell."""
        if found.trustworthy and math.isfinite(found.relative):
            self._known = Known(relative_std=found.relative, shown=found.shown, asked=len(found.limits))

    def say(self, *, always: bool = False) -> None:
        """Report how far it is now."""
        with self._lock:
            if self._first is None or self._last is None:
                return
            now, (heard, p) = self._clock(), self._last
            done = self._first[1] - float(p.eta_s)
            moving = heard - self._first[0] - self._stood
            pace = moving / done if done > _SETTLED_S else 1.0
            looks = self._looks_left * (self._stood / self._looks if self._looks else LOOK_S)
            stands = now - heard
            left = self._countdown.left(max(pace * float(p.eta_s) + looks - stands, 0.0))
            told = RunProgress(
                fraction=float(p.fraction) * BEGINS,
                phase=str(p.phase),
                axis=p.axis,
                frequency=p.frequency,
                eta_s=None if self._after is None or left is None else left + self._after,
                motion_left_s=left,
                known=self._known,
            )
        self._tell(told, always=always)


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
    runs = 1 if short else len(found.plan.recorded)
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

    shown = MotionProgress(line.progress, runs, job.expected_analysis_s)
    with shown.told():
        result = measure_to_file(
            config,
            target,
            wish,
            progress=shown.moved,
            seen=seen,
            stop=line.stop,
            judge=None if short or job.tuning else judge_of(config, shown.knows),
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
