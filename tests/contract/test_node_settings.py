"""What a cell's settings do to the simulated drives: vendors, delays, direction, linear axes, modes."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from node_master import Master, cell


def with_axis(**keys: Any) -> Master:
    return Master(cell({"axes": {"A1": keys}}))


@pytest.mark.parametrize(
    ("profile", "missing", "values"),
    [
        ("generic", [], {0x605A: 2, 0x6007: 1}),
        ("epos4", [0x6072, 0x608F, 0x6091], {0x6076: 0, 0x605A: 6, 0x6007: 3}),
        ("elmo_gold", [], {0x6076: 0, 0x605A: 2, 0x6007: 1}),
        ("nanotec_c5e", [0x6076, 0x6007, 0x1016], {0x6072: 0, 0x605A: 1}),
        ("zeroerr_erob", [0x6072, 0x605A, 0x6007, 0x608F], {}),
        ("pilz", [0x6071, 0x6072, 0x6076, 0x605A, 0x6007], {}),
        ("faulhaber_3150", [0x6071, 0x6072, 0x6076, 0x6077, 0x605A, 0x6007], {}),
    ],
)
def test_a_profile_lacks_what_the_vendor_lacks(
    profile: str, missing: list[int], values: dict[int, int]
) -> None:
    master = with_axis(objects={"profile": profile})
    for index in missing:
        request = struct.pack("<BHB4x", 0x40, index, 0)
        assert master.abort_code(1, request) == 0x06020000, hex(index)
    for index, value in values.items():
        assert master.read(1, index, 0, "I" if index == 0x6076 else "H") == value, hex(index)
    assert master.read(1, 0x6064, 0, "i") == 0
    master.close()


@pytest.mark.parametrize(("delay", "lag"), [(0, 0), (1, 0), (2, 0), (0, 1), (1, 2)])
def test_a_step_of_torque_acts_and_shows_after_the_cycles_set(delay: int, lag: int) -> None:
    master = with_axis(command_delay_cycles=delay, actual_torque_lag_cycles=lag)
    master.prepare()
    master.enable()
    log = [master.cycle([0], 0x0F)[1] for _ in range(5)]
    log = [master.cycle([300], 0x0F)[1] for _ in range(12)]
    # the target goes out behind SYNC 0: valid with SYNC 1, acting from SYNC 1 + delay, seen one later
    assert [entry[1] for entry in log].index(300) == 2 + delay + lag
    moved = [abs(entry[0]) > 0 for entry in log].index(True)
    assert moved == 2 + delay  # 30 N·m on 1 kg·m² for a millisecond: 1.25 counts
    master.close()
