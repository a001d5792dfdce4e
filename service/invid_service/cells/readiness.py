"""Judge whether a cell can start, and if not, why and what to do: for the page and for the 409."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, Field

from invid.config import CellConfig
from invid.errors import InvidError
from invid.planning.build import axes_left_out
from invid.wording.fields import Text
from invid.wording.sentence import joined, sentence
from invid_drivers.cia402.standing.holding import Reason as CellReason
from invid_drivers.cia402.stated.scales import MUCH_OF_RATED
from invid_drivers.connect import is_virtual
from invid_service.jobs.live import LiveRun
from invid_service.problems import Problem
from invid_service.spoken import Spoken
from invid_service.words import NOTES, REASONS, told

_KEPT_S = 4.0
"""An answer is asked for again after so long."""


ReasonCode = Literal[
    "run_in_progress",
    "disk_full",
    "store_unavailable",
    "bus_missing",
    "no_model",
    "nothing_to_screen",
    "shutting_down",
    "axes_left_out",
    "axis_energised",
    "axis_suspect",
    "check_refused",
]


class _Said(BaseModel):
    text: Text
    fix: Text
    seen: datetime | None = None
    """As of when that is known, where it is remembered and nobody was asked since; ``null``: now."""


class Reason(_Said):
    """One reason why a cell cannot start: a stable code, a sentence, a way out."""

    code: ReasonCode


class Note(_Said):
    """What keeps nothing from starting and must be known: a stable code, a sentence, a way out.

    Axes that are energised and will be taken over; torque limits beyond what their drives give; drives that
    nobody has asked.
    """

    code: Literal["axis_energised", "limit_beyond_drive", "drives_not_asked"]


class Readiness(Spoken):
    """Answer whether a cell can start, with all reasons against it."""

    can_start: bool
    reasons: list[Reason]
    notes: list[Note] = Field(default_factory=list)
    simulated: bool = False

    def problem(self) -> Problem:
        """Return why no run can start, as a refusal."""
        members: dict[str, Any] = {"reasons": [r.model_dump(mode="json") for r in self.reasons]}
        detail = joined([r.text for r in self.reasons], " ")
        return Problem("not-ready", detail, simulated=self.simulated, **members)

    @property
    def is_asked(self) -> bool:
        """Whether the drives were asked, so that nothing against a start means that the cell is ready."""
        return all(n.code != "drives_not_asked" for n in self.notes)


class Checked(Readiness):
    """Answer of the drives, which were asked, whether a measurement can start."""

    warnings: list[Text]
    """What is to be known beside: of drives, bus, limits and adapter."""


@dataclass(frozen=True)
class Situation:
    """Facts that readiness is judged on; gathering them is the caller's business."""

    config: CellConfig
    occupied_by: LiveRun | None
    free_bytes: int
    needed_bytes: int
    store_answers: bool
    shutting_down: bool
    has_model: bool
    mode: Literal["simulate", "test", "full", "screen", "verify"] | None = None
    """The mode asked for; ``None``: whether any measurement could start."""
    axes: tuple[str, ...] | None = None
    """The axes to shake; ``None``: all."""
    drives: tuple[CellReason, ...] = ()
    """What is known against the drives: remembered, or as they were asked."""
    refusal: InvidError | None = None
    """With what ``invid check`` and the run would refuse to plan."""
    answer: Answer | None = None
    """The last answer of the drives; ``None``: nobody has asked them."""


@dataclass(frozen=True)
class Answer:
    """What the drives said last: nothing against a start, or why not and what to do."""

    at: datetime
    text: str = ""
    fix: str = ""


class RecentAnswers:
    """Cache of whether cells can start, so that a poll waits for no store and no plan."""

    def __init__(self) -> None:
        self._said: dict[str, bool | None] = {}
        self._asked: dict[str, tuple[float, asyncio.Task[None]]] = {}

    def of(self, cell: str, ask: Callable[[], Awaitable[Readiness]]) -> bool | None:
        """Return the last answer, ``None`` before the first (a plan takes its time, and no poll waits) and
        where nobody has asked the drives.
        """
        at, task = self._asked.get(cell, (0.0, None))
        if task is None or (task.done() and time.monotonic() - at >= _KEPT_S):
            task = asyncio.create_task(self._ask(cell, ask))
            self._asked[cell] = time.monotonic(), task
        return self._said.get(cell)

    async def _ask(self, cell: str, ask: Callable[[], Awaitable[Readiness]]) -> None:
        answer = await ask()
        self._said[cell] = answer.can_start if answer.is_asked else None


def readiness(s: Situation) -> Readiness:
    """Return every reason why the cell cannot start now; none: it can."""
    bus, hardware = s.config.bus, s.mode != "simulate"
    left_out = axes_left_out(s.config, s.axes)
    room = {"free": f"{s.free_bytes / 1e6:.0f}", "needed": f"{s.needed_bytes / 1e6:.0f}"}
    found: list[Reason | None] = [
        _if(s.shutting_down, "shutting_down"),
        None if s.occupied_by is None else _reason("run_in_progress", run=s.occupied_by.record.id),
        _if(not s.store_answers, "store_unavailable"),
        _if(s.free_bytes < s.needed_bytes, "disk_full", **room),
        _if(
            hardware and bus.interface == "socketcan" and not Path("/sys/class/net", bus.channel).exists(),
            "bus_missing", channel=bus.channel, bitrate=str(bus.bitrate_bit_per_s),
        ),
        _if(s.mode == "simulate" and not s.config.simulated and not s.has_model, "no_model"),
        _if(s.mode == "screen" and not s.has_model, "nothing_to_screen"),
    ]  # fmt: skip
    drives = s.drives if hardware else ()
    found += [_of_drive(d) for d in drives if not d.taken_over]
    if s.refusal is not None:
        text, fix = (
            s.refusal.reason or str(s.refusal),
            s.refusal.way_out or sentence(REASONS["check_refused"][1]),
        )
        found.append(Reason(code="check_refused", text=text, fix=fix))
    hardware = hardware and not is_virtual(s.config)
    if hardware and s.answer is not None and s.answer.text:
        text, fix, at = s.answer.text, s.answer.fix, s.answer.at
        found.append(Reason(code="check_refused", text=text, fix=fix, seen=at))
    found.append(_if(bool(left_out), "axes_left_out", axes=", ".join(left_out)))
    reasons = [r for r in found if r is not None]
    notes = [_taken_over(d) for d in drives if d.taken_over] + _limits_beyond_drives(s.config)
    if hardware and s.answer is None and not reasons:
        notes.append(Note(code="drives_not_asked", **told(NOTES["drives_not_asked"])))
    return Readiness(can_start=not reasons, reasons=reasons, notes=notes, simulated=s.config.simulated)


def _reason(code: ReasonCode, **values: str) -> Reason:
    return Reason(code=code, **told(REASONS[code], **values))


def _if(holds: bool, code: ReasonCode, **values: str) -> Reason | None:
    return _reason(code, **values) if holds else None


def _of_drive(found: CellReason) -> Reason:
    seen = None if found.at is None else datetime.fromtimestamp(found.at, UTC)
    return Reason(code=found.code, text=found.text, fix=found.fix, seen=seen)


def _taken_over(found: CellReason) -> Note:
    return Note(code="axis_energised", **_of_drive(found).model_dump(exclude={"code"}))


def _limits_beyond_drives(config: CellConfig) -> list[Note]:
    """Torque limits far beyond the rated torque that the config states; no drive is asked for it."""
    notes, unit = [], "N" if config.linear else "N·m"
    for a in config.axes:
        rated, limit = a.rated_torque, a.limits.torque
        if rated is not None and limit > MUCH_OF_RATED * rated:
            sizes = {"limit": f"{limit:g}", "rated": f"{rated:g}", "times": f"{limit / rated:.3g}"}
            words = told(NOTES["limit_beyond_drive"], axis=a.name, unit=unit, **sizes)
            notes.append(Note(code="limit_beyond_drive", **words))
    return notes
