"""CAN over AF_UNIX: several ports, order, loss of the other side."""

import os
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from invid_drivers.simulated.unix_bus import UnixBus, UnixHub


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[UnixHub]:
    made = UnixHub(str(tmp_path / "bus.sock"))
    yield made
    made.shutdown()


def path_of(hub: UnixHub) -> str:
    return hub.channel_info.removeprefix("invid-unix hub ")


def message(can_id: int, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def test_frames_reach_all_other_ports_in_order(hub: UnixHub) -> None:
    with UnixBus(path_of(hub)) as a, UnixBus(path_of(hub)) as b:
        assert hub.recv(0.1) is None  # let it accept
        for number in range(20):
            a.send(message(0x100 + number, bytes([number])))
        at_hub = [hub.recv(1.0) for _ in range(20)]
        at_b = [b.recv(1.0) for _ in range(20)]
        for got in (at_hub, at_b):
            assert [m.arbitration_id for m in got if m] == list(range(0x100, 0x114))
        assert a.recv(0.0) is None  # not its own
        hub.send(message(0x700))
        assert [m.arbitration_id for m in (a.recv(1.0), b.recv(1.0)) if m] == [0x700, 0x700]


def test_a_port_that_leaves_or_stops_reading_does_not_disturb_the_others(hub: UnixHub) -> None:
    gone, deaf, good = (UnixBus(path_of(hub)) for _ in range(3))
    hub.recv(0.05)
    assert len(hub._ports) == 3
    gone.shutdown()
    received = 0
    for _ in range(5000):
        hub.send(message(0x80))
        received += good.recv(0.5) is not None
    assert received == 5000
    hub.recv(0.05)
    assert len(hub._ports) == 1  # the deaf one's queue has overflowed
    good.shutdown()
    deaf.shutdown()


def test_the_socket_is_the_owners_alone(hub: UnixHub) -> None:
    assert os.stat(path_of(hub)).st_mode & 0o077 == 0
