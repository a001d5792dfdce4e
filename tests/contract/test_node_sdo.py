"""SDO server and PDO mapping of the simulated node, against CiA 301's codes."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import pytest
from node_master import Master, cell


@pytest.fixture
def master() -> Iterator[Master]:
    made = Master(cell())
    yield made
    made.close()


def upload(index: int, sub: int = 0) -> bytes:
    return struct.pack("<BHB4x", 0x40, index, sub)


def download(index: int, sub: int, data: bytes) -> bytes:
    return struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub) + data.ljust(4, b"\0")


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (upload(0x5FFF), 0x06020000),  # object does not exist
        (upload(0x1018, 9), 0x06090011),  # subindex does not exist
        (upload(0x0005), 0x06010001),  # a dummy is write-only
        (download(0x6064, 0, b"\0\0\0\0"), 0x06010002),  # actual position is read-only
        (download(0x1008, 0, b"abcd"), 0x06010002),
        (download(0x6040, 0, b"\0"), 0x06070013),  # too short
        (download(0x6040, 0, b"\0\0\0\0"), 0x06070012),  # too long
        (download(0x6060, 0, b"\x07"), 0x06090030),  # interpolated position is not supported
        (download(0x1010, 1, b"evas"), 0x08000020),  # wrong signature
        (b"\xa0\x00\x10\x00\0\0\0\0", 0x05040001),  # block upload is not implemented
        (b"\x60\0\0\0\0\0\0\0", 0x05040001),  # a segment without a transfer
        (b"\x00\0\0\0\0\0\0\0", 0x05040001),
        (download(0x1016, 1, struct.pack("<I", 100)), 0x06090030),  # a timeout without a producer
        (download(0x1003, 0, b"\x01"), 0x06090030),  # the history can only be cleared
    ],
)
def test_a_wrong_request_is_aborted_with_its_code(master: Master, request_: bytes, code: int) -> None:
    assert hex(master.abort_code(1, request_)) == hex(code)


def test_a_name_longer_than_four_bytes_comes_in_segments(master: Master) -> None:
    first = master.answer(1, upload(0x100A))
    assert first[0] == 0x41
    length = struct.unpack_from("<I", first, 4)[0]
    text, toggle = b"", 0
    while True:
        part = master.answer(1, bytes([0x60 | toggle]) + bytes(7))
        assert part[0] & 0x10 == toggle
        text += part[1 : 8 - (part[0] >> 1 & 7)]
        if part[0] & 1:
            break
        toggle ^= 0x10
    assert len(text) == length
    assert text == b"invid simulated drive"


def test_a_segment_with_the_wrong_toggle_bit_ends_the_transfer(master: Master) -> None:
    master.answer(1, upload(0x100A))
    assert master.abort_code(1, bytes([0x70]) + bytes(7)) == 0x05030000
    assert master.abort_code(1, bytes([0x60]) + bytes(7)) == 0x05040001


def test_a_segmented_download_writes_the_value(master: Master) -> None:
    assert master.answer(1, struct.pack("<BHBI", 0x21, 0x6084, 0, 4))[0] == 0x60
    assert master.answer(1, bytes([0x00 | (5 << 1)]) + b"\x11\x22" + bytes(5))[0] == 0x20
    assert master.answer(1, bytes([0x10 | (5 << 1) | 1]) + b"\x33\x44" + bytes(5))[0] == 0x30
    assert master.read(1, 0x6084) == 0x44332211


def test_a_pdo_is_remapped_only_by_the_procedure(master: Master) -> None:
    valid = master.read(1, 0x1400, 1)
    assert not valid & 0x80000000
    assert master.write(1, 0x1600, 0, "B", 0) == 0x06010000  # still valid
    assert master.write(1, 0x1400, 1, "I", 0x301) == 0x06090030  # new identifier while valid
    assert master.write(1, 0x1400, 1, "I", 0x80000201) == 0
    assert master.write(1, 0x1600, 1, "I", 0x60710010) == 0x06010000  # count not zero
    assert master.write(1, 0x1600, 0, "B", 0) == 0
    assert master.write(1, 0x1600, 1, "I", 0x60640020) == 0x06040041  # cannot be received
    assert master.write(1, 0x1600, 1, "I", 0x60710008) == 0x06040041  # wrong length
    assert master.write(1, 0x1600, 1, "I", 0x5FFF0010) == 0x06020000
    for sub, value in ((1, 0x607A0020), (2, 0x60FF0020), (3, 0x60400010)):
        assert master.write(1, 0x1600, sub, "I", value) == 0
    assert master.write(1, 0x1600, 0, "B", 3) == 0x06040042  # ten bytes
    assert master.write(1, 0x1600, 0, "B", 2) == 0
    assert master.write(1, 0x1400, 1, "I", 0x201) == 0
    assert master.read(1, 0x1600, 0, "B") == 2


def test_a_dummy_fills_a_receive_pdo(master: Master) -> None:
    master.map_pdo(1, "r", 1, [0x00060010, 0x60710010, 0x60400010])
    master.bus.send_raw(0, b"\x01\x01")
    master.bus.send_raw(0x201, struct.pack("<HhH", 0xFFFF, 77, 6))
    master.wait(0.001)
    assert master.read(1, 0x6071, 0, "h") == 0  # synchronous: not before SYNC
    master.bus.send_raw(0x80, b"")
    master.wait(0.001)
    assert master.read(1, 0x6071, 0, "h") == 77


def test_a_receive_pdo_that_is_too_short_is_reported_and_changes_nothing(master: Master) -> None:
    master.prepare()
    master.bus.send_raw(0x201, b"\x10\x00\x06")
    frames = master.wait(0.005)
    emergencies = [data for _, can_id, data in frames if can_id == 0x81]
    assert [struct.unpack_from("<H", d)[0] for d in emergencies] == [0x8210]
    assert master.read(1, 0x6040, 0, "H") == 0


def test_stored_parameters_survive_a_reset_and_others_do_not(master: Master) -> None:
    assert master.write(1, 0x6072, 0, "H", 500) == 0
    assert master.write(1, 0x1010, 1, "I", 0x65766173) == 0
    assert master.write(1, 0x6072, 0, "H", 900) == 0
    master.bus.send_raw(0, b"\x81\x01")
    assert any(f[1:] == (0x701, b"\0") for f in master.wait(0.02))
    assert master.read(1, 0x6072, 0, "H") == 500
    assert master.write(1, 0x1011, 1, "I", 0x64616F6C) == 0
    master.bus.send_raw(0, b"\x81\x01")
    master.wait(0.02)
    assert master.read(1, 0x6072, 0, "H") == 3000
