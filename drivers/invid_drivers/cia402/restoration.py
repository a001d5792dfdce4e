"""What of a journal may be undone: a setting that somebody made since is nobody's to overwrite.

``decide`` is pure: entries and the values that a drive shows, in; what to write back and what to leave, out.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.access import Access, WriteRefused
from invid_drivers.cia402.journal import Entry
from invid_drivers.cia402.objects import NodeAxis, Object
from invid_drivers.cia402.states import is_energised, state_of

Address = tuple[int, int]
"""Index and subindex."""


class Verdict(StrEnum):
    """What becomes of entries that belong together."""

    DONE = "done"
    """The drive shows what stood there before."""
    UNDO = "undo"
    """It shows what was written here."""
    FOREIGN = "foreign"
    """It shows something else: set by somebody since."""
    UNKNOWN = "unknown"
    """It does not show the object, or the journal does not say what was written (older versions)."""


@dataclass(frozen=True)
class Group:
    """Entries that are undone together or not at all: those of an object, or of a PDO with its map."""

    entries: tuple[Entry, ...]
    """In the order written."""
    verdict: Verdict
    culprit: Entry | None = None
    """The last entry of the object that speaks against undoing."""
    undo: tuple[Entry, ...] = ()
    """Entries whose ``before`` is to be written back, in this order."""


def decide(entries: Sequence[Entry], shown: Mapping[Address, bytes | None]) -> tuple[Group, ...]:
    """Entries of one drive, in the order written, against what it shows now; the last written comes first.

    A write that was journalled and never made, and a restoring that was interrupted, leave one of the values
    that the journal knows: undoing goes on from there. ``None`` in ``shown``: the object cannot be read.
    """
    groups: dict[int | Address, list[Entry]] = {}
    for e in reversed(entries):
        # those of one PDO and its map are undone together
        key = e.index & 0xFDFF if 0x1400 <= e.index <= 0x1BFF else (e.index, e.sub)
        groups.setdefault(key, []).insert(0, e)
    return tuple(_judge(tuple(group), shown) for group in groups.values())


def same(a: bytes, b: bytes) -> bool:
    """Whether two values are equal; drives answer with fewer or more bytes than the type has."""
    short, long = sorted((a, b), key=len)
    rest = set(long[len(short) :])
    return long.startswith(short) and rest <= {0 if not short or short[-1] < 0x80 else 0xFF, 0}


def _judge(group: tuple[Entry, ...], shown: Mapping[Address, bytes | None]) -> Group:
    chains: dict[Address, list[Entry]] = {}
    for e in group:
        chains.setdefault((e.index, e.sub), []).append(e)
    values = {at: shown.get(at) for at in chains}
    if all(v is not None and same(v, _bytes(chains[at][0].before)) for at, v in values.items()):
        return Group(group, Verdict.DONE)
    made: dict[Address, int] = {}
    for at, chain in chains.items():
        value = values[at]
        if value is None or any(e.wrote is None for e in chain):
            return Group(group, Verdict.UNKNOWN, chain[-1])
        steps = [chain[0].before, *(e.wrote or "" for e in chain)]
        reached = [k for k, step in enumerate(steps) if same(value, _bytes(step))]
        if not reached:
            return Group(group, Verdict.FOREIGN, chain[-1])
        made[at] = reached[-1]
    undo: list[Entry] = []
    for e in group:
        at = (e.index, e.sub)
        made[at] -= 1
        if made[at] >= 0:
            undo.insert(0, e)
    return Group(group, Verdict.UNDO, undo=tuple(undo))


def _bytes(hexadecimal: str) -> bytes:
    return bytes.fromhex(hexadecimal)


def restore(drive: Access, axes: Collection[int]) -> tuple[str, ...]:
    """Undo what an earlier run, or this one, wrote; what was left and why, in words.

    Only where the drive still shows what was written, and never under power. What could not be undone
    stays in the journal, as does what was written into another drive that had this node id before.

    Parameters
    ----------
    axes
        Axes of its node in this cell: with the first of them the whole node is restored.
    """
    if drive.of_node.number != min(axes):
        return ()
    drive = copy.copy(drive)
    drive.of_node = NodeAxis()  # an entry says where it is
    entries = tuple(reversed(drive.journal.of_node(drive.node_id)))
    if not entries:
        return ()
    serial = drive.find(od.SERIAL_NUMBER)
    mine = tuple(e for e in entries if not serial or e.serial in (0, serial))
    others = tuple(e for e in entries if serial and e.serial not in (0, serial))
    said = _said_of_others(drive, others)
    if not mine:
        return said
    words = [drive.find(NodeAxis(n).at(od.STATUSWORD)) for n in sorted(axes)]
    for word in words:
        if word is not None and not is_energised(state_of(word)):
            continue
        state = "its statusword cannot be read" if word is None else f"it is in {state_of(word).words}"
        return (
            *said,
            f"{drive.who}: {len(mine)} settings of an earlier run were not restored: {state}, and nothing is "
            "restored under power; switch the axis off (load supported) and check again",
        )
    left: list[Entry] = []
    for group in decide(mine, {(e.index, e.sub): drive.peek(drive.object_of(e)) for e in mine}):
        sentence, kept = _undo(drive, group)
        left += kept
        said = (*said, f"{drive.who}: {sentence}") if sentence else said
    drive.journal.keep(drive.node_id, (*others, *left))
    return said


def _said_of_others(drive: Access, entries: tuple[Entry, ...]) -> tuple[str, ...]:
    if not entries:
        return ()
    serials = ", ".join(sorted({str(e.serial) for e in entries}))
    path = f" ({drive.journal.path})" if drive.journal.path else ""
    return (
        f"{drive.who}: {len(entries)} settings were written into the drive with "
        f"serial number {serials}, which was here before; they are restored when it is back. If it "
        f"will not be, delete the journal{path}",
    )


def _undo(drive: Access, group: Group) -> tuple[str, tuple[Entry, ...]]:
    """Write back what a group stood at before; return what to say of it and what stays in the journal."""
    if group.verdict is Verdict.UNDO:
        for n, step in enumerate(group.undo):
            try:
                drive.download(drive.object_of(step), bytes.fromhex(step.before))
            except WriteRefused as error:
                undone = set(map(id, group.undo[:n]))
                rest = tuple(x for x in group.entries if id(x) not in undone)
                return f"{error.said}; restored at the next start", rest
        return "", ()
    if group.culprit is None:
        return "", ()
    e = group.culprit
    what = drive.object_of(e)
    first = next(x for x in group.entries if (x.index, x.sub) == (e.index, e.sub))
    shown = drive.peek(drive.object_of(e))
    found = "cannot be read" if shown is None else f"shows {_in_words(what, shown)}"
    before = f"{what.address} {what.name} was {_in_words(what, bytes.fromhex(first.before))}"
    if group.verdict is Verdict.FOREIGN and e.wrote is not None:
        ours = _in_words(what, bytes.fromhex(e.wrote))
        return f"{before}, {ours} was written here, it {found} now: set since, left as it is", ()
    unknown = "" if e.wrote is not None else ", and what was written here was not noted"
    return f"{before} and {found}{unknown}; not restored: set it by hand", group.entries


def _in_words(what: Object, data: bytes) -> str:
    value = what.unpack(data)
    return str(value) if what.index >= 0x2000 else f"0x{value:X}"
