"""Tables from MCAP, the container of rosbag2: ROS 2 messages (CDR) and JSON.

Every number in a message is a column, ``/joint_states.position[0]``; each topic has its own clock: the
message's ``header.stamp`` where it has one that is set, else the time of its logging.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.tables import Table

MAX_VALUES = 50_000_000
_MAX_WIDTH = 64
_DEPTH = 6
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
    topics: dict[str, _Topic] = {}
    passed: set[str] = set()
    try:
        with path.open("rb") as stream:
            ros = mcap_ros2.decoder.DecoderFactory()
            start, left = None, MAX_VALUES
            for schema, channel, message in mcap.reader.make_reader(stream).iter_messages():
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
                start = message.log_time if start is None else start
                row = dict(_numbers("", body, 0))
                left -= len(row)
                if left < 0:
                    raise InputError(
                        f"{path}: more than {MAX_VALUES} numbers; cut the bag to the topics needed"
                    )
                topic = topics.setdefault(channel.topic, _Topic(channel.topic))
                topic.add(((_stamp(body) or message.log_time) - start) * 1e-9, row, _joints(body))
    except InputError:
        raise
    except Exception as error:  # mcap and the decoders raise by kind of damage: McapError, struct.error, …
        said = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        raise InputError(f"{path}: cannot be read as MCAP: {said}") from None
    columns, clocks = {}, {}
    for topic in topics.values():
        own = topic.columns()
        columns.update(own)
        clocks.update(dict.fromkeys([c for c in own if c != topic.clock], topic.clock))
    if not clocks:
        other = f" (messages in {', '.join(sorted(passed))} are not read)" if passed else ""
        raise InputError(f"{path}: holds no topic with numbers in at least two messages{other}")
    reasons = ["the file is MCAP"]
    reasons += [f"joints of {t.name} in order: {', '.join(t.joints)}" for t in topics.values() if t.joints]
    reasons += [f"messages in {e} are not read" for e in sorted(passed)]
    units = dict.fromkeys((t.clock for t in topics.values()), "s")
    return Table(
        str(path), columns, line_word="message", units=units, clocks=clocks,
        reasons=tuple(reasons),
    )  # fmt: skip


class _Topic:
    """Messages of one topic, gathered; a number missing in one message is NaN there."""

    def __init__(self, name: str) -> None:
        self.name, self.clock = name, f"time of {name}"
        self.joints: list[str] = []
        self._instants: list[float] = []
        self._cells: dict[str, dict[int, float]] = {}

    def add(self, instant: float, row: dict[str, float], joints: list[str]) -> None:
        for key, value in row.items():
            self._cells.setdefault(key, {})[len(self._instants)] = value
        self._instants.append(instant)
        self.joints = self.joints or joints

    def columns(self) -> dict[str, Float64]:
        if len(self._instants) < 2 or not self._cells:
            return {}
        found = {self.clock: frozen_float(np.array(self._instants))}
        for key, cells in self._cells.items():
            column = np.full(len(self._instants), np.nan)
            column[list(cells)] = list(cells.values())
            found[f"{self.name}{key}"] = frozen_float(column)
        return found


def _numbers(name: str, value: Any, depth: int) -> Iterator[tuple[str, float]]:
    if isinstance(value, bool | int | float):
        yield name, float(value)
    elif isinstance(value, str | bytes) or value is None or depth > _DEPTH:
        return
    elif isinstance(value, list | tuple | np.ndarray):
        if len(value) <= _MAX_WIDTH:
            for i, entry in enumerate(value):
                yield from _numbers(f"{name}[{i}]", entry, depth + 1)
    else:
        for field, entry in _fields(value):
            if not (depth == 0 and field == "header"):
                yield from _numbers(f"{name}.{field}", entry, depth + 1)


def _fields(value: Any) -> list[tuple[str, Any]]:
    if isinstance(value, dict):
        return [(str(k), v) for k, v in value.items()]
    return [(s, getattr(value, s)) for s in getattr(value, "__slots__", ()) if not s.startswith("_")]


def _stamp(body: Any) -> int:
    """Nanoseconds since 1970 of the header; 0 where there is none or it was never set."""
    stamp = dict(_fields(dict(_fields(body)).get("header"))).get("stamp")
    parts = dict(_fields(stamp))
    seconds, rest = parts.get("sec"), parts.get("nanosec", parts.get("nsec", 0))
    return seconds * 1_000_000_000 + rest if isinstance(seconds, int) and isinstance(rest, int) else 0


def _joints(body: Any) -> list[str]:
    names = dict(_fields(body)).get("name")
    return [str(n) for n in names] if isinstance(names, list) else []
