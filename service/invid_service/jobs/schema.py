"""Bodies of requests and answers about identifications."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from invid.wording.fields import Text
from invid_service.jobs.doubts import why_untrusted
from invid_service.jobs.live import LiveRun, progress_of
from invid_service.jobs.protocol import ErrorInfo, RunProgress
from invid_service.jobs.stated_change import StatedChange
from invid_service.jobs.states import ENDED, State
from invid_service.jobs.stops import EMPTY
from invid_service.links import address
from invid_service.spoken import Spoken
from invid_service.store.store import RunRecord
from invid_service.tuning.tunings import TUNING_KINDS

RETRY_AFTER_S = 1
_PLANNED = {State.CHECKING, State.AWAITING_ARM, State.RUNNING}
_DETAILS = {"drives", "jitter_histogram"}
"""Of a measurement: at its own address."""
_PARAMETERS = ("parameters", "effects")
PARTS: dict[str, Callable[[Mapping[str, Any]], dict[str, Any] | None]] = {
    "plan": lambda facts: facts.get("plan"),
    "measurement": lambda facts: facts.get("measurement"),
    "changes": lambda facts: (facts.get("summary") or {}).get("changes"),
}
"""What a run has whole at an address of its own: a poll need not carry it."""


PersonName = Annotated[
    str,
    Field(min_length=1, max_length=80, pattern=r"^[^\s\x00-\x1f\x7f]([^\x00-\x1f\x7f]*[^\s\x00-\x1f\x7f])?$"),
]
"""Who says so, as a person writes it: no blank at either end."""


class StartBody(BaseModel):
    """Wish for an identification: mode, axes, how it starts."""

    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        json_schema_extra={"examples": [{"mode": "full", "axes": ["A1", "A2"], "arm": True}]},
    )
    mode: Literal["simulate", "test", "full", "screen", "verify"]
    """simulate: no hardware; test: at most 10 % amplitude; full; screen: a short measurement that says
    whether anything changed since the accepted model, and replaces none; verify: a short measurement of the
    drives' loops while they are closed, beside what ``tuned`` predicted of them."""
    axes: list[str] | None = Field(default=None, min_length=1, max_length=64)
    """Axes to excite; the others are held. Default: all."""
    arm: bool = False
    """true: do not wait for the action "arm" (for a cell controller that has its own release)."""
    amplitude: Literal["planned", "gentler"] = "planned"
    """gentler: half of the torque that would be planned."""
    separate: str | None = Field(default=None, max_length=40, pattern=r"^[A-Za-z0-9-]+$")
    """An identification of this cell: run the experiments that separate the causes which its diagnosis could
    not tell apart (its ``separating``), instead of the cell's own."""
    tuned: str | None = Field(default=None, max_length=40, pattern=r"^[A-Za-z0-9-]+$")
    """With ``verify``: the identification whose tuning was applied."""
    changed: StatedChange | None = None
    """What a person changed before: the headline says first whether that is what was found."""


class ActionBody(BaseModel):
    """Decision about a run: arm, cancel, accept or reject."""

    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        json_schema_extra={"examples": [{"type": "arm"}, {"type": "accept", "by": "Ann Weld"}]},
    )
    type: Literal["arm", "cancel", "accept", "reject"]
    override: str | None = Field(default=None, min_length=3, max_length=500)
    """With ``accept`` of a result that is not to be trusted: the reason, which is stored."""
    by: PersonName | None = None
    """With ``accept`` or ``reject``: who decides. Kept with the decision and in the history of models, the
    key beside it in the audit log; default: the key's name."""


class Separating(BaseModel):
    """Experiment that a run with ``separate`` would do."""

    finding: int
    """Number of the finding in the diagnosis, from 0; the first of those that are not told apart."""
    text: Text


class NextAction(BaseModel):
    """The one action that follows a stop."""

    code: str
    text: Text
    where: str
    """``page``, ``machine``, ``drive``, ``computer``, or a field of the cell's config."""


class Trace(BaseModel):
    """Last seconds of motion, at most 200 rows; empty in lists, and where the process that ran could not
    tell.
    """

    time_s: list[float]
    """Before the end, ≤ 0."""
    position: dict[str, list[float]]
    """By axis, from where it stood at the start [rad or m]."""
    torque: dict[str, list[float]]
    """By axis, measured [N·m or N]."""


class StoppedView(BaseModel):
    """Facts of a run that ended while it moved."""

    code: str = ""
    """What stopped it, as a stable word (``position_window``, …); empty where there is none."""
    what: Text = ""
    """The same in general; empty where there is none."""
    phase: Text
    axis: str | None
    reason: Text
    action: NextAction
    trace: Trace


class Identification(Spoken, RunProgress):
    """A run: what it is, how far, and its results."""

    id: str
    cell: str | None
    robot: str
    mode: str
    amplitude: Literal["planned", "gentler"]
    separates: str | None
    """The identification whose causes this run separates."""
    analyses: str | None
    """The identification whose recording this run works out (again)."""
    verifies: str | None
    """The identification whose tuning this run measures."""
    changed: StatedChange | None
    """What a person said was changed before; the summary's ``answer`` says how that agrees with what was
    found."""
    axes: list[str]
    state: State
    simulated: bool
    error: ErrorInfo | None
    recorded: bool | None
    """Whether a run that has ended left a recording, to be worked out by ``analysis``; ``null`` in lists, and
    before its end."""
    tuned: bool
    """Whether values for the drives were worked out; ``false`` in lists."""
    stopped: StoppedView | None
    """Of a run that ended early while it moved: where, why, the one thing to do, the last seconds."""
    created: datetime
    started: datetime | None
    ended: datetime | None
    requested_by: str
    plan: dict[str, Any] | None
    """What will move and how far, once checked and until it has moved; then at its link."""
    measurement: dict[str, Any] | None
    """What was seen while it moved, once measured: peaks, skipped SYNC slots, missed samples, warnings.
    Whole, with the drives and how late the SYNCs were, at its link."""
    decision: dict[str, Any] | None
    summary: dict[str, Any] | None
    """verdict, sentences, warnings and ``changes`` against the accepted model: those that there are; every
    parameter at their link."""
    untrusted: Text | None
    """Why the result is accepted only with an ``override``; ``null`` where it needs none."""
    separating: Separating | None
    """What a start with ``separate`` would do; ``null`` where there is nothing to separate."""
    links: dict[str, str]


class IdentificationList(BaseModel):
    """Page of a list of runs, newest first."""

    identifications: list[Identification]
    simulated: bool
    next: str | None
    """Where the list goes on; ``null`` at its end."""


def view(
    record: RunRecord, live: LiveRun | None, *, trace: bool = True, kept: Collection[str] | None = None
) -> Identification:
    """Return the resource of a stored or living run; ``trace``: with the last seconds of a stopped one,
    ``kept``: the kinds of its files.
    """
    if live is not None:
        record, progress = live.record, live.progress
    else:
        progress = progress_of(record)
    base = address("identifications", record.id)
    stopped = record.facts.get("stopped")
    if stopped is not None and not trace:
        stopped = {**stopped, "trace": EMPTY}
    names = ["events", "recording", "model", "diagnosis", "report", "plots", "analysis", *PARTS]
    names += (*TUNING_KINDS, "verification", "verification-picture")
    measurement = record.facts.get("measurement")
    summary = record.facts.get("summary")
    return Identification(
        **{name: value for name, value in vars(record).items() if name not in ("axes", "facts")},
        **dict(progress),
        amplitude=record.facts.get("amplitude", "planned"),
        separates=record.facts.get("separates"),
        analyses=record.facts.get("analyses"),
        verifies=record.facts.get("verifies"),
        changed=record.facts.get("changed"),
        axes=list(record.axes),
        error=record.facts.get("error"),
        recorded=None if kept is None or record.state not in ENDED else "recording" in kept,
        tuned="tuning" in (kept or ()),
        stopped=stopped,
        plan=record.facts.get("plan") if record.state in _PLANNED else None,
        measurement=None
        if measurement is None
        else {k: v for k, v in measurement.items() if k not in _DETAILS},
        decision=record.facts.get("decision"),
        summary=None if summary is None else _news(summary),
        untrusted=why_untrusted(record.mode, summary),
        separating=(summary or {}).get("separating"),
        links={"self": base, **{name: f"{base}/{name}" for name in names}},
    )


def _news(summary: dict[str, Any]) -> dict[str, Any]:
    """Return a summary without the parameters that did not change."""
    changes = summary.get("changes")
    if changes is None:
        return summary
    lists = {n: [e for e in changes[n] if e["status"] == "changed"] for n in _PARAMETERS if n in changes}
    return {**summary, "changes": {**changes, **lists}}


def following(*parts: str) -> dict[str, str]:
    """Return the headers of an answer to what goes on by itself: where to follow it, and when."""
    return {"Location": address("identifications", *parts), "Retry-After": str(RETRY_AFTER_S)}


def polling_headers(record: RunRecord) -> dict[str, str]:
    """Return the header ``Retry-After`` while there is something to wait for."""
    return {} if record.state in ENDED else {"Retry-After": str(RETRY_AFTER_S)}
