"""Whose frames a log's frames are: channels that carry the same identifiers, and frames logged twice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from invid.errors import ChoiceNeeded, InputError
from invid.numerics.arrays import Bool
from invid.recording.import_map import Source
from invid_drivers.can_log_frames import Frames

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
