"""What was seen of each drive that carries a load, remembered by its serial number beside the journal."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from invid.errors import BusError


@dataclass(frozen=True)
class Seen:
    """One drive, as its last stop test and its last settling showed it. ``None``: never seen."""

    node_id: int
    loaded: bool | None = None
    holds: bool | None = None
    """It stayed in quick stop active and in place, on command and without its master."""
    resumes: bool | None = None
    """Transition 16: operation enabled from quick stop active, without letting go."""
    brake_s: float | None = None
    """From voltage off to the last motion [s]."""
    brake_drop: float | None = None
    """How far it moved meanwhile [rad or m]."""
    weight: int | None = None
    """Thousandths of rated torque that held its load at rest."""
    left_held: bool = False
    """A run left it energised in quick stop active."""
    suspect: str = ""
    """Why a run ended at this axis beside a load or under one: not enabled again until a person says so."""


class HoldMemory:
    """Drives of one bus; ``path`` ``None`` keeps them in memory."""

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._seen: dict[str, Seen] = {} if path is None else _read(path)

    @classmethod
    def beside(cls, journal: Path | None) -> HoldMemory:
        """The memory of the bus whose journal this is."""
        return cls(None if journal is None else journal.with_suffix(".holds.json"))

    @property
    def seen(self) -> Mapping[str, Seen]:
        """By identity of the drive."""
        return self._seen

    def of(self, identity: str, node_id: int) -> Seen:
        """What is known of a drive; one without a serial number is a stranger each time."""
        return replace(self._seen.get(identity, Seen(node_id)), node_id=node_id)

    def of_node(self, node_id: int) -> Seen | None:
        """The drive last seen at a node, for whoever has not asked it who it is."""
        return next((s for s in self._seen.values() if s.node_id == node_id), None)

    def keep(self, identity: str, seen: Seen) -> None:
        """Note what was seen; written to disk at once. BusError where that fails."""
        if not identity or self._seen.get(identity) == seen:
            return
        others = {k: v for k, v in self._seen.items() if v.node_id != seen.node_id or k == identity}
        self._seen = {**others, identity: seen}
        if self.path is None:
            return
        part = self.path.with_suffix(".part")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with part.open("w", encoding="utf-8") as file:
                json.dump({k: asdict(v) for k, v in self._seen.items()}, file, indent=1)
                file.flush()
                os.fsync(file.fileno())
            part.replace(self.path)
        except OSError as error:
            raise BusError(
                f"{self.path}: cannot be written ({error.strerror}), and how a loaded axis is held would be "
                "forgotten; set XDG_STATE_HOME to a writable folder"
            ) from None


def identity(vendor_id: int, product_code: int, serial: int) -> str:
    """Name of a drive in the memory; empty where it has no serial number."""
    return f"{vendor_id:08X}-{product_code:08X}-{serial}" if serial else ""


def _read(path: Path) -> dict[str, Seen]:
    """What cannot be read was never seen: every drive is tested again."""
    try:
        document: Any = json.loads(path.read_text(encoding="utf-8"))
        return {str(k): Seen(**v) for k, v in document.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}
