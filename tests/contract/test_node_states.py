"""NMT, heartbeat, EMCY and the CiA 402 states of the simulated node, seen from the bus."""

import struct
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from node_master import Master, cell

# The standard's table, written out here: state bits (mask 0x6F), and per state the commands as
# (mask, value of the controlword's low byte, new state). Bit 7 is the fault reset.
SOD, RTSO, SO, OE, QSA, FAULT = 0x40, 0x21, 0x23, 0x27, 0x07, 0x08
SHUTDOWN, SWITCH_ON, ENABLE = (0x87, 0x06), (0x8F, 0x07), (0x8F, 0x0F)
DISABLE_VOLTAGE, QUICK_STOP = (0x82, 0x00), (0x86, 0x02)
TABLE: dict[int, list[tuple[tuple[int, int], int]]] = {
    SOD: [(SHUTDOWN, RTSO)],
    RTSO: [(SWITCH_ON, SO), (ENABLE, OE), (DISABLE_VOLTAGE, SOD), (QUICK_STOP, SOD)],
    SO: [(ENABLE, OE), (SHUTDOWN, RTSO), (DISABLE_VOLTAGE, SOD), (QUICK_STOP, SOD)],
    OE: [(SWITCH_ON, SO), (SHUTDOWN, RTSO), (DISABLE_VOLTAGE, SOD), (QUICK_STOP, QSA)],
    QSA: [(DISABLE_VOLTAGE, SOD), (ENABLE, OE)],
}


def expected(state: int, word: int) -> int:
    for (mask, value), target in TABLE[state]:
        if word & mask == value:
            return target
    return state


@pytest.fixture
def master() -> Iterator[Master]:
    made = Master(cell())
    yield made
    made.close()


def status(master: Master) -> int:
    return master.read(1, 0x6041, 0, "H") & 0x6F


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    words=st.lists(
        st.sampled_from([0, 2, 6, 7, 0x0F, 0x0B, 0x1F, 0x10F, 0x86, 0x80, 5, 0x0D]) | st.integers(0, 255),
        max_size=12,
    )
)
def test_any_sequence_of_controlwords_follows_the_standards_table(words: list[int]) -> None:
    master = Master(cell())
    try:
        # option 5: stays in quick stop active; at standstill disable operation has no ramp to wait for
        assert master.write(1, 0x605A, 0, "h", 6) == 0
        assert master.write(1, 0x605C, 0, "h", 0) == 0
        state = SOD
        assert status(master) == state
        for word in words:
            assert master.write(1, 0x6040, 0, "H", word) == 0
            state = expected(state, word)
            assert status(master) == state, f"controlword {word:#x}"
    finally:
        master.close()


@pytest.mark.parametrize(("option", "end"), [(0, SOD), (1, SOD), (2, SOD), (5, QSA), (6, QSA)])
def test_quick_stop_ends_where_its_option_code_says(master: Master, option: int, end: int) -> None:
    assert master.write(1, 0x605A, 0, "h", option) == 0
    master.prepare()
    master.enable()
    for _ in range(50):
        master.cycle([200], 0x0F)  # 20 N·m on 1 kg·m² for 50 ms: 1 rad/s
    for _ in range(10):
        last = master.cycle([0], 0x02)[1]
    if option:
        assert last[2] & 0x6F == QSA  # it takes time to stop from 1 rad/s
    for _ in range(700):
        last = master.cycle([0], 0x02)[1]
    assert last[2] & 0x6F == end
    if option:
        speed = abs(master.read(1, 0x606C, 0, "i")) / 524288 * 6.2832
        assert speed < 0.02


def test_a_fault_needs_an_edge_of_the_reset_bit_and_a_reset_does_not_enable(master: Master) -> None:
    master.prepare()
    for _ in range(3):
        master.cycle([0], 0x80)
    master.bus.cell.drives[0].fail(0x2310, 0x02, master.bus.wire.now_ns)
    for _ in range(20):
        answers = master.cycle([0], 0x80)
    assert answers[1][2] & 0x6F == FAULT
    master.cycle([0], 0x00)
    master.cycle([0], 0x80)
    for _ in range(5):  # bit 7 stays, then enable operation: still switch on disabled
        assert master.cycle([0], 0x80)[1][2] & 0x6F == SOD
    for _ in range(5):
        answers = master.cycle([0], 0x0F)
    assert answers[1][2] & 0x6F == SOD
    emergencies = [struct.unpack_from("<HB", d) for _, i, d in master.other if i == 0x81]
    assert emergencies[0][0] == 0x2310
    assert emergencies[-1] == (0, 0)


@pytest.mark.parametrize(("option", "state"), [(0, OE), (1, FAULT), (2, SOD), (3, SOD)])
def test_a_lost_heartbeat_of_the_master_ends_as_the_abort_connection_option_says(
    master: Master, option: int, state: int
) -> None:
    assert master.write(1, 0x6007, 0, "h", option) == 0
    assert master.write(1, 0x1016, 1, "I", 127 << 16 | 50) == 0
    master.prepare()
    master.put(0x77F, b"\x05")
    master.enable()
    for _ in range(30):
        master.cycle([100], 0x0F)
        master.put(0x77F, b"\x05")
    frames = master.wait(0.5)  # silence
    emergencies = [(t, struct.unpack_from("<H", d)[0]) for t, i, d in frames if i == 0x81]
    assert emergencies[0][1] == 0x8130
    assert status(master) == state
    if option:
        first, second = (master.read(1, 0x6064, 0, "i") for _ in range(2))
        assert abs(first - second) <= 2  # it stands: brake or ramp
