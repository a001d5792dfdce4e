"""Tables from MCAP, the container of rosbag2: ROS 2 messages (CDR) and JSON.

Every number in a message is a column, by the joint's name where the message gives names:
``/joint_states.position[elbow]``. Each topic has its own clock, and each publisher where several with other
joints share one: ``header.stamp`` where it is ever set, else the time of logging.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.tables import Table

MAX_VALUES = 50_000_000
_MAX_WIDTH = 64
_DEPTH = 6
_DAY = 86_400 * 10**9
_ENCODINGS = ("cdr", "json")


def read_mcap_table(path: Path) -> Table:
    """Columns of all topics whose messages hold numbers."""
    try:
        import mcap.reader  # noqa: PLC0415 (an extra: not everybody has it)
        import mcap_ros2.decoder  # noqa: PLC0415
    except ImportError:
        raise InputError(
            f"{path}: MCAP needs the packages mcap and mcap-ros2-support; "
            "install them with pip install 'invid[mcap]'"
        ) from None
    streams: dict[tuple[str, tuple[str, ...]], _Stream] = {}
    passed: set[str] = set()
    try:
        with path.open("rb") as file:
            ros = mcap_ros2.decoder.DecoderFactory()
            left = MAX_VALUES
            for schema, channel, message in mcap.reader.make_reader(file).iter_messages():
                if channel.message_encoding not in _ENCODINGS:
                    passed.add(channel.message_encoding)
                    continue
                if channel.message_encoding == "json":
                    body = json.loads(message.data)
                else:
                    decode = ros.decoder_for(channel.message_encoding, schema)
                    if decode is None:
                        passed.add(schema.encoding if schema is not None else "no schema")
                        continue
                    body = decode(message.data)
                joints = tuple(_names(body))
                row = dict(_numbers("", body, 0))
                left -= len(row)
                if left < 0:
                    raise InputError(
                        f"{path}: more than {MAX_VALUES} numbers; cut the bag to the topics needed"
                    )
                key = channel.topic, tuple(sorted(joints))
                stream = streams.setdefault(key, _Stream(channel.topic))
                stream.add(message.log_time, _stamp(body), row, joints)
    except InputError:
        raise
    except Exception as error:  # mcap and the decoders raise by kind of damage: McapError, struct.error, …
        said = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        raise InputError(f"{path}: cannot be read as MCAP: {said}") from None
    columns, clocks, aliases = _columns(list(streams.values()))
    if not clocks:
        other = f" (messages in {', '.join(sorted(passed))} are not read)" if passed else ""
        raise InputError(f"{path}: holds no topic with numbers in at least two messages{other}")
    reasons = ["the file is MCAP"]
    reasons += [f"joints of {s.topic}: {', '.join(s.orders[0])}" for s in streams.values() if any(s.orders)]
    reasons += [f"messages in {e} are not read" for e in sorted(passed)]
    return Table(
        str(path), columns, line_word="message", units=dict.fromkeys(clocks.values(), "s"), clocks=clocks,
        aliases=aliases, reasons=tuple(reasons),
    )  # fmt: skip


@dataclass(eq=False)
class _Stream:
    """Messages of one topic about the same joints, in whatever order; a number missing in one is NaN there.

    Several publishers may share a topic: each has its own joints and its own rows.
    """

    topic: str
    logged: list[int] = field(default_factory=list)
    stamps: list[int | None] = field(default_factory=list)
    cells: dict[str, dict[int, float]] = field(default_factory=dict)
    orders: list[tuple[str, ...]] = field(default_factory=list)
    """Orders in which the joints came."""

    def add(self, logged: int, stamp: int | None, row: Mapping[str, float], joints: tuple[str, ...]) -> None:
        for key, value in row.items():
            self.cells.setdefault(key, {})[len(self.logged)] = value
        self.logged.append(logged)
        self.stamps.append(stamp)
        if joints not in self.orders:
            self.orders.append(joints)

    @property
    def is_stamped(self) -> bool:
        return any(self.stamps)

    def instants(self, start: int) -> Float64:
        """(n,) [s] from ``start`` [ns]: of the header where it was ever set, else of the logging.

        A simulated clock begins at 0; a 0 before stamps that are further away than the record is long is one
        that was not set.
        """
        if not self.is_stamped:
            return np.array([(t - start) * 1e-9 for t in self.logged])
        first = min(t for t in self.stamps if t)
        unset = None if first <= 2 * (self.logged[-1] - self.logged[0]) + 10**9 else 0
        known = [None if t == unset else t for t in self.stamps]
        return np.array([np.nan if t is None else (t - start) * 1e-9 for t in known])

    def column(self, key: str) -> Float64:
        column = np.full(len(self.logged), np.nan)
        cells = self.cells[key]
        column[list(cells)] = list(cells.values())
        return frozen_float(column)


def _columns(streams: Sequence[_Stream]) -> tuple[dict[str, Float64], dict[str, str], dict[str, str]]:
    """Columns, the clock of each, and names by place of what has a name, where its place is always one."""
    full = [s for s in streams if len(s.logged) > 1 and s.cells]
    logged = min((s.logged[0] for s in full), default=0)
    set_ = [t for s in full for t in s.stamps if t]
    # Stamps of a simulated clock are no dates: they count from their own first.
    near = bool(set_) and abs(set_[0] - logged) < _DAY
    stamped = logged if near or not set_ else min(t for s in full if s.is_stamped for t in s.stamps if t)
    columns: dict[str, Float64] = {}
    clocks: dict[str, str] = {}
    aliases: dict[str, str] = {}
    for stream in sorted(full, key=lambda s: (s.topic, -len(s.logged))):
        clock = f"time of {stream.topic}"
        alone = clock not in columns
        if not alone:
            clock = f"time of {stream.topic} ({', '.join(stream.orders[0][:3])})"
        columns[clock] = frozen_float(stream.instants(stamped if stream.is_stamped else logged))
        own = {key: f"{stream.topic}{key}" for key in stream.cells}
        own = {k: n if n not in columns else f"{n} of {clock}" for k, n in own.items()}
        columns |= {name: stream.column(key) for key, name in own.items()}
        clocks |= dict.fromkeys(own.values(), clock)
        one_topic = [s for s in full if s.topic == stream.topic]
        if len(one_topic) == len(stream.orders) == 1:
            for place, joint in enumerate(stream.orders[0]):
                aliases |= {
                    n.replace(f"[{joint}]", f"[{place}]"): n for n in own.values() if f"[{joint}]" in n
                }
    return columns, clocks, aliases


_NAMES = ("name", "names", "joint_names", "interface_names")
"""Fields that hold the names of what lists of the same length in a message hold the numbers of."""


def _names(value: Any) -> list[str]:
    """Names that a message gives the entries of its lists; none where one comes twice."""
    for key, found in _fields(value):
        if key in _NAMES and isinstance(found, list | tuple) and found:
            names = [str(n) for n in found]
            return names if len(set(names)) == len(names) else []
    return []


def _numbers(name: str, value: Any, depth: int, names: Sequence[str] = ()) -> Iterator[tuple[str, float]]:
    if isinstance(value, bool | int | float):
        yield name, float(value)
    elif isinstance(value, str | bytes) or value is None or depth > _DEPTH:
        return
    elif isinstance(value, list | tuple | np.ndarray):
        if len(value) <= _MAX_WIDTH:
            keys = names if len(names) == len(value) else range(len(value))
            for key, entry in zip(keys, value, strict=True):
                yield from _numbers(f"{name}[{key}]", entry, depth + 1)
    else:
        own = _names(value) or names
        for field_name, entry in _fields(value):
            if not (depth == 0 and field_name == "header"):
                yield from _numbers(f"{name}.{field_name}", entry, depth + 1, own)


def _fields(value: Any) -> list[tuple[str, Any]]:
    if isinstance(value, dict):
        return [(str(k), v) for k, v in value.items()]
    return [(s, getattr(value, s)) for s in getattr(value, "__slots__", ()) if not s.startswith("_")]


def _stamp(body: Any) -> int | None:
    """Nanoseconds of the header's stamp; ``None`` where there is none."""
    parts = dict(_fields(dict(_fields(dict(_fields(body)).get("header"))).get("stamp")))
    seconds = parts.get("sec", parts.get("secs"))
    rest = parts.get("nanosec", parts.get("nsec", parts.get("nsecs", 0)))
    return seconds * 1_000_000_000 + rest if isinstance(seconds, int) and isinstance(rest, int) else None
