"""MCAP as robots write it: columns by the joints' names, whatever order and publisher they come in."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from invid.errors import InputError
from invid.recording.import_map import Source
from invid.recording.readers.kinds import read_table
from invid.recording.suggest import suggest

N = 400
TIME = np.arange(N) * 1e-3


def angle(joint: str) -> np.ndarray:
    return np.sin(2 * np.pi * (3 + len(joint)) * TIME) * len(joint)


def bag(path: Path, messages: list[tuple[str, int, dict]]) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("sensor_msgs/JointState", "jsonschema", b"{}")
        channels = {t: writer.register_channel(t, "json", schema) for t, _, _ in messages}
        for topic, logged, body in messages:
            writer.add_message(channels[topic], logged, json.dumps(body).encode(), logged)
        writer.finish()
    return path


def state(k: int, names: list[str], stamp: float | None = None) -> dict:
    stamp = 1.7e9 + TIME[k] if stamp is None else stamp
    header = {"stamp": {"sec": int(stamp), "nanosec": round(stamp % 1 * 1e9)}}
    values = [float(angle(n)[k]) for n in names]
    return {"header": header, "name": names, "position": values, "effort": [3 * v for v in values]}


def logged(k: int) -> int:
    return int(1.7e18) + k * 1_000_000


def test_joints_that_change_their_order_are_read_by_name(tmp_path):
    orders = [["elbow", "shoulder1"], ["shoulder1", "elbow"]]
    path = bag(tmp_path / "a.mcap", [("/js", logged(k), state(k, orders[k // 7 % 2])) for k in range(N)])
    table = read_table(path, Source())
    for joint in orders[0]:
        np.testing.assert_allclose(table.columns[f"/js.position[{joint}]"], angle(joint))
    with pytest.raises(InputError, match="elbow"):
        table.column("/js.position[0]")


def test_joints_called_as_units_are_joints(tmp_path):
    path = bag(tmp_path / "a.mcap", [("/js", logged(k), state(k, ["a", "m"])) for k in range(N)])
    axes = suggest(read_table(path, Source()), path).document["axes"]
    assert [(x["name"], x["position"]["unit"], x["torque"]["unit"]) for x in axes] == [
        ("a", "rad", "N·m"), ("m", "rad", "N·m"),
    ]  # fmt: skip
