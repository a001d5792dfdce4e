"""Injected faults do what they say; garbage on the bus never breaks a node."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from node_master import Master, cell


def test_a_node_whose_cable_is_pulled_stops_by_its_own_heartbeat_watch() -> None:
    master = Master(
        cell(
            {
                "faults": [
                    {"kind": "node_silent", "axis": "A1", "at_state": "operation_enabled", "after_s": 0.05}
                ]
            }
        )
    )
    assert master.write(1, 0x1016, 1, "I", 127 << 16 | 30) == 0
    master.prepare()
    master.put(0x77F, b"\x05")
    master.enable()
    for _ in range(400):
        answers = master.cycle([100], 0x0F)
        master.put(0x77F, b"\x05")
    assert not answers
    assert master.bus.cell.drives[0].state.name == "FAULT"
    assert abs(float(master.bus.cell.plant.velocities[0])) < 1e-9
    master.close()


@settings(max_examples=60, deadline=None)
@given(
    frames=st.lists(
        st.tuples(
            st.integers(0, 0x7FF) | st.sampled_from([0, 0x80, 0x201, 0x301, 0x601, 0x77F]),
            st.binary(max_size=8),
        ),
        max_size=40,
    )
)
def test_random_frames_never_break_a_node(frames: list[tuple[int, bytes]]) -> None:
    master = Master(cell(axes=2))
    try:
        assert master.write(1, 0x1016, 1, "I", 0x7F0064) == 0
        master.put(0, b"\x01\x00")
        for can_id, data in frames:
            master.put(can_id, data)
            master.wait(0.0005)
        master.put(0, b"\x81\x00")  # reset: whatever it was in, it comes back
        master.wait(0.1)
        assert master.read(1, 0x1000) == 0x00020192
        assert np.isfinite(master.bus.cell.plant.state).all()
    finally:
        master.close()
