"""What was seen of each drive that carries a load and of its place, remembered beside the journal."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from invid_drivers.cia402.state_folder import StateFile, files_of_others, owner_of, read_state


@dataclass(frozen=True)
class Seen:
    """One drive, as its last stop test and its last settling showed it. ``None``: never seen."""

    node_id: int
    axis_of_node: int = 1
    loaded: bool | None = None
    holds: bool | None = None
    """It stayed in quick stop active and in place, on command and without its master."""
    resumes: bool | None = None
    """Transition 16: operation enabled from quick stop active, without letting go."""
    brake_s: float | None = None
    """From voltage off to the last motion [s]."""
    brake_drop: float | None = None
    """How far it moved meanwhile [rad or m]."""
    falls: float | None = None
    """How its load sped up until a brake that was late was given up [rad/s² or m/s²]."""
    weight: int | None = None
    """Thousandths of rated torque that held its load at rest."""
    left_held: bool = False
    """A run left it energised in quick stop active."""
    in_run: bool = False
    """A run commands it, or did when it was killed: it may be energised."""
    at: float = field(default=0.0, compare=False)
    """When something new was noted of it last [s since 1970]."""
    suspect: str = ""
    """Why a run ended at this axis beside a load or under one: not enabled again until a person says so."""

    @property
    def place(self) -> tuple[int, int]:
        """Node, and which of its axes."""
        return self.node_id, self.axis_of_node


FORGOTTEN = (
    ", and how a loaded axis is held would be forgotten; make it writable, or set "
    "XDG_STATE_HOME to a folder that is"
)
LOST = "unreadable"
"""Name of what stands for every node that is not listed, where the memory could not be read."""


class HoldMemory:
    """What was seen of the drives and places of one bus; ``path`` ``None`` keeps it in memory.

    Where it is there and cannot be read, every axis waits for a person until that one has cleared it.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._seen: dict[str, Seen] = {} if path is None else _read(path)
        self.file = StateFile(path)

    @classmethod
    def beside(cls, journal: Path | None) -> HoldMemory:
        """The memory of the bus whose journal this is."""
        return cls(None if journal is None else journal.with_suffix(".holds.json"))

    @property
    def seen(self) -> Mapping[str, Seen]:
        """What was seen, by identity of the drive, or by node where it has none."""
        return self._seen

    def of(self, identity: str, node_id: int, axis: int = 1) -> Seen:
        """What is known of a drive and of its place.

        What a drive does is known of that drive alone, one without a serial number is a stranger each time;
        what its place carries, and that it waits for a person, is known whichever drive is there.
        """
        place = self.of_axis(node_id, axis) or Seen(node_id, axis)
        drive = self._seen.get(identity)
        if drive is not None and drive.node_id == node_id:
            return drive
        return replace(
            drive or Seen(node_id, axis),
            node_id=node_id,
            loaded=place.loaded if drive is None else drive.loaded or place.loaded,
            left_held=place.left_held,
            in_run=place.in_run,
            suspect=place.suspect,
        )

    def of_axis(self, node_id: int, axis: int = 1) -> Seen | None:
        """What was seen of the last drive at a place, for whoever has not asked it who it is."""
        lost = self._seen.get(LOST)
        unknown = None if lost is None else replace(lost, node_id=node_id, axis_of_node=axis)
        return next((s for s in self._seen.values() if s.place == (node_id, axis)), unknown)

    def clear(self, node_id: int, axis: int = 1) -> None:
        """Forget what is remembered against an axis: a person has found the cause."""
        seen = self.of_axis(node_id, axis)
        if seen is not None and seen.suspect:
            name = next((k for k, s in self._seen.items() if s.place == (node_id, axis)), "")
            self.keep(name, replace(seen, suspect=""))

    def keep(self, identity: str, seen: Seen) -> None:
        """Remember what was seen: on disk at once, or later under power; BusError where it fails."""
        name = identity or f"node {seen.node_id}" + f".{seen.axis_of_node}" * (seen.axis_of_node > 1)
        if self._seen.get(name) == seen:
            return
        seen = replace(seen, at=time.time())
        others = {k: v for k, v in self._seen.items() if v.place != seen.place or k == name}
        self._seen = {**others, name: seen}
        text = json.dumps({k: asdict(v) for k, v in self._seen.items()}, indent=1)
        self.file.replace(text.encode(), FORGOTTEN)


def identity(vendor_id: int, product_code: int, serial: int, axis: int = 1) -> str:
    """Name of an axis of a drive in the memory; empty where that has no serial number."""
    further = f".{axis}" * (axis > 1)
    return f"{vendor_id:08X}-{product_code:08X}-{serial}{further}" if serial else ""


def _read(path: Path) -> dict[str, Seen]:
    """What the file holds, by name, with what other users' runs warn of since; one entry for every node where
    it cannot be read."""
    try:
        seen = _parse(read_state(path))
    except (OSError, ValueError, TypeError, AttributeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is damaged"
        return {LOST: Seen(0, suspect=f"what was remembered of it cannot be read: {path}, {why}")}
    for other in files_of_others(path):
        try:
            theirs = _parse(read_state(other, of_another=True))
            seen |= {k: s for k, v in theirs.items() if (s := _warned(seen, k, v, owner_of(other)))}
        except (OSError, ValueError, TypeError, AttributeError):
            continue  # it cannot warn
    return seen


def _parse(data: bytes | None) -> dict[str, Seen]:
    document: Any = {} if data is None else json.loads(data)
    return {str(k): Seen(**v) for k, v in document.items()}


def _warned(own: Mapping[str, Seen], name: str, theirs: Seen, user: str) -> Seen | None:
    """What is known of a drive, with what makes careful from what another user's run saw later: that it may
    carry a load or be energised, or waits for a person. Never that anything holds."""
    mine = own.get(name) or next((s for s in own.values() if s.place == theirs.place), None)
    if mine is not None and mine.at >= theirs.at:
        return None
    known = mine or Seen(*theirs.place)
    return replace(
        known,
        node_id=theirs.node_id,
        loaded=theirs.loaded or known.loaded,
        left_held=theirs.left_held or known.left_held,
        in_run=theirs.in_run or known.in_run,
        suspect=f"{theirs.suspect} (seen by user {user})" if theirs.suspect else known.suspect,
    )
