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
