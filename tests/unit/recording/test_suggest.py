"""``--suggest`` on files as people have them: all of them described, no time or side taken for granted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from invid.cli.app import run
from invid.recording.hdf5 import read_recording
from invid_drivers.can_log_guess import guess_pdos

ROW = np.arange(1500)
TIME = ROW * 1e-3
ANGLE = 0.4 * np.sin(9 * TIME)
TORQUE = 3.0 * np.sin(9 * TIME + 0.3)


def written(path: Path, names: list[str], *columns: np.ndarray) -> Path:
    rows = [",".join(f"{v:.9g}" for v in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([",".join(names)] * bool(names) + rows) + "\n", encoding="utf-8")
    return path


def suggested(capsys, *sources: Path) -> dict:
    capsys.readouterr()
    assert run(["import", *map(str, sources), "--suggest", "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("motion", [ANGLE, ANGLE + 0.7 * TIME * (1 + TIME)], ids=["to and fro", "one way"])
def test_a_file_without_names_has_its_time_where_the_clock_is(tmp_path, capsys, motion):
    last = suggested(capsys, written(tmp_path / "a.csv", [], motion, TORQUE, TIME))
    assert last["map"]["time"] == {"column": "column2", "unit": "s"}
    first = suggested(capsys, written(tmp_path / "b.csv", [], TIME, motion, TORQUE))
    assert first["map"]["time"] == {"column": "time", "unit": "s"}


def test_a_motion_is_no_time_where_there_is_none(tmp_path, capsys):
    found = suggested(capsys, written(tmp_path / "a.csv", [], ANGLE, TORQUE))
    assert found["map"]["time"] == {"sample_rate_hz": None}
    assert "time.sample_rate_hz" in found["fill_in"]
    assert not any("'time'" in r for r in found["reasons"])


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
    source = written(tmp_path / "a.csv", [name, "position_rad", "torque_Nm"], stamps, ANGLE, TORQUE)
    found = suggested(capsys, source)
    assert said in " ".join([*found["reasons"], *found["fill_in"].values()])


def test_all_files_are_described_and_those_of_other_columns_left_out(tmp_path, capsys):
    names = ["time", "position_rad", "torque_Nm"]
    for k in (2, 1, 10):
        written(tmp_path / f"run{k}.csv", names, TIME[: 400 + k], ANGLE[: 400 + k], TORQUE[: 400 + k])
    written(tmp_path / "temperatures.csv", ["time", "celsius"], TIME, ANGLE)
    (tmp_path / "broken.csv").write_bytes(b"\0\1\2" * 99)
    capsys.readouterr()
    assert run(["import", str(tmp_path), "--suggest"]) == 0
    text = capsys.readouterr().out
    assert all(f"run{k}.csv: {400 + k} rows" in text for k in (1, 2, 10))
    assert 'file: "run*.csv"' in text
    (tmp_path.parent / "map.yaml").write_text(text, encoding="utf-8")
    out = tmp_path.parent / "r.h5"
    assert run(["import", str(tmp_path), "--map", str(tmp_path.parent / "map.yaml"), "-o", str(out)]) == 0
    assert "cannot be read" in capsys.readouterr().err
    assert [e.samples for e in read_recording(out).experiments] == [401, 402, 410]


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
    found = suggested(capsys, written(tmp_path / "a.csv", ["t", torque, motion], TIME, TORQUE, ANGLE))
    assert any("must be of one side" in u for u in found["unsure"])
    plain = suggested(capsys, written(tmp_path / "b.csv", ["t", "torque", "pos"], TIME, TORQUE, ANGLE))
    assert not any("side" in u for u in plain["unsure"])


def test_a_motor_angle_that_is_the_links_is_doubted(tmp_path, capsys):
    names = ["t", "torque_nm", "pos_mot_deg", "pos_se_deg"]
    twist = 1e-3 * np.sin(50 * TIME)
    link = suggested(capsys, written(tmp_path / "a.csv", names, TIME, TORQUE, ANGLE + twist, ANGLE))
    assert any("gear ratio" in u for u in link["unsure"])
    motor = suggested(capsys, written(tmp_path / "b.csv", names, TIME, TORQUE, 120 * ANGLE, ANGLE))
    assert not any("gear ratio" in u for u in motor["unsure"])


@pytest.mark.parametrize("name", ["u", "u_V", "voltage", "Spannung [V]", "current_A"])
def test_what_drives_the_motor_stands_for_its_torque(tmp_path, capsys, name):
    supply = 48.0 + 0.1 * np.sin(TIME)
    source = written(tmp_path / "a.csv", ["t", "bus_V", name, "theta_rad"], TIME, supply, TORQUE, ANGLE)
    axis = suggested(capsys, source)["map"]["axes"][0]
    assert axis["torque"]["column"] == name
    assert axis["position"]["column"] == "theta_rad"


def test_a_sensor_beside_numbered_axes_hides_none_of_them(tmp_path, capsys):
    names = ["time [s]", "sensor torque [Nm]", "a1 q-axis [A]", "a1 position [rad]", "a1 torque [Nm]"]
    names += ["a2 position [rad]", "a2 torque [Nm]"]
    columns = [TIME, TORQUE, 9 * TORQUE, ANGLE, TORQUE, 2 * ANGLE, 2 * TORQUE]
    axes = suggested(capsys, written(tmp_path / "a.csv", names, *columns))["map"]["axes"]
    assert [(a["name"], a["position"]["column"], a["torque"]["column"]) for a in axes] == [
        ("A1", "a1 position [rad]", "a1 torque [Nm]"),
        ("A2", "a2 position [rad]", "a2 torque [Nm]"),
    ]


def test_a_torque_is_taken_before_a_current_and_turns_a_second_are_a_velocity(tmp_path, capsys):
    names = ["time [s]", "velocity measured [Hz]", "motor current measured [A]", "motor torque measured [Nm]"]
    found = suggested(capsys, written(tmp_path / "a.csv", names, TIME, 3 * ANGLE, 9 * TORQUE, TORQUE))
    axis = found["map"]["axes"][0]
    assert axis["torque"] == {"column": "motor torque measured [Nm]", "unit": "N·m", "meaning": "measured"}
    assert axis["velocity"] == {"column": "velocity measured [Hz]", "unit": "Hz"}
    assert not any("stated" in u for u in found["unsure"])
    odd = suggested(
        capsys, written(tmp_path / "b.csv", ["t", "position [parsec]", "torque [Nm]"], TIME, ANGLE, TORQUE)
    )
    assert any("parsec" in u for u in odd["unsure"])


@pytest.mark.parametrize("fast", [False, True])
def test_the_fields_of_a_pdo_are_cut_where_numbers_end(fast):
    position = np.round((3e5 if fast else 2e4) * np.sin(9 * TIME)).astype("<i4")
    torque = np.round(300 * np.sin(9 * TIME + 0.3) + 80 * np.sin(160 * TIME)).astype("<i2")
    status = np.full(ROW.size, 0x1237, "<u2")
    payloads = [
        s.tobytes() + m.tobytes() + p.tobytes() for s, m, p in zip(status, torque, position, strict=True)
    ]
    guess = guess_pdos({0x80: [b""] * ROW.size, 0x181: payloads}, 0x80)
    assert [s.type for s in guess.pdos[0].signals] == ["int16", "int16", "int32"]


@pytest.mark.parametrize(
    "count", ["Unnamed: 0", "index", "sample", ""], ids=["reset_index", "index", "sample", "unnamed"]
)
@pytest.mark.parametrize("stamp", ["timestamp", "stamp [s]", "t_us", "epoch"])
def test_a_stamp_outranks_a_count_of_the_rows_that_is_more_even(tmp_path, capsys, count, stamp):
    late = np.random.default_rng(1).uniform(0, 2e-4, ROW.size)
    stamps = 2e-3 * ROW + late
    stamps = {"t_us": np.round(1e6 * stamps), "epoch": 1.7e9 + stamps}.get(stamp, stamps)
    path = tmp_path / "a.csv"
    rows = [f"{k},{t:.6f},{a},{b}" for k, t, a, b in zip(ROW, stamps, ANGLE, TORQUE, strict=True)]
    path.write_text("\n".join([f"{count},{stamp},position_rad,torque_Nm", *rows]), encoding="utf-8")
    found = suggested(capsys, path)
    assert found["map"]["time"] == {"column": stamp, "unit": "us" if stamp == "t_us" else "s"}
    assert found["fill_in"] == {}


@pytest.mark.parametrize("name", ["", "sample", "Unnamed: 0"])
def test_a_count_of_the_rows_alone_is_no_time_and_the_rate_is_asked(tmp_path, capsys, name):
    names = [name, "position_rad", "torque_Nm"]
    found = suggested(capsys, written(tmp_path / "a.csv", names, ROW, ANGLE, TORQUE))
    assert found["map"]["time"] == {"sample_rate_hz": None}
    assert "only counts the rows" in found["fill_in"]["time.sample_rate_hz"]


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


def test_six_axes_are_not_asked_six_times_and_every_quantity_has_its_own_unit(tmp_path, capsys):
    names, columns = ["timestamp"], [TIME]
    for k in range(6):
        names += [f"actual_q_{k}", f"target_q_{k}", f"actual_current_{k}", f"target_moment_{k}"]
        columns += [ANGLE * (k + 1), ANGLE, TORQUE, 9 * TORQUE]
    found = suggested(capsys, written(tmp_path / "a.csv", names, *columns))
    assert len(found["map"]["axes"]) == 6
    assert len(found["unsure"]) <= 6
    for axis in found["map"]["axes"]:
        assert axis["torque"]["unit"] == "A"
        assert axis["torque_demand"]["unit"] == "N·m"
        assert "torque_constant" not in axis["torque_demand"]


def test_what_was_taken_of_two_is_named(tmp_path, capsys):
    names = ["t", "current", "torque", "position"]
    found = suggested(capsys, written(tmp_path / "a.csv", names, TIME, TORQUE, TORQUE, ANGLE))
    assert found["map"]["axes"][0]["torque"]["column"] == "torque"
    assert not any("former" in u for u in found["unsure"])


@pytest.mark.parametrize(
    ("measured", "asked"), [("tau_J", "tau_J_d"), ("torque", "torque_sp"), ("effort", "effort_reference")]
)
def test_a_reference_is_not_taken_for_the_torque_wherever_it_stands(tmp_path, capsys, measured, asked):
    names = ["t", "q_d", asked, measured, "q"]
    found = suggested(capsys, written(tmp_path / "a.csv", names, TIME, ANGLE, TORQUE, TORQUE, ANGLE))
    axis = found["map"]["axes"][0]
    assert (axis["torque"]["column"], axis["torque"]["meaning"]) == (measured, "measured")
    assert axis["torque_demand"]["column"] == asked
    assert axis["position"]["column"] == "q"


@pytest.mark.parametrize(("name", "size"), [("ActPos", 1e5), ("encoder", 4096.0)])
def test_whole_numbers_are_counts_and_their_size_is_asked(tmp_path, capsys, name, size):
    counts = np.round(size * ANGLE)
    found = suggested(capsys, written(tmp_path / "a.csv", ["t", name, "torque_Nm"], TIME, counts, TORQUE))
    assert found["map"]["axes"][0]["position"] == {"column": name, "unit": "counts", "per_count": None}
    assert "axes A1 position.per_count" in found["fill_in"]


@pytest.mark.parametrize("names", [("position", "velocity"), ("id1.position", "id1.velocity")])
def test_moteus_counts_turns(tmp_path, capsys, names):
    header = [
        "timestamp",
        *names,
        names[0].replace("position", "torque"),
        names[0].replace("position", "q_current"),
    ]
    columns = [1.7e9 + TIME, ANGLE, ANGLE, TORQUE, 2 * TORQUE]
    path = tmp_path / "a.csv"
    rows = [",".join(f"{v:.17g}" for v in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([",".join(header), *rows]), encoding="utf-8")
    axis = suggested(capsys, path)["map"]["axes"][0]
    assert axis["position"] == {"column": names[0], "unit": "rev"}
    assert axis["torque"]["unit"] == "N·m"


@pytest.mark.parametrize(
    "names",
    [
        ("elbow_pos", "elbow_tau", "wrist_pos", "wrist_tau"),
        ("/js/elbow/position", "/js/elbow/effort", "/js/wrist/position", "/js/wrist/effort"),
        ("left_q1", "left_tau1", "right_q1", "right_tau1"),
    ],
    ids=["underscores", "PlotJuggler", "two arms"],
)
def test_joints_are_told_by_their_names(tmp_path, capsys, names):
    columns = [TIME, ANGLE, TORQUE, 2 * ANGLE, 2 * TORQUE]
    found = suggested(capsys, written(tmp_path / "a.csv", ["__time", *names], *columns))
    taken = [(a["position"]["column"], a["torque"]["column"]) for a in found["map"]["axes"]]
    assert taken == [(names[0], names[1]), (names[2], names[3])]
    assert not any("look like" in u for u in found["unsure"])


@pytest.mark.parametrize("header", ["t,field.name0,position,torque", "t,joint,position,torque"])
def test_rows_of_several_joints_in_one_column_are_said(tmp_path, capsys, header):
    rows = [
        f"{t:.4f},{'elbow' if k // 3 % 2 else 'wrist'},{q:.6f},{u:.6f}"
        for k, (t, q, u) in enumerate(zip(TIME, ANGLE, TORQUE, strict=True))
    ]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([header, *rows]), encoding="utf-8")
    found = suggested(capsys, path)
    assert any("several joints in one column" in u for u in found["unsure"])
    path.write_text("\n".join([header, *rows]).replace("wrist", "elbow"), encoding="utf-8")
    assert not any("several joints" in u for u in suggested(capsys, path)["unsure"])


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
    chart = tmp_path / "map.yaml"
    chart.write_text(json.dumps(found["map"]))
    assert run(["import", str(path), "--map", str(chart), "-o", str(tmp_path / "r.h5")]) == 0
    e = read_recording(tmp_path / "r.h5").experiments[0]
    np.testing.assert_allclose(e.position[:, 0], ANGLE, atol=1e-6)
    np.testing.assert_allclose(np.diff(e.time), 1e-3, atol=1e-6)
