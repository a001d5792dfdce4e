"""Whose frames a log's frames are: channels that carry the same identifiers, and frames logged twice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from invid.errors import ChoiceNeeded, InputError
from invid.numerics.arrays import Bool, Float64
from invid.recording.import_map import Source
from invid_drivers.can_log.frames import Frames

CLOSE = 0.25
"""Of the mean distance of SYNC: two of them nearer than this are one, logged twice."""
TWICE = 0.4
"""Share of such distances that is no chance; of frames all logged twice it is a half."""
BOTH_DIFFER = 0.5
"""Share of pairs of rows with different numbers from which they are no frame and its echo."""
BOTH_WAYS = 0.1
"""Share of an identifier's frames that must be of each direction before they count as frames and echoes: a
few may have been sent by hand."""


def chosen_frames(frames: Frames, source: Source, watched: Sequence[int], clock: int, path: Path) -> Frames:
    """The frames of these identifiers and of the clock that the map means, on one channel and in one
    direction.

    Raises
    ------
    InputError
        More than one channel, or both directions, carry an identifier and the map does not say which is
        meant.
    """
    own = {p.id: p.channel for p in source.pdos if p.channel is not None}
    keep: Bool = np.zeros(frames["time"].size, dtype=np.bool_)
    carrying: set[str] = set()
    for identifier in dict.fromkeys((*watched, clock)):
        mine = frames["identifier"] == identifier
        there: dict[str, int] = dict(
            frames.frame.filter(mine)["channel"].value_counts().sort("channel").iter_rows()
        )
        said = own.get(identifier, source.channel)
        if identifier == clock and identifier not in watched and said is None and len(carrying) == 1:
            # SYNC of a bus that none of the drives is on clocks nobody.
            said = next(iter(carrying))
        channel = _channel(identifier, there, None if said is None else str(said), path)
        if channel is not None:
            carrying.add(channel)
            mine &= frames["channel"] == channel
        keep |= mine & _one_way(frames["received"], mine, identifier, source, path)
    return frames.where(keep)


def _channel(identifier: int, there: Mapping[str, int], said: str | None, path: Path) -> str | None:
    shown = ", ".join(
        f"{name} ({count} frames)" for name, count in sorted(there.items(), key=lambda c: -c[1])
    )
    if said is not None and there and said not in there:
        raise InputError(
            f"{path}: 0x{identifier:X} does not come on channel {said!r}; it comes on {shown}",
            way_out="say so in 'channel' of the map's 'source', or of the PDO",
            code="no_such_channel",
        )
    if said is None and len(there) > 1:
        first = max(there, key=lambda name: there[name])
        raise ChoiceNeeded(
            f"{path}: 0x{identifier:X} comes on several channels: {shown}; say which robot's is meant: "
            "'channel: "
            f"{first}' in the map's 'source' (or in one of its 'pdos')",
            "channel",
            first,
        )
    return said if said in there else next(iter(there), None)


def _one_way(received: Bool, mine: Bool, identifier: int, source: Source, path: Path) -> Bool:
    """The frames of an identifier in one direction, where it was logged as sent and as received."""
    both = int(received[mine].sum()), int((~received[mine]).sum())
    if min(both) < max(BOTH_WAYS * sum(both), 1) or source.echo == "first":
        return np.ones_like(received)
    if source.echo is None:
        raise ChoiceNeeded(
            f"{path}: 0x{identifier:X} is logged as received ({both[0]} frames) and as sent ({both[1]}): "
            "one of the two "
            "is the echo of the other; say 'echo: received' or 'echo: sent' in the map's 'source', which of "
            "them is to "
            "be read",
            "echo",
            "received",
        )
    return received if source.echo == "received" else ~received


def first_of_pairs(frames: Frames, clock: int) -> Frames:
    """Frames without those of the same identifier and bytes that come right behind one.

    What is near is judged by the mean distance of the frames of ``clock``.
    """
    steps = np.diff(frames["time"][frames["identifier"] == clock])
    near = CLOSE * float(steps.mean()) if steps.size else 0.0
    keep = np.ones(frames["time"].size, dtype=np.bool_)
    for identifier in frames.counts():
        at = np.flatnonzero(frames["identifier"] == identifier)
        same = (frames.data[at][1:] == frames.data[at][:-1]).all(axis=1)
        keep[at[1:][same & (np.diff(frames["time"][at]) < near)]] = False
    return frames.where(keep)


def paired_by(instants: Float64, rows: Float64) -> float | None:
    """How far apart [s] each SYNC and its echo are where all are logged twice; ``None`` where they are not.

    About half of the distances are then next to nothing and the others twice the mean. Rows that are next to
    nothing apart and hold numbers of their own are no echo: their stamps are coarse.
    """
    steps = np.diff(instants)
    mean = float(steps.mean())
    close = steps < CLOSE * mean
    if steps.size <= 8 or not mean > 0 or close.mean() <= TWICE:
        return None
    first, second = rows[:-1][close], rows[1:][close]
    differ = np.isfinite(first) & np.isfinite(second) & (first != second)
    if abs(np.median(steps[~close]) / mean - 2.0) >= 0.5 or np.mean(differ.any(axis=1)) > BOTH_DIFFER:
        return None
    return float(np.median(np.sort(steps)[: steps.size // 2]))
