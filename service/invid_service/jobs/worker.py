"""The runner: one job in its own process, ``python -m invid_service.jobs.worker``.

Reads the job and its wishes on stdin, tells of its progress on stdout (see ``jobs.protocol``). When
stdin ends, whoever started it is gone: motion is stopped and the process ends.
"""

from __future__ import annotations

import json
import os
import queue
import resource
import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import IO, TYPE_CHECKING, Any

from invid.errors import InputError, InvidError, SafetyStop
from invid_service.jobs.analysis_progress import AnalysisProgress
from invid_service.jobs.orphans import hold
from invid_service.jobs.protocol import ErrorInfo, Job
from invid_service.jobs.stops import Run, stopped_by
from invid_service.precedence import as_everyone, behind_parent

if TYPE_CHECKING:
    from invid.model.diagnosis_document import Diagnosis, Finding
    from invid.planning import Plan

_PROGRESS_PERIOD_S = 0.2
_QUEUE = 200

FIXES = {
    "ConfigError": "correct the cell's configuration",
    "RecordingError": "check the file; the contract of recordings is in the documentation",
    "NotIdentifiableError": "measure longer, with more amplitude or on more axes",
    "SafetyStop": "look at the robot, clear the cause that is named, then start again",
    "DriveError": "look at the drive's display and cable, then start again",
    "BusError": "check the CAN adapter, its cable and its termination, then start again",
}


class Stopped(Exception):
    """Somebody asked for the end."""


class Line:
    """Both directions of the pipe. Telling never blocks: progress that nobody reads is dropped."""

    def __init__(self, source: IO[bytes], sink: IO[bytes]) -> None:
        self._source, self._sink = source, sink
        self.stop = threading.Event()
        self.armed = threading.Event()
        self.orphaned = threading.Event()
        self._outbox: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self._last_progress = 0.0
        self._writer = threading.Thread(target=self._write, name="writer", daemon=True)
        self._writer.start()

    def read_job(self) -> Job:
        """The first line."""
        return Job.model_validate_json(self._source.readline())

    def listen(self) -> None:
        """Hear wishes from now on."""
        threading.Thread(target=self._listen, name="listener", daemon=True).start()

    def _listen(self) -> None:
        for line in self._source:
            kind = json.loads(line).get("type")
            if kind == "arm":
                self.armed.set()
            elif kind == "stop":
                self.stop.set()
        self.orphaned.set()
        self.stop.set()

    def _write(self) -> None:
        while (message := self._outbox.get()) is not None:
            try:
                self._sink.write(json.dumps(message, allow_nan=False).encode() + b"\n")
                self._sink.flush()
            except OSError:
                return

    def tell(self, kind: str, **members: Any) -> None:
        """Queue a message."""
        self._outbox.put({"type": kind, **members})

    def progress(self, fraction: float, phase: str, *, always: bool = False, **members: Any) -> None:
        """Queue progress, at most five times a second and only while it is read; ``always``: at any rate."""
        now = time.monotonic()
        often = now - self._last_progress < _PROGRESS_PERIOD_S or self._outbox.qsize() > _QUEUE
        if often and not always:
            return
        self._last_progress = now
        self.tell("progress", fraction=fraction, phase=phase, **members)

    def close(self) -> None:
        """Send what is queued."""
        self._outbox.put(None)
        self._writer.join(5.0)

    def check_stop(self) -> None:
        """Raise where the end was asked for."""
        if self.stop.is_set():
            raise Stopped


def error_info(error: BaseException) -> dict[str, Any]:
    """A stable code, the sentence, a way out."""
    kind = type(error).__name__
    if isinstance(error, InvidError):
        code = "".join("-" + c.lower() if c.isupper() else c for c in kind).lstrip("-")
        code = code.removesuffix("-error")
        fix = next((FIXES[c.__name__] for c in type(error).__mro__ if c.__name__ in FIXES), "see the manual")
        return ErrorInfo(code=code, text=str(error), fix=fix).model_dump()
    if isinstance(error, MemoryError):
        return ErrorInfo(
            code="out-of-memory",
            text="the data need more memory than one run may take",
            fix="cut the recording into shorter ones",
        ).model_dump()
    return ErrorInfo(
        code="internal-error", text=f"{kind}: {error}", fix="please report it, with the log of the service"
    ).model_dump()


def measure(job: Job, line: Line) -> dict[str, Any]:
    """Check, wait for arm, move, write ``recording.h5``; what was seen meanwhile."""
    from invid.config import CellConfig
    from invid.errors import ConfigError
    from invid.model.document import model_from_json
    from invid.planning.belief import from_model
    from invid_drivers.measurement import ask_drives, measure_to_file
    from invid_drivers.readiness import loads_to_support, support_sentence
    from invid_service.jobs.response import ResponseWatch

    if job.config is None:
        raise ConfigError("the job has no configuration")
    config = CellConfig.model_validate(job.config)
    accepted = None if job.model is None else model_from_json(job.model, source="accepted model")
    if accepted is not None and accepted.axes != tuple(a.name for a in config.axes):
        accepted = None
    model = None if accepted is None else from_model(accepted, config, source="the accepted model")
    plan, _, budgets, warned = ask_drives(
        config, axes=job.axes, amplitude_scale=job.amplitude_scale, model=model
    )
    document = {**told_plan(plan, job), "budgets": [b.to_json() for b in budgets]}
    support = loads_to_support(config)
    document["support"] = {"axes": list(support), "text": support_sentence(support)} if support else None
    document["warnings"] = [*document["warnings"], *warned]
    line.tell("planned", plan=_plain(document), arm=job.arm)
    del plan
    while not (job.arm or line.armed.is_set()):
        line.stop.wait(0.05)
        line.check_stop()
    line.check_stop()
    line.tell("running")
    target = job.folder / "recording.h5"

    def progress(p: Any) -> None:
        line.progress(
            float(p.fraction) * 0.8, str(p.phase), axis=p.axis, frequency=p.frequency, eta_s=float(p.eta_s)
        )

    with ResponseWatch(target, lambda response: line.tell("response", response=response)):
        result = measure_to_file(
            config,
            target,
            axes=job.axes,
            amplitude_scale=job.amplitude_scale,
            progress=progress,
            stop=line.stop,
            model=model,
        )
    line.check_stop()
    seen: dict[str, Any] = _plain(result.to_json())
    del seen["recording"]
    line.tell("measured", measurement=seen)
    return seen


def told_plan(plan: Plan, job: Job) -> dict[str, Any]:
    """The plan as a person sees it before arming, with what was chosen for this run."""
    document: dict[str, Any] = _plain(plan.to_json())
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


def analyse(job: Job, line: Line, seen: Mapping[str, Any] | None) -> dict[str, Any]:
    """Identify, diagnose, report, and the numbers of the page's pictures; the summary.

    ``seen`` is what the measurement saw, ``None`` where the recording comes from elsewhere.
    """
    from invid.api import diagnose, identify
    from invid.model.diagnosis_document import diagnosis_to_json
    from invid.model.document import dump_json, model_to_json, save_text
    from invid.recording import read_recording
    from invid.report import render_report
    from invid_service.jobs.plots import plot_data

    behind_parent()
    tell = AnalysisProgress(line.progress, job.expected_analysis_s)
    with tell.told():
        tell.begin("reading the recording")
        # Model and report name the run, not a working folder that is gone when somebody reads them.
        path = job.folder / "recording.h5"
        recording = replace(read_recording(path), source=f"{job.folder.name}/{path.name}")
        _require_axes(recording.axes, job)
        # An uploaded recording may come from a simulated cell too; the drives then wrote it down.
        simulated = job.simulated or bool(recording.attributes.get("simulated", False))
        flag = {"simulated": simulated}
        line.tell("recording", robot=recording.robot, axes=list(recording.axes), simulated=simulated)
        tell.begin("identifying")
        budget = 0.3 * job.budget_s
        model = identify(recording, budget=budget, progress=tell.weigh)
        save_text(job.folder / "model.json", dump_json({**model_to_json(model), **flag}))
        tell.begin("diagnosing")
        budget = job.budget_s - budget
        diagnosis = diagnose(recording, model=model, budget=budget, progress=tell.weigh)
        tell.begin("writing the report")
        best = diagnosis.model
        if not diagnosis.findings:
            # The identification's own numbers, with what the search for causes said of them.
            judged = {
                k: v for k, v in best.fit.items() if k in ("verdict", "trustworthy", "doubts", "unseen")
            }
            best = replace(model, fit={**model.fit, **judged})
        save_text(job.folder / "model.json", dump_json({**model_to_json(best), **flag}))
        save_text(job.folder / "diagnosis.json", dump_json({**diagnosis_to_json(diagnosis), **flag}))
        started = {"run": job.id, "started by": job.requested_by}
        report = render_report(recording, model, diagnosis, run=started)
        # A recording that says so is marked by the report itself.
        told = bool(recording.attributes.get("simulated", False))
        save_text(job.folder / "report.html", _marked(report, simulated and not told))
        save_text(job.folder / "plots.json", dump_json({**plot_data(recording, model, diagnosis), **flag}))
    said = [] if seen is None else seen["warnings"]
    return {
        "verdict": str(diagnosis.verdict),
        "headline": diagnosis.headline,
        "grade": None if diagnosis.grade is None else str(diagnosis.grade),
        "findings": [summary_of(f) for f in diagnosis.findings],
        "sentences": list(diagnosis.sentences),
        "explained_fraction": diagnosis.explained_fraction,
        "trustworthy": bool(best.fit.get("trustworthy", True)),
        "warnings": list(dict.fromkeys([*said, *model.warnings, *diagnosis.warnings])),
        "separating": separating(diagnosis, job),
        "analysis_s": round(tell.elapsed_s, 1),
    }


def separating(diagnosis: Diagnosis, job: Job) -> dict[str, Any] | None:
    """What would tell the alternatives apart on this cell; ``None`` where nothing is to be, or can be."""
    from invid.config import CellConfig
    from invid.model.diagnosis_document import diagnosis_to_json
    from invid.planning.separating_experiments import to_separate

    if job.config is None or not diagnosis.findings:
        return None
    try:
        found = to_separate(diagnosis_to_json(diagnosis), CellConfig.model_validate(job.config))
    except InputError:
        return None
    return {"finding": found.finding, "text": " ".join(found.sentences)}


def _require_axes(axes: tuple[str, ...], job: Job) -> None:
    """RecordingError where an uploaded recording is not of the cell whose history it is to join."""
    from invid.errors import RecordingError

    if job.kind != "analyse" or job.config is None:
        return
    names = [a["name"] for a in job.config["axes"]]
    if list(axes) != names:
        raise RecordingError(
            f"recording.h5: it has the axes {', '.join(axes)}, the cell has {', '.join(names)}",
            way_out="upload it without a cell, or name the cell that it is of",
        )


def summary_of(finding: Finding) -> dict[str, Any]:
    """One finding as a list shows it: what, where, how serious."""
    means = finding.consequence
    return {
        "cause": finding.effect.cause,
        "axis": finding.effect.axis,
        "element": finding.effect.element,
        "other_axis": finding.effect.other_axis,
        "sentence": finding.sentence,
        "consequence": None if means is None else means.to_json(),
    }


def _marked(report: str, simulated: bool) -> str:
    """A report of a simulated cell says so on its first line."""
    if not simulated or "<body" not in report:
        return report
    head, _, rest = report.partition("<body")
    tag, _, body = rest.partition(">")
    style = "border:2px solid;padding:.5em;font-weight:bold"
    banner = f'<p role="note" style="{style}">Simulated cell: no hardware</p>'
    return f"{head}<body{tag}>{banner}{body}"


def _plain(document: Mapping[str, Any]) -> Any:
    return json.loads(json.dumps(document, default=float))


def run(line: Line) -> int:
    """One job; the exit status."""
    job = line.read_job()
    resource.setrlimit(resource.RLIMIT_AS, (job.memory_bytes, job.memory_bytes))
    line.listen()
    held = hold(job.folder)
    threading.Thread(target=_end_with_parent, args=(line, job.stop_grace_s), daemon=True).start()
    try:
        seen = measure(job, line) if job.kind == "measure" else None
        summary = analyse(job, line, seen)
    except Stopped:
        line.tell("stopped", error=_stopped())
        return 4
    except SafetyStop as error:
        told = _stopped() if line.stop.is_set() else error_info(error)
        line.tell("stopped", error=told, stopped=_stopped_by(error, job))
        return 4
    except BaseException as error:
        if not isinstance(error, InvidError):
            import traceback

            traceback.print_exc()
        told = error_info(error)
        stopped = _stopped_by(error, job) if isinstance(error, InvidError) else None
        # Where the file lies in the service's own folders is nobody's business.
        line.tell(
            "failed", error={**told, "text": told["text"].replace(f"{job.folder}/", "")}, stopped=stopped
        )
        return getattr(error, "exit_code", 70)
    finally:
        held.close()
    line.tell("done", summary=_plain(summary))
    return 0


def _stopped_by(error: InvidError, job: Job) -> dict[str, Any] | None:
    linear = bool((job.config or {}).get("motion") == "linear")
    return stopped_by(error, Run(job.mode, job.amplitude, linear, None))


def _stopped() -> dict[str, Any]:
    return ErrorInfo(
        code="stopped", text="stopped on request", fix="start again when the cell is clear"
    ).model_dump()


def _end_with_parent(line: Line, grace_s: float) -> None:
    """Without a parent nobody can stop this process: let the drives be stopped, then go."""
    line.orphaned.wait()
    time.sleep(grace_s)
    os._exit(4)


def main() -> None:
    """Entry: keeps the pipe to itself, so that nothing a library prints breaks the protocol."""
    as_everyone()  # the cycle process takes its own precedence
    sink = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    line = Line(sys.stdin.buffer, sink)
    status = run(line)
    line.close()
    sys.stderr.flush()
    os._exit(status)


if __name__ == "__main__":
    main()
