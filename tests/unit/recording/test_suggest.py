"""``--suggest`` on files as people have them: all of them described, no time or side taken for granted."""

import numpy as np
import pytest
from foreign_records import imported, suggested, table

ROW = np.arange(1500)
TIME = ROW * 1e-3
ANGLE = 0.4 * np.sin(9 * TIME)
TORQUE = 3.0 * np.sin(9 * TIME + 0.3)


@pytest.mark.parametrize("motion", [ANGLE, ANGLE + 0.7 * TIME * (1 + TIME)], ids=["to and fro", "one way"])
def test_a_file_without_names_has_its_time_where_the_clock_is(tmp_path, capsys, motion):
    last = suggested(capsys, table(tmp_path / "a.csv", [], motion, TORQUE, TIME))
    assert last["map"]["time"] == {"column": "column2", "unit": "s"}
    first = suggested(capsys, table(tmp_path / "b.csv", [], TIME, motion, TORQUE))
    assert first["map"]["time"] == {"column": "time", "unit": "s"}


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        (np.mod(1e6 * TIME + 2**32 - 5e5, 2**32), "2^32 µs"),
        (np.mod(1e3 * TIME + 59_500, 60_000), "a whole minute"),
        (np.full(ROW.size, 7.0), "all the same"),
        (np.floor(TIME / 2e-3) * 2e-3, "sample_rate_hz: 1000"),
    ],
    ids=["32 bits", "minute", "constant", "coarse"],
)
def test_what_the_stamps_are_is_said(tmp_path, capsys, stamps, said):
    name = "time_us" if stamps.max() > 1e6 else "time_ms" if stamps.max() > 1e3 else "time"
    source = table(tmp_path / "a.csv", [name, "position_rad", "torque_Nm"], stamps, ANGLE, TORQUE)
    found = suggested(capsys, source)
    assert said in " ".join([*found["reasons"], *found["fill_in"].values()])


@pytest.mark.parametrize(
    ("torque", "motion"),
    [
        ("motor_torque_Nm", "link_angle_deg"),
        ("tau_motor [Nm]", "q_load [rad]"),
        ("joint_torque", "motor_pos"),
    ],
)
def test_torque_of_one_side_is_paired_with_motion_of_the_other_in_doubt_alone(
    tmp_path, capsys, torque, motion
):
    found = suggested(capsys, table(tmp_path / "a.csv", ["t", torque, motion], TIME, TORQUE, ANGLE))
    assert any("must be of one side" in u for u in found["unsure"])
    plain = suggested(capsys, table(tmp_path / "b.csv", ["t", "torque", "pos"], TIME, TORQUE, ANGLE))
    assert not any("side" in u for u in plain["unsure"])


@pytest.mark.parametrize(
    ("stamps", "unit"),
    [(2.0 * ROW, None), (1.7e12 + 2.0 * ROW, "ms"), (1.7e15 + 2000.0 * ROW, "us"), (2e-3 * ROW, "s")],
    ids=["may be ms or us", "ms since 1970", "us since 1970", "s"],
)
def test_a_unit_of_time_is_asked_where_the_file_does_not_tell_it(tmp_path, capsys, stamps, unit):
    path = tmp_path / "a.csv"
    rows = [f"{t:.17g},{a},{b}" for t, a, b in zip(stamps, ANGLE, TORQUE, strict=True)]
    path.write_text("\n".join(["time,position_rad,torque_Nm", *rows]), encoding="utf-8")
    found = suggested(capsys, path)
    assert found["map"]["time"] == {"column": "time", "unit": unit}
    assert ("time.unit" in found["fill_in"]) == (unit is None)


@pytest.mark.parametrize(
    ("header", "row"),
    [
        (
            "%time,field.header.seq,field.header.frame_id,field.name0,field.position0,field.effort0",
            "{ns},{k},,elbow,{q},{u}",
        ),
        ("Time;State;Position [rad];Torque [Nm]", "{t};OPERATION ENABLED;{q};{u}"),
        ("t,mode,position,torque,note", "{t},RUN,{q},{u},ok"),
    ],
    ids=["rostopic echo -p", "a drive's state", "words at the end"],
)  # fmt: skip
def test_columns_of_words_are_left_beside_the_numbers(tmp_path, capsys, header, row):
    path = tmp_path / "a.csv"
    rows = [
        row.format(
            ns=1_700_000_000_000_000_000 + 1_000_000 * k, k=k, t=f"{t:.4f}", q=f"{q:.6f}", u=f"{u:.6f}"
        )
        for k, (t, q, u) in enumerate(zip(TIME, ANGLE, TORQUE, strict=True))
    ]
    path.write_text("\n".join([header, *rows]), encoding="utf-8")
    found = suggested(capsys, path)
    assert found["fill_in"] == {}
    e = imported(tmp_path, path, found["map"]).experiments[0]
    np.testing.assert_allclose(e.position[:, 0], ANGLE, atol=1e-6)
    np.testing.assert_allclose(np.diff(e.time), 1e-3, atol=1e-6)
