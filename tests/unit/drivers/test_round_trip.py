"""Round trips of an adapter: how many samples bound what, which cycle follows, what is refused."""

import collections
import contextlib
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest
import yaml

from invid.cli.app import run
from invid.config import CellConfig, parse_config
from invid.planning import make_plan
from invid.planning.budget import judge
from invid_drivers.cia402.link import Link
from invid_drivers.cli import init
from invid_drivers.round_trip import probe, require

ROOT = Path(__file__).parents[3]


class SlowBus(can.BusABC):
    """Nodes that answer 0x1000 and nothing else, behind an adapter that takes a time of its own each way."""

    def __init__(
        self, nodes: tuple[int, ...], adapter_s: float, sdo_s: dict[int, float] | None = None
    ) -> None:
        super().__init__(channel="slow")
        self.nodes, self.adapter_s, self.sdo_s = nodes, adapter_s, sdo_s or {}
        self.asked: list[tuple[int, bytes]] = []
        self._coming: collections.deque[tuple[float, can.Message]] = collections.deque()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.asked.append((msg.arbitration_id, bytes(msg.data)))
        node = msg.arbitration_id - 0x600
        if node not in self.nodes:
            return
        ready = time.monotonic() + self.adapter_s + self.sdo_s.get(node, 0.0)
        answer = bytes((0x43, 0x00, 0x10, 0x00)) + (402).to_bytes(4, "little")
        self._coming.append(
            (ready, can.Message(arbitration_id=0x580 + node, data=answer, is_extended_id=False))
        )
        self._coming = collections.deque(sorted(self._coming, key=lambda c: c[0]))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        end = time.monotonic() + (timeout or 0.0)
        while time.monotonic() < end:
            if self._coming and self._coming[0][0] <= time.monotonic():
                return self._coming.popleft()[1]
            time.sleep(0.00005)
        return None

    def shutdown(self) -> None:
        super().shutdown()


@contextlib.contextmanager
def slow(nodes: tuple[int, ...], adapter_s: float, **sdo: Any) -> Iterator[Link]:
    bus = SlowBus(nodes, adapter_s, **sdo)
    try:
        link = Link(bus, heartbeat_s=0.1)
        link.gate.listened = True
        yield link
    finally:
        bus.shutdown()


def hardware(cycle_s: float = 0.001, **bus: Any) -> CellConfig:
    document = yaml.safe_load((ROOT / "configs" / "case-study-unix.yaml").read_text(encoding="utf-8"))
    del document["simulation"]
    document["bus"] |= {"cycle_s": cycle_s, **bus}
    document["safety"] = {"missed_tpdos": 5}
    return parse_config(yaml.safe_dump(document))


def test_a_drive_that_answers_sdo_after_most_of_a_second_is_named_as_slow_and_no_adapter() -> None:
    config = hardware(0.004)
    with slow((1, 2, 3), 0.0005, sdo_s=dict.fromkeys((1, 2, 3), 0.8)) as link:
        found = probe(link, config, make_plan(config))
    (said,) = require(found, config)
    assert "drives are slow to answer SDO: 0.8 s" in said
    assert "the adapter's round trip is" not in said
    stated = hardware(0.004, round_trip_s=0.001)
    again = judge([0.8, 0.8], stated, cycles=1000, loaded_s=0.001)
    (said,) = require(again, stated)
    assert "slow to answer SDO" in said
    assert "too late" not in said


def test_a_round_trip_that_is_stated_decides_instead_of_the_probe() -> None:
    samples = [0.004] * 600
    plain, stated = hardware(0.002), hardware(0.002, round_trip_s=0.0004)
    cycles = 10_000
    assert not judge(samples, plain, cycles=cycles, loaded_s=0.001).carries
    found = judge(samples, stated, cycles=cycles, loaded_s=0.001)
    assert found.carries
    assert found.shortest_cycle_s == 0.002


def test_init_proposes_the_cycle_that_the_adapter_carries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(init, "open_bus", lambda _: SlowBus((1, 2), 0.004))
    monkeypatch.setattr(init, "ANSWER_S", 0.012)  # 125 silent ids are asked twice
    out = tmp_path / "cell.yaml"
    assert run(["init", "--channel", "slow", "-o", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["round_trip_ms"] >= 4.0
    written = yaml.safe_load(out.read_text(encoding="utf-8"))
    assert 0.005 <= written["bus"]["cycle_s"] <= 0.05
    parse_config(out.read_text(encoding="utf-8"))
