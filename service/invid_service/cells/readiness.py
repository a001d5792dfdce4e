"""Judge whether a cell can start, and if not, why and what to do: for the page and for the 409."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel

from invid.config import CellConfig
from invid.errors import InvidError
from invid.planning.build import axes_left_out, subset_sentence
from invid_drivers.cia402.standing.holding import Reason as CellReason
from invid_drivers.cia402.stated.scales import MUCH_OF_RATED, limit_over_rated
from invid_drivers.connect import is_virtual
from invid_service.jobs.live import LiveRun
from invid_service.problems import Problem

_KEPT_S = 4.0
"""An answer is asked for again after so long."""


class _Said(BaseModel):
    text: str
    fix: str
    values: dict[str, str] = {}
    """What stands in the text, for whoever says it in another language."""
    seen: datetime | None = None
    """As of when that is known, where it is remembered and nobody was asked since; ``null``: now."""


class Reason(_Said):
    """One reason why a cell cannot start: a stable code, a sentence, a way out."""

    code: Literal[
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


class Note(_Said):
    """What keeps nothing from starting and must be known: a stable code, a sentence, a way out.

    Axes that are energised and will be taken over; torque limits beyond what their drives give; drives that
    nobody has asked.
    """

    code: Literal["axis_energised", "limit_beyond_drive", "drives_not_asked"]


class Readiness(BaseModel):
    """Answer whether a cell can start, with all reasons against it."""

    can_start: bool
    reasons: list[Reason]
    notes: list[Note] = []
    simulated: bool = False

    def problem(self) -> Problem:
        """Return why no run can start, as a refusal."""
        members: dict[str, Any] = {"reasons": [r.model_dump(mode="json") for r in self.reasons]}
        detail = "; ".join(r.text for r in self.reasons)
        return Problem("not-ready", detail, simulated=self.simulated, **members)

    @property
    def is_asked(self) -> bool:
        """Whether the drives were asked, so that nothing against a start means that the cell is ready."""
        return all(n.code != "drives_not_asked" for n in self.notes)


class Checked(Readiness):
    """Answer of the drives, which were asked, whether a measurement can start."""

    warnings: list[str]
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
    reasons = []
    if s.shutting_down:
        reasons.append(
            Reason(code="shutting_down", text="the service is shutting down", fix="wait for its restart")
        )
    if s.occupied_by is not None:
        run = s.occupied_by.record
        reasons.append(
            Reason(
                code="run_in_progress",
                text=f"identification {run.id} is {run.state}",
                fix="wait until it has ended, or cancel it",
                values={"run": run.id},
            )
        )
    if not s.store_answers:
        reasons.append(
            Reason(
                code="store_unavailable",
                text="the store does not answer: a result could not be kept",
                fix="look at the database and the disk of the service",
            )
        )
    if s.free_bytes < s.needed_bytes:
        reasons.append(
            Reason(
                code="disk_full",
                text=f"{s.free_bytes / 1e6:.0f} MB are free on the service's disk, a run needs "
                f"{s.needed_bytes / 1e6:.0f} MB",
                fix="delete old files on that disk or shorten retention_days",
                values={"free": f"{s.free_bytes / 1e6:.0f}", "needed": f"{s.needed_bytes / 1e6:.0f}"},
            )
        )
    bus = s.config.bus
    if (
        s.mode != "simulate"
        and bus.interface == "socketcan"
        and not Path("/sys/class/net", bus.channel).exists()
    ):
        reasons.append(
            Reason(
                code="bus_missing",
                text=f"this computer has no CAN interface {bus.channel}",
                fix=f"plug the adapter in, then: ip link set {bus.channel} up type can "
                f"bitrate {bus.bitrate_bit_per_s}",
                values={"channel": bus.channel, "bitrate": str(bus.bitrate_bit_per_s)},
            )
        )
    if s.mode == "simulate" and not s.config.simulated and not s.has_model:
        reasons.append(
            Reason(
                code="no_model",
                text="a real cell is simulated with its accepted model, and it has none yet",
                fix="identify the cell in mode full and accept the result first",
            )
        )
    if s.mode == "screen" and not s.has_model:
        reasons.append(
            Reason(
                code="nothing_to_screen",
                text="a screening compares with the accepted model, and there is none yet",
                fix="identify the cell in mode full and accept the result first",
            )
        )
    drives = () if s.mode == "simulate" else s.drives
    reasons += [_of_drive(d) for d in drives if not d.taken_over]
    if s.refusal is not None:
        text = s.refusal.reason or str(s.refusal)
        reasons.append(
            Reason(
                code="check_refused",
                text=text,
                fix=s.refusal.way_out
                or "mend what it says, then ask the drives again (`invid check` does, too)",
                values={"text": str(s.refusal)},
            )
        )
    hardware = s.mode != "simulate" and not is_virtual(s.config)
    if hardware and s.answer is not None and s.answer.text:
        reasons.append(
            Reason(
                code="check_refused",
                text=s.answer.text,
                fix=s.answer.fix,
                values={"text": s.answer.text},
                seen=s.answer.at,
            )
        )
    left_out = axes_left_out(s.config, s.axes)
    if left_out:
        reasons.append(
            Reason(
                code="axes_left_out",
                text=subset_sentence(left_out),
                fix="choose all axes",
                values={"axes": ", ".join(left_out)},
            )
        )
    notes = [_taken_over(d) for d in drives if d.taken_over] + _limits_beyond_drives(s.config)
    if hardware and s.answer is None and not reasons:
        notes.append(
            Note(
                code="drives_not_asked",
                text="the drives have not been asked: whether they answer is not known",
                fix="ask them; a measurement asks them before anything moves",
            )
        )
    return Readiness(can_start=not reasons, reasons=reasons, notes=notes, simulated=s.config.simulated)


def _of_drive(found: CellReason) -> Reason:
    values = {"axis": found.axis, "node": str(found.node_id)}
    seen = None if found.at is None else datetime.fromtimestamp(found.at, UTC)
    return Reason(code=found.code, text=found.text, fix=found.fix, values=values, seen=seen)


def _taken_over(found: CellReason) -> Note:
    return Note(code="axis_energised", **_of_drive(found).model_dump(exclude={"code"}))


def _limits_beyond_drives(config: CellConfig) -> list[Note]:
    """Torque limits far beyond the rated torque that the config states; no drive is asked for it."""
    notes = []
    for a in config.axes:
        rated, limit = a.rated_torque, a.limits.torque
        if rated is None or limit <= MUCH_OF_RATED * rated:
            continue
        notes.append(
            Note(
                code="limit_beyond_drive",
                text=f"axis {a.name}: {limit_over_rated(limit, rated, linear=config.linear)}",
                fix="correct the limit or its unit in the config; the drive's own limit holds where it "
                "is lower",
                values={
                    "axis": a.name,
                    "limit": f"{limit:g}",
                    "rated": f"{rated:g}",
                    "times": f"{limit / rated:.3g}",
                    "unit": "N" if config.linear else "N·m",
                },
            )
        )
    return notes
