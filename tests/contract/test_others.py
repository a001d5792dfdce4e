"""Other masters on the bus: named before anything is sent, and in the middle of a run. Judged on the wire."""

from pathlib import Path
from typing import Any

import can
import pytest
from stepping import energise, exchange, set_modes
from test_adapter_promises import config, held, zero
from test_mode_change import small

from invid.errors import BusError
from invid.planning import make_plan
from invid.sweep import Mode, Severity
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cli.init import quiet_link
from invid_drivers.measurement import run_measurement
from invid_drivers.simulated import VirtualTimeBus, open_virtual_bus

MASTERS = [
    (0x080, b"", "SYNC"),
    (0x000, b"\x81\x00", "NMT 'reset node' to all nodes"),
    (0x000, b"\x80\x02", r"NMT 'pre-operational' to node 2 \(axis A2\)"),
    (0x201, bytes(4), r"RPDO 1 to node 1 \(axis A1\)"),
    (0x405, bytes(4), "RPDO 3 to node 5"),
    (0x601, b"\x40\x00\x10\x00\0\0\0\0", "an SDO request to node 1"),
    (0x77F, b"\x05", "a heartbeat with our own node id 127"),
    (0x7E5, bytes(8), "LSS"),
]


def repeat(bus: VirtualTimeBus, cob: int, data: bytes, *, begin_s: float, every_s: float = 0.5) -> None:
    """Somebody else's frame, on the wire of the cell, again and again."""
    cell = bus.cell

    def send(now_ns: int) -> None:
        bus.wire._from_node(cob, data)
        cell.schedule(now_ns + round(every_s * 1e9), send)

    cell.schedule(round(begin_s * 1e9), send)


class Sent:
    """What the master sent."""

    def __init__(self, bus: VirtualTimeBus, *, echo: bool = False) -> None:
        self.frames: list[tuple[float, int, bytes]] = []
        self._bus, self._send, self._echo = bus, bus.send, echo
        bus.send = self  # type: ignore[method-assign,assignment]

    def __call__(self, msg: can.Message, timeout: float | None = None) -> None:
        self.frames.append((self._bus.clock.now(), msg.arbitration_id, bytes(msg.data)))
        if self._echo:  # as an adapter that gives back what it has sent
            self._bus._inbox.append((self._bus.wire.now_ns, msg.arbitration_id, bytes(msg.data)))
        self._send(msg, timeout)


@pytest.mark.parametrize(("cob", "data", "name"), MASTERS)
def test_another_master_is_named_before_anything_is_sent(cob: int, data: bytes, name: str) -> None:
    cfg = config()
    bus = open_virtual_bus(cfg)
    sent = Sent(bus)
    repeat(bus, cob, data, begin_s=0.7)
    cell = Cia402Cell(bus, cfg)
    with pytest.raises(BusError, match=rf"another master is on this bus: {name}.*nothing was sent"):
        cell.check()
    cell.close()
    assert sent.frames == []


@pytest.mark.parametrize(("cob", "data", "name", "echo"), [(*m, k % 2 == 0) for k, m in enumerate(MASTERS)])
def test_another_master_in_the_middle_of_a_run_stops_the_axes_within_two_cycles(
    cob: int, data: bytes, name: str, echo: bool, tmp_path: Path
) -> None:
    cfg = small(config())
    bus = open_virtual_bus(cfg)
    sent = Sent(bus, echo=echo)
    repeat(bus, cob, data, begin_s=9.0, every_s=1000.0)
    with pytest.raises(BusError, match=f"another master is on this bus: {name}.*axes were stopped"):
        run_measurement(cfg, make_plan(cfg), Cia402Cell(bus, cfg), tmp_path / "run.h5")
    stops = [t for t, i, d in sent.frames if i == 0x201 and d[:2] in (b"\x02\x00", b"\x00\x00") and t > 8.9]
    assert stops[0] - 9.0 <= 2 * 0.002
    assert all(d.state.name in {"SWITCH_ON_DISABLED", "FAULT"} for d in bus.cell.drives)


def test_an_adapter_that_gives_back_what_it_sends_is_no_other_master(tmp_path: Path) -> None:
    cfg = small(config())
    bus = open_virtual_bus(cfg)
    Sent(bus, echo=True)
    result = run_measurement(cfg, make_plan(cfg), Cia402Cell(bus, cfg), tmp_path / "run.h5")
    assert str(result.outcome) == "completed"


def test_another_slave_is_left_alone_and_noted() -> None:
    cfg = config()
    bus = open_virtual_bus(cfg)
    sent = Sent(bus)
    for cob, data in (
        (0x70A, b"\x05"),
        (0x18A, bytes(8)),
        (0x08A, bytes(8)),
        (0x701, b"\x7f"),
        (0x281, b"\0"),
    ):
        repeat(bus, cob, data, begin_s=0.2, every_s=0.1)
    cell = Cia402Cell(bus, cfg)
    cell.check()
    energise(cell, held(cell))
    set_modes(cell, [Mode.TORQUE, Mode.HOLD])
    for _ in range(300):
        assert not [e for e in exchange(cell, zero(cell)).events if e.severity is not Severity.NOTE]
    assert cell.notes == ("node 10 is on the bus too, is not in the config, and is left alone",)
    assert cell.close() == []
    commands = {d[1] for _, i, d in sent.frames if i == 0}
    assert commands == {1, 2}  # NMT to the nodes of the config and nobody else
    assert not [i for _, i, _ in sent.frames if i & 0x7F == 10]


def test_a_drive_that_watches_the_heartbeat_of_another_node_on_the_bus_belongs_to_that_master() -> None:
    cfg = config({"defaults": {"rated_torque_Nm": 10, "objects": {"values": {"0x1016:1": 5 << 16 | 1000}}}})
    bus = open_virtual_bus(cfg)
    repeat(bus, 0x705, b"\x05", begin_s=0.2, every_s=0.2)
    cell = Cia402Cell(bus, cfg)
    with pytest.raises(BusError, match=r"A1 .*watches the heartbeat of node 5 \(0x1016\)"):
        cell.check()
    cell.close()


def test_a_scan_asks_nobody_where_another_master_is() -> None:
    cfg = config()
    bus = open_virtual_bus(cfg)
    sent = Sent(bus)
    repeat(bus, 0x80, b"", begin_s=0.1, every_s=0.01)
    with pytest.raises(BusError, match="SYNC"):
        quiet_link(bus)
    assert sent.frames == []


def test_check_beside_another_master_leaves_its_drives_as_they_are() -> None:
    """The other master's drives run on node ids of our config too: the worst case."""
    cfg = config()
    bus = open_virtual_bus(cfg)
    first = Cia402Cell(bus, cfg)
    first.check()
    energise(first, held(first))
    second = Cia402Cell(can.Bus(interface="invid-virtual", channel="promises"), cfg)
    wait: Any = second._link.wait

    def side_by_side(seconds: float) -> None:
        """The first master's cycles while the second one listens."""
        for _ in range(round(seconds / 0.002)):
            exchange(first, zero(first))
        wait(0.0)
        while (message := second._link.get(0)) is not None:
            second._link.sort(message)

    second._link.wait = side_by_side  # type: ignore[method-assign]
    with pytest.raises(BusError, match="SYNC"):
        second.check()
    assert second.close() == []
    assert not [e.text for e in exchange(first, zero(first)).events]
    assert [d.state.name for d in bus.cell.drives] == ["OPERATION_ENABLED"] * 2
    first.close()
