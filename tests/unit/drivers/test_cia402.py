"""The master's side of CiA 402: statuswords, steps, scalings, journal; fuzzed frames."""

import json
from pathlib import Path

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from invid.errors import BusError
from invid_drivers.cia402.journal import Entry, Journal
from invid_drivers.cia402.link import Link
from invid_drivers.cia402.stated.scales import position_per_count
from invid_drivers.cia402.states import DriveState, towards_enabled

S = DriveState


# The standard's transitions that a controlword may cause: (state, controlword) -> state.
STEPS = {
    (S.SWITCH_ON_DISABLED, 0x06): S.READY_TO_SWITCH_ON,
    (S.READY_TO_SWITCH_ON, 0x07): S.SWITCHED_ON,
    (S.SWITCHED_ON, 0x0F): S.OPERATION_ENABLED,
    (S.OPERATION_ENABLED, 0x0F): S.OPERATION_ENABLED,
    (S.QUICK_STOP_ACTIVE, 0x00): S.SWITCH_ON_DISABLED,
}


@pytest.mark.parametrize(
    "start", [S.SWITCH_ON_DISABLED, S.READY_TO_SWITCH_ON, S.SWITCHED_ON, S.QUICK_STOP_ACTIVE]
)
def test_the_masters_steps_lead_to_operation_enabled_by_the_standards_transitions(start: DriveState) -> None:
    state = start
    for _ in range(5):
        state = STEPS[(state, towards_enabled(state))]
    assert state is S.OPERATION_ENABLED


@pytest.mark.parametrize("state", [S.FAULT, S.FAULT_REACTION_ACTIVE])
def test_a_fault_is_never_reset_by_the_master(state: DriveState) -> None:
    assert not towards_enabled(state) & 0x80


def test_a_count_comes_from_the_encoder_resolution_or_the_feed_constant_and_one_and_one_say_nothing() -> None:
    tau = 6.283185307179586
    assert position_per_count(4096, 1) == pytest.approx(tau / 4096)
    assert position_per_count(500_000, 1, linear=True) == pytest.approx(2e-6)
    assert position_per_count(0, 1) is None
    assert position_per_count(4096, 0) is None
    assert position_per_count(1, 1) is None


def test_the_journal_survives_a_power_cut_in_the_middle_of_a_line(tmp_path: Path) -> None:
    path = tmp_path / "bus.journal"
    journal = Journal(path)
    first, second = Entry(1, 7, 0x6072, 0, "e803"), Entry(1, 7, 0x605A, 0, "0200")
    journal.add(first)
    journal.add(second)
    with path.open("a") as file:
        file.write('{"node_id": 1, "serial": 7, "ind')
    again = Journal(path)
    assert again.entries == (first, second)
    assert again.of_node(1) == (second, first)
    again.keep(1, ())
    assert not path.exists()


def test_the_journal_keeps_the_other_nodes_when_one_is_restored(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "bus.journal")
    for node in (1, 2):
        journal.add(Entry(node, 0, 0x6072, 0, "0000"))
    journal.keep(1, ())
    lines = (tmp_path / "bus.journal").read_text().splitlines()
    assert [json.loads(line)["node_id"] for line in lines] == [2]


def test_a_journal_that_cannot_be_written_forbids_the_write(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(BusError, match="XDG_STATE_HOME"):
        Journal(blocked / "bus.journal").add(Entry(1, 0, 0x6072, 0, "00"))


class SilentBus(can.BusABC):
    """Takes everything, says nothing."""

    def __init__(self) -> None:
        self.channel_info = "silent"
        super().__init__(channel="silent")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Swallow."""

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return None, False


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 0x7F), st.binary(max_size=8))
def test_no_frame_of_a_known_node_crashes_the_link(function: int, data: bytes) -> None:
    link = Link(SilentBus(), heartbeat_s=0.1)
    link.add_peer(1, "A1")
    link.sdo(1)
    link.sort(can.Message(arbitration_id=(function & 0xF) << 7 | 1, data=data, is_extended_id=False))


def test_an_emergency_that_says_the_error_is_gone_is_no_fault() -> None:
    link = Link(SilentBus(), heartbeat_s=0.1)
    link.add_peer(1, "A1")
    link.sort(can.Message(arbitration_id=0x81, data=bytes(8), is_extended_id=False))
    assert link.events == []
