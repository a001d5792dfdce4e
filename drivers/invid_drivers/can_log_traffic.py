"""Whose frames a log's frames are: channels that carry the same identifiers, and frames logged twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from invid.errors import ChoiceNeeded, InputError
from invid.recording.import_map import Source

BOTH_WAYS = 0.1
"""Share of an identifier's frames that must be of each direction before they count as frames and echoes: a
few may have been sent by hand."""
CLOSE = 0.25
"""Of the mean distance of SYNC: two of them nearer than this are one, logged twice."""
TWICE = 0.4
"""Share of such distances that is no chance; of frames all logged twice it is a half."""


@dataclass
class Traffic:
    """Frames counted by identifier, channel and direction (True: received)."""

    frames: Counter[tuple[int, str, bool]] = field(default_factory=Counter)

    def add(self, frame: Any) -> None:
        """Count one frame."""
        self.frames[frame.arbitration_id, str(frame.channel), bool(frame.is_rx)] += 1

    def channels(self, identifier: int) -> dict[str, int]:
        """Channel → frames of an identifier, most first."""
        found: Counter[str] = Counter()
        for (number, channel, _), count in self.frames.items():
            if number == identifier:
                found[channel] += count
        return dict(found.most_common())

    def ways(self, identifier: int, channel: str) -> dict[bool, int]:
        """Direction → frames of an identifier on a channel."""
        return {w: n for (i, c, w), n in self.frames.items() if (i, c) == (identifier, channel)}


@dataclass(frozen=True)
class Choice:
    """For each identifier that is read its channel, and the direction where both are there."""

    channel: Mapping[int, str]
    received: Mapping[int, bool]

    def takes(self, frame: Any) -> bool:
        """Whether a frame of these identifiers is read."""
        identifier = frame.arbitration_id
        wanted = self.received.get(identifier)
        here = self.channel.get(identifier)
        return (here is None or here == str(frame.channel)) and (
            wanted is None or wanted == bool(frame.is_rx)
        )

    def leaves_out(self, traffic: Traffic) -> bool:
        """Whether any of the frames counted is not read."""
        return any(self.channel.get(i, c) != c or self.received.get(i, w) != w for i, c, w in traffic.frames)


def choose(traffic: Traffic, source: Source, pdos: Collection[int], clock: int, path: Path) -> Choice:
    """Choose the channel, and the direction, of every identifier that is read.

    Raises
    ------
    InputError
        More than one channel, or both directions, carry an identifier and the map does not say which is
        meant.
    """
    own = {p.id: p.channel for p in source.pdos if p.channel is not None}
    channel: dict[int, str] = {}
    for identifier in pdos:
        channel.update(_channel(traffic, identifier, own.get(identifier, source.channel), path))
    carrying = set(channel.values())
    if clock not in channel:
        said = source.channel if source.channel is not None else None
        # SYNC of a bus that none of the drives is on clocks nobody.
        alone = next(iter(carrying)) if said is None and len(carrying) == 1 else said
        channel.update(_channel(traffic, clock, alone, path))
    received: dict[int, bool] = {}
    for identifier, name in channel.items():
        ways = traffic.ways(identifier, name)
        if len(ways) < 2 or min(ways.values()) < BOTH_WAYS * sum(ways.values()):
            continue
        if source.echo is None:
            raise ChoiceNeeded(
                f"{path}: 0x{identifier:X} is logged as received ({ways[True]} frames) and as sent "
                f"({ways[False]}): one of the two is the echo of the other; say 'echo: received' or 'echo: "
                "sent' in the map's 'source', which of them is to be read",
                "echo",
                "received",
            )
        received[identifier] = source.echo == "received"
    return Choice(channel, received)


def _channel(traffic: Traffic, identifier: int, said: str | int | None, path: Path) -> dict[int, str]:
    there = traffic.channels(identifier)
    if said is not None:
        if there and str(said) not in there:
            raise InputError(
                f"{path}: 0x{identifier:X} does not come on channel {said!r}; it comes on {_listed(there)}: "
                "say so in 'channel' of the map's 'source', or of the PDO"
            )
        return {identifier: str(said)}
    if len(there) > 1:
        first = next(iter(there))
        raise ChoiceNeeded(
            f"{path}: 0x{identifier:X} comes on several channels: {_listed(there)}; say which robot's is "
            f"meant: 'channel: {first}' in the map's 'source' (or in one of its 'pdos')",
            "channel",
            first,
        )
    return dict.fromkeys([identifier], next(iter(there))) if there else {}


def _listed(there: Mapping[str, int]) -> str:
    return ", ".join(f"{name} ({count} frames)" for name, count in there.items())


__all__ = ["CLOSE", "TWICE", "Choice", "Traffic", "choose"]
