"""What may leave for the bus: before it is known who is there, to nodes that nobody read, under power."""

import struct

import can
import pytest

from invid_drivers.cia402.gate import Gate, NotPermitted, Peer

OFF, ENABLED, HELD = 0x0240, 0x0227, 0x0207
NODE, OTHER = 5, 6


def frame(cob: int, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=cob, data=data, is_extended_id=False)


def write(index: int, sub: int, value: int, node: int = NODE) -> can.Message:
    return frame(0x600 + node, struct.pack("<BHBI", 0x23, index, sub, value))


def answer(index: int, sub: int, value: int, node: int = NODE) -> tuple[int, bytes]:
    return 0x580 + node, struct.pack("<BHBI", 0x43, index, sub, value)


READ = frame(0x600 + NODE, b"\x40\x41\x60\0\0\0\0\0")
NMT = frame(0, bytes([0x80, NODE]))
RPDO = frame(0x200 + NODE, b"\x0f\0\0\0")
SYNC, BEAT = frame(0x80), frame(0x77F, b"\x05")


def gate(status: int | None = None, *, ours: bool = False) -> Gate:
    made = Gate()
    made.nodes[NODE] = Peer(NODE, "A1")
    made.listened = True
    if status is not None:
        made.heard(*answer(0x6041, 0, status))
    if ours:
        made.take(NODE)
    return made


def kept_back(found: Gate, message: can.Message) -> bool:
    try:
        found.pass_out(message)
    except NotPermitted:
        return True
    return False


def test_before_the_listening_is_over_nothing_leaves() -> None:
    closed = gate(OFF, ours=True)
    closed.listened = False
    assert all(kept_back(closed, m) for m in (READ, NMT, SYNC, BEAT, write(0x6072, 0, 1)))
    assert gate().said == "nothing was sent"


@pytest.mark.parametrize("message", [NMT, RPDO, SYNC, write(0x6040, 0, 0), write(0x1017, 0, 100)])
def test_a_node_that_was_not_read_is_only_asked(message: can.Message) -> None:
    found = gate()
    assert not kept_back(found, READ)
    assert kept_back(found, message)
    assert found.said == "nothing but questions was sent"


@pytest.mark.parametrize("status", [ENABLED, HELD])
def test_a_node_under_power_that_is_not_ours_is_only_asked(status: int) -> None:
    found = gate(status)
    assert not kept_back(found, READ)
    assert all(kept_back(found, m) for m in (NMT, RPDO, write(0x6040, 0, 0), write(0x6072, 0, 1)))


def test_a_node_that_is_off_may_be_written_until_another_master_is_heard() -> None:
    found = gate(OFF)
    assert not kept_back(found, NMT)
    assert not kept_back(found, write(0x6072, 0, 1))
    assert kept_back(found, RPDO)
    assert found.said == "nothing was moved"
    found.disputed = True
    assert kept_back(found, NMT)
    assert kept_back(found, write(0x6072, 0, 1))


def test_our_own_axes_are_brought_to_rest_whoever_else_speaks() -> None:
    found = gate(ENABLED, ours=True)
    found.disputed = True
    assert not any(kept_back(found, m) for m in (RPDO, SYNC, BEAT, NMT, write(0x6040, 0, 0)))
    assert found.said == "the axes were stopped"


@pytest.mark.parametrize(
    ("index", "sub", "found", "tighter", "wider"),
    [
        (0x6072, 0, 300, 200, 400), (0x607D, 1, -1000 & 0xFFFFFFFF, -500 & 0xFFFFFFFF, -2000 & 0xFFFFFFFF),
        (0x607D, 2, 1000, 500, 2000), (0x607F, 0, 999, 900, 1000), (0x6065, 0, 10, 5, 0xFFFFFFFF),
        (0x1016, 1, 0x7F0064, 0x7F0032, 0x7F0200), (0x6085, 0, 100, 200, 50),
    ],
)  # fmt: skip
def test_under_power_no_write_permits_more_than_was_found(
    index: int, sub: int, found: int, tighter: int, wider: int
) -> None:
    held_axis = gate(HELD, ours=True)
    assert kept_back(held_axis, write(index, sub, tighter))  # nobody has looked what stands there
    held_axis.heard(*answer(index, sub, found))
    assert not kept_back(held_axis, write(index, sub, tighter))
    assert kept_back(held_axis, write(index, sub, wider))
    off = gate(OFF, ours=True)
    assert not kept_back(off, write(index, sub, wider))


def test_nobody_elses_node_is_commanded_and_one_that_waits_for_a_person_is_only_asked() -> None:
    found = gate(OFF)
    assert kept_back(found, frame(0, bytes([0x80, OTHER])))
    assert kept_back(found, frame(0, bytes([0x80, 0])))
    assert kept_back(found, write(0x6040, 0, 0, node=OTHER))
    found.nodes[NODE].left_alone = True
    assert kept_back(found, NMT)
    assert not kept_back(found, READ)


def test_a_restart_makes_a_node_unread_and_one_that_says_nmt_stopped_may_be_set_pre_operational() -> None:
    found = gate(OFF)
    found.heard(0x700 + NODE, b"\0")
    assert kept_back(found, NMT)
    found.heard(0x700 + NODE, b"\x04")
    assert not kept_back(found, NMT)
