"""Tables from bags: MCAP with messages of ROS 2 (CDR) and JSON, rosbag2 in SQLite, and bags of ROS 1.

Every number in a message is a column, by the joint's name where the message gives names:
``/joint_states.position[elbow]``, or where another message gave them under the same ``names_version``. Each
topic has its own clock, and each publisher where several with other joints share one: ``header.stamp``
where it is ever set, else the time of logging.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mcap.reader
import mcap_ros2.decoder
import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from invid.errors import InputError
from invid.numerics.arrays import Float64
from invid.recording.import_map import Source
from invid.recording.readers.arrays import Columns
from invid.recording.tables import Table

MAX_VALUES = 50_000_000
MAX_WIDTH = 64
"""Entries without names up to which a list is a set of channels; a longer one is an image, a scan, a
matrix."""
_DEPTH = 6
_DAY = 86_400 * 10**9
_NAMES = ("name", "names", "joint_names", "interface_names")
"""Fields that hold the names of what lists of the same length in a message hold the numbers of."""


@dataclass(eq=False)
class _Stream:
    """Messages of one topic about the same joints, in whatever order; a number missing in one is NaN there.

    Several publishers may share a topic: each has its own joints and its own rows.
    """

    topic: str
    version: Any
    logged: list[int] = field(default_factory=list)
    stamps: list[int | None] = field(default_factory=list)
    cells: dict[str, dict[int, float]] = field(default_factory=dict)
    orders: dict[tuple[str, ...], None] = field(default_factory=dict)
    """Orders in which the joints came."""

    def instants(self, start: int) -> Float64:
        """(n,) [s] from ``start`` [ns]: of the header where it was ever set, else of the logging.

        A simulated clock begins at 0; a 0 before stamps that are further away than the record is long is one
        that was not set.
        """
        if not any(self.stamps):
            return np.array([(t - start) * 1e-9 for t in self.logged])
        first = min(t for t in self.stamps if t)
        unset = None if first <= 2 * (self.logged[-1] - self.logged[0]) + 10**9 else 0
        return np.array([np.nan if t is None or t == unset else (t - start) * 1e-9 for t in self.stamps])

    def columns(self, names: Sequence[str]) -> dict[str, Float64]:
        """Name → (n,); ``names`` of a list's entries, where other messages said them."""
        found, named = {}, dict(enumerate(names))
        for key, cells in self.cells.items():
            stem, _, place = key.rstrip("]").rpartition("[")
            name = named.get(int(place)) if stem and place.isdigit() else None
            column = np.full(len(self.logged), np.nan)
            column[list(cells)] = list(cells.values())
            found[key if name is None else f"{stem}[{name}]"] = column
        return found


_Message = tuple[str, int, Any, str]
"""Topic, time of logging [ns], body (``None``: not read), and what it is written in."""


def read_mcap(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of all topics of MCAP whose messages hold numbers."""
    return _table(path, _of_mcap(path), "the file is MCAP")


def read_bag(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of all topics of a bag of ROS 1, or of ROS 2 in SQLite, whose messages hold numbers."""
    return _table(path, _of_bag(path), "the file is a bag of ROS")


def _of_mcap(path: Path) -> Iterator[_Message]:
    ros = mcap_ros2.decoder.DecoderFactory()
    with path.open("rb") as file:
        for schema, channel, message in mcap.reader.make_reader(file).iter_messages():
            encoding = channel.message_encoding
            decode = json.loads if encoding == "json" else ros.decoder_for(encoding, schema)
            written = encoding if schema is None else schema.encoding
            yield channel.topic, message.log_time, decode and decode(message.data), written


def _of_bag(path: Path) -> Iterator[_Message]:
    # Bags before ROS 2 Iron hold no definitions of their messages; the usual ones are known.
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        for connection, logged, raw in reader.messages():
            known = connection.msgtype in reader.typestore.types
            body = reader.deserialize(raw, connection.msgtype) if known else None
            yield connection.topic, logged, body, connection.msgtype


def _table(path: Path, messages: Iterator[_Message], kind: str) -> Table:
    streams, names, left = dict[tuple[Any, ...], _Stream](), dict[Any, list[str]](), MAX_VALUES
    passed, long = set[str](), dict[str, int]()
    for topic, logged, body, written in messages:
        if body is None:
            passed.add(written)
            continue
        fields, joints = dict(_fields(body)), _names_in(body)
        version = fields.get("names_version")
        if version is not None and joints:
            # Names may be said once, before the values or after them.
            names[version] = joints
            continue
        stream = streams.setdefault((topic, version, *sorted(joints)), _Stream(topic, version))
        for name, value in _numbers(topic, body, 0, joints, None if version is not None else long):
            stream.cells.setdefault(name, {})[len(stream.logged)] = value
            left -= 1
        if left < 0:
            raise InputError(
                f"{path}: more than {MAX_VALUES} numbers; cut the bag to the topics needed", code="too_large"
            )
        stream.logged.append(logged)
        stream.stamps.append(_stamp(fields))
        stream.orders[tuple(joints)] = None
    found = _columns(list(streams.values()), names)
    if not found.clocks:
        other = f" (messages in {', '.join(sorted(passed))} are not read)" if passed else ""
        raise InputError(
            f"{path}: holds no topic with numbers in at least two messages{other}", code="no_data"
        )
    ordered = [s for s in streams.values() if any(s.orders)]
    reasons = [kind, *(f"joints of {s.topic}: {', '.join(next(iter(s.orders)))}" for s in ordered)]
    reasons += [f"messages in {e} are not read" for e in sorted(passed)]
    reasons += [f"{n!r} is a list of {k} numbers without names: not read" for n, k in long.items()]
    return found.table(path, line_word="message", reasons=tuple(reasons))


def _columns(streams: Sequence[_Stream], names: Mapping[Any, Sequence[str]]) -> Columns:
    """Columns, the clock of each, and names by place of what has a name, where its place is always one."""
    found = Columns()
    full = [s for s in streams if len(s.logged) > 1 and s.cells]
    logged = min((s.logged[0] for s in full), default=0)
    set_ = [t for s in full for t in s.stamps if t]
    # Stamps of a simulated clock are no dates: they count from their own first.
    near = bool(set_) and abs(set_[0] - logged) < _DAY
    stamped = logged if near or not set_ else min(set_)
    for stream in sorted(full, key=lambda s: (s.topic, -len(s.logged))):
        joints = next(iter(stream.orders))
        clock = f"time of {stream.topic}"
        clock += f" ({', '.join(joints[:3])})" if clock in found.values else ""
        found.add(clock, stream.instants(stamped if any(stream.stamps) else logged), "s")
        alone = len(stream.orders) == [s.topic for s in full].count(stream.topic) == 1
        for name, values in stream.columns(names.get(stream.version, ())).items():
            own = name if name not in found.values else f"{name} of {clock}"
            found.add(own, values, "", clock)
            for place, joint in enumerate(joints if alone else ()):
                if f"[{joint}]" in own:
                    found.aliases[own.replace(f"[{joint}]", f"[{place}]")] = own
    return found


def _numbers(
    name: str, value: Any, depth: int, names: Sequence[str], long: dict[str, int] | None
) -> Iterator[tuple[str, float]]:
    """Names and numbers of everything in a message; ``names`` of the entries of its lists.

    Lists without names that are too long go into ``long``, where there is one.
    """
    if isinstance(value, bool | int | float):
        yield name, float(value)
    elif isinstance(value, list | tuple | np.ndarray):
        keys = names if len(names) == len(value) else range(len(value))
        if long is not None and len(value) > MAX_WIDTH and keys is not names:
            long[name] = len(value)
            return
        value = value.tolist() if isinstance(value, np.ndarray) else value
        for key, entry in zip(keys, value, strict=True):
            yield from _numbers(f"{name}[{key}]", entry, depth + 1, (), long)
    elif depth <= _DEPTH and not isinstance(value, str | bytes):
        own = _names_in(value) or names
        for field_name, entry in _fields(value):
            if not (depth == 0 and field_name == "header"):
                yield from _numbers(f"{name}.{field_name}", entry, depth + 1, own, long)


def _names_in(value: Any) -> list[str]:
    """Names that a message gives the entries of its lists; none where one comes twice."""
    for key, found in _fields(value):
        if key in _NAMES and isinstance(found, list | tuple) and found:
            names = [str(n) for n in found]
            return names if len(set(names)) == len(names) else []
    return []


def _fields(value: Any) -> list[tuple[str, Any]]:
    if isinstance(value, dict):
        return [(str(k), v) for k, v in value.items()]
    names: Iterable[str] = getattr(value, "__dataclass_fields__", getattr(value, "__slots__", ()))
    return [(s, getattr(value, s)) for s in names if not s.startswith("_")]


def _stamp(fields: Mapping[str, Any]) -> int | None:
    """Nanoseconds of the header's stamp; ``None`` where there is none."""
    parts = dict(_fields(dict(_fields(fields.get("header"))).get("stamp")))
    seconds = parts.get("sec", parts.get("secs"))
    rest = parts.get("nanosec", parts.get("nsec", parts.get("nsecs", 0)))
    return seconds * 1_000_000_000 + rest if isinstance(seconds, int) and isinstance(rest, int) else None
