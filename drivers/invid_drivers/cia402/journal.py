"""What the service wrote into a drive, and what stood there before: undone on every way out.

The journal goes to disk before each write. After a power cut the next start finds it and restores the
drive before anything else, where it still shows what was written (see ``restoration``). Undoing the entries
from the last to the first also undoes PDO maps in the one order that drives accept.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import asdict, dataclass
from pathlib import Path

from invid.errors import BusError
from invid.wording.sentence import sentence
from invid_drivers.cia402.reservation import Reservation
from invid_drivers.cia402.state_folder import (
    StateFile,
    files_of_others,
    owner_of,
    read_state,
    require_writable,
    state_folder,
    unwritten,
)

NEEDED = (
    "; nothing is written into a drive that could not be restored after a power cut; set XDG_STATE_HOME to a "
    "folder of yours that lasts, in a container one on a volume"
)
COMPARED = (
    "; what it says of settings that are restored is compared with the drive at the next start, and "
    "left as it is"
)


@dataclass(frozen=True)
class Entry:
    """One write: where, the bytes before it and the bytes written (hex)."""

    node_id: int
    serial: int
    index: int
    sub: int
    before: str
    wrote: str | None = None
    """``None`` in journals of versions that did not note it."""


class Journal:
    """Writes not yet undone; ``path`` ``None`` keeps them in memory (a simulated cell forgets anyway).

    BusError where it cannot be written, or says what another user could have made it say: before a drive is
    touched.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._entries: list[Entry] = []
        self.file = StateFile(path, "journal")
        self.reservation: Reservation | None = None
        """Held as long as the bus is this process's."""
        if path is not None:
            try:
                require_writable(path.parent)
            except OSError as error:
                raise unwritten(f"journal {path}", error, NEEDED) from None
            self._entries = _read(path)

    @property
    def entries(self) -> tuple[Entry, ...]:
        """All entries, in the order written."""
        return tuple(self._entries)

    def of_node(self, node_id: int) -> tuple[Entry, ...]:
        """The entries of one node, last first: the order to undo them in."""
        return tuple(e for e in reversed(self._entries) if e.node_id == node_id)

    def add(self, entry: Entry) -> None:
        """Record a write before it is made."""
        self._entries.append(entry)
        self.file.append(_line(entry), NEEDED)

    def note(self, entry: Entry) -> None:
        """Record a write under power: on disk soon, for no cycle waits for it."""
        self.file.defer()
        self.add(entry)

    def release(self) -> None:
        """Give the bus free for the next process."""
        if self.reservation is not None:
            self.reservation.release()

    def keep(self, node_id: int, entries: Collection[Entry]) -> None:
        """Drop the entries of a node but for these, which are not undone yet."""
        kept = set(map(id, entries))  # a value may be written twice: equal entries are two
        self._entries = [e for e in self._entries if e.node_id != node_id or id(e) in kept]
        self.file.replace(b"".join(map(_line, self._entries)), COMPARED)


def _line(entry: Entry) -> bytes:
    return json.dumps(asdict(entry)).encode() + b"\n"


def _read(path: Path) -> list[Entry]:
    try:
        data = read_state(path) or b""
    except OSError as error:
        raise BusError(
            sentence(
                "journal {path}: cannot be read ({strerror}), and what an earlier run left in the "
                "drives is not known without it; make it readable for you alone, or set "
                "XDG_STATE_HOME to another folder",
                path=path,
                strerror=error.strerror,
            )
        ) from None
    entries = []
    for line in data.decode(errors="replace").splitlines():
        try:
            entry = Entry(**json.loads(line))
            bytes.fromhex(entry.before + (entry.wrote or ""))
        except (ValueError, TypeError):
            continue  # a line cut off by the power cut: its write was never made
        entries.append(entry)
    return entries


def journal_path(interface: str, channel: str) -> Path:
    """Where the journal of a bus stands."""
    safe = "".join(c if c.isalnum() else "-" for c in f"{interface}-{channel}")
    return state_folder() / f"{safe}.journal"


def refuse_left_by_others(path: Path) -> None:
    """BusError where a run of another user wrote into the drives of this bus and has not undone it: what he
    remembers of that is for him to write back, since anybody may have put it there."""
    for other in files_of_others(path):
        raise BusError(
            sentence(
                "journal {other}: a run of user {owner_of} left settings in the drives of this "
                "bus; run `invid check` as that user, which restores them, or remove the journal "
                "if they are to stay",
                other=other,
                owner_of=owner_of(other),
            )
        )
