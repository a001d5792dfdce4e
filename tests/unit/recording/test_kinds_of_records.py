"""Files as people bring them: each kind in several dresses, made here from a motion that is known."""

import json
import struct
from pathlib import Path

import cantools
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from foreign_records import imported, json_bag, refused, suggested, table, text

from invid.cli.app import run
from invid.errors import InputError
from invid.recording.import_map import Source
from invid.recording.readers.kinds import read_table

N, RATE = 1500, 500.0
TIME = np.arange(N) / RATE
ANGLE = 0.4 * np.sin(9 * TIME) + 0.1 * np.sin(31 * TIME)
TORQUE = 3.0 * np.sin(9 * TIME + 0.3) + np.sin(31 * TIME)


def axis(position: str, torque: str, unit: str = "rad") -> dict:
    channel = {"column": torque, "unit": "N·m", "meaning": "measured"}
    return {"name": "A1", "position": {"column": position, "unit": unit}, "torque": channel}


PLAIN = {"time": {"column": "time"}, "axes": [axis("position", "torque")]}


# --- several records in one file ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["episodes", "numbered runs", "a clock that starts anew", "after a minute"])
def test_records_in_one_file_are_never_joined(tmp_path, capsys, kind):
    rate = 500 / 60 if kind == "after a minute" else RATE
    own = np.arange(500) / rate
    again = kind != "numbered runs"
    time = np.concatenate([own + (0.0 if again else k * 500 / rate) for k in range(3)])
    columns = {"time": time, "position": ANGLE, "torque": TORQUE}
    if kind in ("episodes", "numbered runs"):
        columns["episode_index" if kind == "episodes" else "run"] = np.repeat(np.arange(3), 500)
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table(columns), path)
    recording = imported(tmp_path, path, PLAIN)
    assert "3 records, an experiment each" in capsys.readouterr().err
    assert [e.samples for e in recording.experiments] == [500, 500, 500]
    for k, e in enumerate(recording.experiments):
        np.testing.assert_allclose(e.position[:, 0], ANGLE[500 * k : 500 * (k + 1)])
        assert e.time[-1] - e.time[0] == pytest.approx(499 / rate)
    assert any("an experiment each" in r for r in suggested(capsys, path)["reasons"])


def test_a_counter_that_wraps_at_a_minute_is_no_new_record(tmp_path):
    path = table(tmp_path / "a.csv", ["time", "position", "torque"], (TIME + 58.5) % 60, ANGLE, TORQUE)
    assert len(imported(tmp_path, path, PLAIN).experiments) == 1


def test_a_state_called_run_parts_no_record(tmp_path):
    state = ((np.arange(N) // 400) % 2).astype(float)
    path = table(tmp_path / "a.csv", ["time", "position", "torque", "run"], TIME, ANGLE, TORQUE, state)
    assert len(imported(tmp_path, path, PLAIN).experiments) == 1


# --- messages -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("first", [True, False], ids=["names first", "names last"])
@pytest.mark.parametrize("more", [0, 90])
def test_names_that_another_message_gives_are_the_columns(tmp_path, capsys, first, more):
    names = ["state_interface.elbow/position", "state_interface.elbow/effort"]
    said = ("/stats/names", 0, {"names": names + [f"x{i}" for i in range(more)], "names_version": 7})
    rows = [
        ("/stats/values", int(2e6 * k), {"values": [q, u] + [0.0] * more, "names_version": 7})
        for k, (q, u) in enumerate(zip(ANGLE, TORQUE, strict=True))
    ]
    path = json_bag(tmp_path / "a.mcap", [said, *rows] if first else [*rows, said])
    (found,) = suggested(capsys, path)["map"]["axes"]
    assert found["name"] == "elbow"
    assert found["position"]["column"] == f"/stats/values.values[{names[0]}]"
    assert found["torque"]["column"] == f"/stats/values.values[{names[1]}]"


@pytest.mark.parametrize("words", [("feedback", "output"), ("actual", "output")])
@pytest.mark.parametrize("joint", ["gantry", "trolley"])
def test_what_a_controller_puts_out_is_demanded_and_a_name_in_y_is_no_second_encoder(
    tmp_path, capsys, words, joint
):
    at, out = words
    path = json_bag(
        tmp_path / "a.mcap",
        [
            ("/trajectory_controller/state", int(2e6 * k), {
                "joint_names": [joint], "reference": {"positions": [q + 0.1]},
                at: {"positions": [q], "velocities": [0.0], "time_from_start": {"sec": k, "nanosec": 3}},
                "error": {"positions": [0.1]}, out: {"effort": [u]},
            })
            for k, (q, u) in enumerate(zip(ANGLE, TORQUE, strict=True))
        ],
    )  # fmt: skip
    (found,) = suggested(capsys, path)["map"]["axes"]
    assert found["position"]["column"].endswith(f"{at}.positions[{joint}]")
    assert found["torque"]["meaning"] == "demanded"


def test_joints_that_change_their_order_are_read_by_name(tmp_path):
    orders, values = (["elbow", "shoulder1"], ["shoulder1", "elbow"]), {"elbow": ANGLE, "shoulder1": TORQUE}
    rows = []
    for k in range(N):
        names = orders[k // 7 % 2]
        said = [float(values[n][k]) for n in names]
        rows.append(("/js", int(2e6 * k), {"name": names, "position": said, "effort": [3 * v for v in said]}))
    table = read_table(json_bag(tmp_path / "a.mcap", rows), Source())
    for joint, value in values.items():
        np.testing.assert_allclose(table.columns[f"/js.position[{joint}]"], value)
    with pytest.raises(InputError, match="elbow"):
        table.column("/js.position[0]")


def test_a_list_without_names_that_is_too_long_is_said(tmp_path, capsys):
    rows = [("/a", int(2e6 * k), {"q": ANGLE[k], "tau": TORQUE[k], "scan": [0.0] * 300}) for k in range(N)]
    assert any("300 numbers" in r for r in suggested(capsys, json_bag(tmp_path / "a.mcap", rows))["reasons"])


# --- CAN ----------------------------------------------------------------------------------------------------

COUNTS, PERMILLE = np.rint(1e5 * ANGLE).astype(int), np.rint(100 * TORQUE).astype(int)
PDO = {"id": 0x181, "signals": [{"name": "torque", "type": "int16"}, {"name": "position", "type": "int32"}]}
CAN = {
    "motion": "rotary",
    "source": {"pdos": [PDO]},
    "time": {"column": "time"},
    "axes": [
        {
            "name": "A1",
            "position": {"column": "position", "unit": "counts", "per_count": 1e-5},
            "torque": {"column": "torque", "unit": "N·m", "scale": 0.01, "meaning": "measured"},
        }
    ],
}


def frames() -> list[tuple[float, int, bytes]]:
    out = []
    for k in range(N):
        data = struct.pack("<hi", PERMILLE[k], COUNTS[k])
        out += [(1.7e9 + TIME[k], 0x80, b""), (1.7e9 + TIME[k] + 2e-4, 0x181, data)]
    return out


def candump(path: Path, content: list[tuple[float, int, bytes]]) -> Path:
    lines = [f"({t:.6f}) can0 {i:03X}#{d.hex().upper()}" for t, i, d in content]
    path.write_text("\n".join(lines) + "\n")
    return path


def capture(path: Path, kind: str) -> Path:
    """pcap in µs or ns, pcapng; of the CAN interface itself, or of all with others' packets between."""
    cooked = kind == "cooked"
    packets = []
    for t, identifier, data in frames():
        can_frame = struct.pack(">IB3x", identifier, len(data)) + data
        head = struct.pack(">HHH8sH", 0, 280, 0, b"", 0x000C) if cooked else b""
        packets.append((t, head + can_frame))
        if cooked:
            packets.append((t, struct.pack(">HHH8sH", 0, 1, 6, b"", 0x0800) + b"E" * 40))
    link, ns = (113 if cooked else 227), kind == "ns"
    with path.open("wb") as out:
        if kind == "pcapng":
            out.write(struct.pack("<IIIHHqI", 0x0A0D0D0A, 28, 0x1A2B3C4D, 1, 0, -1, 28))
            out.write(struct.pack("<IIHHII", 1, 20, link, 0, 65535, 20))
            for t, packet in packets:
                us, pad = round(t * 1e6), -len(packet) % 4
                size = 32 + len(packet) + pad
                head = struct.pack(
                    "<IIIIIII", 6, size, 0, us >> 32, us & 0xFFFFFFFF, len(packet), len(packet)
                )
                out.write(head + packet + b"\0" * pad + struct.pack("<I", size))
            return path
        out.write(struct.pack("<IHHiIII", 0xA1B23C4D if ns else 0xA1B2C3D4, 2, 4, 0, 0, 65535, link))
        for t, packet in packets:
            us = round(t * 1e6)
            part = us % 1_000_000 * (1000 if ns else 1)
            out.write(struct.pack("<IIII", us // 1_000_000, part, len(packet), len(packet)) + packet)
    return path


@pytest.mark.parametrize("kind", ["us", "ns", "pcapng", "cooked"])
def test_a_capture_of_wireshark_is_a_can_log(tmp_path, kind):
    path = capture(tmp_path / "capture.bin", kind)
    e = imported(tmp_path, path, CAN).experiments[0]
    np.testing.assert_allclose(e.position[:, 0], 1e-5 * COUNTS[: e.samples])
    assert e.samples == N
    np.testing.assert_allclose(np.diff(e.time), 1 / RATE, atol=3e-6)


def test_a_capture_of_another_link_is_refused_with_the_way(tmp_path, capsys):
    path = tmp_path / "a.pcap"
    path.write_bytes(
        struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1) + struct.pack("<IIII", 0, 0, 4, 4) + b"abcd"
    )
    found = suggested(capsys, path, status=2)["refused"]
    assert found["code"] == "no_frames"
    assert "tshark" in found["way_out"]


DBC = """VERSION ""
BU_: M
BO_ 17 Feedback: 8 M
 SG_ Position : 7|16@0+ (0.001,-32.768) [0|0] "rad" M
 SG_ Torque : 23|12@0- (0.01,0) [0|0] "Nm" M
 SG_ Flags : 36|3@1+ (1,0) [0|0] "" M
BO_ 18 Mixed: 8 M
 SG_ Kind M : 0|4@1+ (1,0) [0|0] "" M
 SG_ Warm m1 : 8|12@1- (0.1,0) [0|0] "degC" M
 SG_ Speed m2 : 8|20@1- (0.001,0) [0|0] "rad/s" M
"""


def test_a_database_reads_fields_of_any_width_and_order_and_groups(tmp_path, capsys):
    (tmp_path / "bus.dbc").write_text(DBC)
    base = cantools.database.load_string(DBC)
    content = []
    for k, (q, u) in enumerate(zip(ANGLE, TORQUE, strict=True)):
        content.append((TIME[k], 17, base.encode_message(17, {"Position": q, "Torque": u, "Flags": k % 8})))
        mixed = {"Kind": 1, "Warm": -3.5} if k % 2 else {"Kind": 2, "Speed": u}
        content.append((TIME[k] + 1e-4, 18, base.encode_message(18, mixed)))
    path = candump(tmp_path / "a.log", content)
    chart = {
        "source": {"dbc": "bus.dbc"},
        "time": {"column": "time of Feedback"},
        "axes": [axis("Feedback.Position", "Feedback.Torque")],
    }
    e = imported(tmp_path, path, chart).experiments[0]
    np.testing.assert_allclose(e.position[:, 0], ANGLE, atol=5.1e-4)
    np.testing.assert_allclose(e.torque[:, 0], TORQUE, atol=5.1e-3)
    found = suggested(capsys, path, "--map", str(tmp_path / "map.yaml"))["map"]
    assert found["axes"][0]["torque"]["column"] == "Feedback.Torque"
    chart["axes"] = [
        {
            **axis("Feedback.Position", "Feedback.Torque"),
            "position_reference": {"column": "Mixed.Speed", "unit": "rad"},
        }
    ]
    e = imported(tmp_path, path, chart).experiments[0]
    np.testing.assert_allclose(
        e.position_reference[:, 0], np.interp(e.time + 0, TIME[::2] + 1e-4, TORQUE[::2]), atol=0.1
    )


@pytest.mark.parametrize("order", ["big", "little"])
def test_fields_of_twelve_bits_are_read_in_the_order_of_their_frame(tmp_path, order):
    content = []
    for k in range(N):
        q, u = int(COUNTS[k]) + 60000 >> 1, (int(PERMILLE[k]) + 2048) & 0xFFF
        if order == "big":
            data = b"\x11" + ((q << 24) | (0x7FF << 12) | u).to_bytes(5, "big")
        else:
            data = b"\x11" + (q | (0x7FF << 16) | (u << 28)).to_bytes(5, "little")
        content.append((TIME[k], 0x11, data))
    signals = [
        {"name": "id", "type": "uint8"}, {"name": "position", "type": "uint16", "byte_order": order},
        {"name": "speed", "type": "uint12"}, {"name": "torque", "type": "uint12"},
    ]  # fmt: skip
    position = {"column": "position", "unit": "counts", "per_count": 2e-5, "offset": 30000}
    torque = {"column": "torque", "unit": "N·m", "scale": 0.01, "offset": 2048, "meaning": "measured"}
    chart = {
        "source": {"sync_id": None, "pdos": [{"id": 0x11, "signals": signals}]},
        "time": {"column": "time"},
        "axes": [{"name": "A1", "position": position, "torque": torque}],
    }
    e = imported(tmp_path, candump(tmp_path / "a.log", content), chart).experiments[0]
    np.testing.assert_allclose(e.position[:, 0], 1e-5 * COUNTS, atol=2.1e-5)
    np.testing.assert_allclose(e.torque[:, 0], 0.01 * PERMILLE, atol=1e-9)


@pytest.mark.parametrize("command", [0x14, 0x1C])
@pytest.mark.parametrize("nodes", [(1,), (0, 3)])
def test_a_log_of_odrives_gets_a_map_that_reads_it(tmp_path, capsys, command, nodes):
    content = []
    for k in range(N):
        for node in nodes:
            at = TIME[k] + 1e-5 * node
            content.append(
                (at, node << 5 | 0x09, struct.pack("<ff", ANGLE[k] / (2 * np.pi), 0.1 * TORQUE[k]))
            )
            content.append(
                (at + 1e-4, node << 5 | command, struct.pack("<ff", TORQUE[k], (1 + node) * TORQUE[k]))
            )
            content.append((at + 2e-4, node << 5 | 0x01, b"\0" * 8))
    path = candump(tmp_path / "a.log", sorted(content, key=lambda c: c[0]))
    found = suggested(capsys, path)
    assert not found["fill_in"]
    e = imported(tmp_path, path, found["map"]).experiments[0]
    assert e.position.shape[1] == len(nodes)
    np.testing.assert_allclose(e.position[:, 0], ANGLE[: e.samples], atol=1e-6)
    np.testing.assert_allclose(e.torque[:, -1], (1 + nodes[-1]) * TORQUE[: e.samples], rtol=1e-6)


@pytest.mark.parametrize("masters", [(0x11,), (0x12, 0x15)])
def test_frames_of_mit_drives_are_told_by_how_smoothly_they_move(tmp_path, capsys, masters):
    content = []
    for k in range(N):
        for i in masters:
            q, u = int(32768 + 50000 * ANGLE[k]), int(2048 + 400 * TORQUE[k])
            data = (
                bytes([i])
                + ((q << 24) | (int(2048 + 100 * TORQUE[k]) << 12) | u).to_bytes(5, "big")
                + b"\x1e\x1f"
            )
            content += [
                (TIME[k] + 1e-5 * i, i, data),
                (TIME[k] + 1e-5 * i + 5e-6, i - 0x10, b"\x7f\xff\x7f\xf0" + b"\0" * 4),
            ]
    found = suggested(capsys, candump(tmp_path / "a.log", content))
    assert len(found["map"]["axes"]) == len(masters)
    assert set(found["fill_in"]) == {f"axes {a['name']} position.per_count" for a in found["map"]["axes"]}
    assert any("P_MAX" in u for u in found["unsure"])


def test_a_log_that_nothing_is_known_of_is_asked_for_its_fields_with_sync_said(tmp_path, capsys):
    noise = np.random.default_rng(0).integers(0, 256, (N, 8), dtype=np.uint8)
    path = candump(tmp_path / "a.log", [(TIME[k], 0x7A0, noise[k].tobytes()) for k in range(N)])
    found = suggested(capsys, path, status=2)["refused"]
    assert found["code"] == "fields_unknown"
    assert "sync_id: null" in found["way_out"]
    assert found["values"] == {"identifiers": [0x7A0]}


# --- tables -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "row", ["{t} ({q} {p}) [ok] ({u} {v}) [ok]", "{t},[{q} {p}],[{u} {v}]", "{t};{{{q},{p}}};{{{u},{v}}}"]
)
def test_what_stands_in_brackets_is_columns(tmp_path, row):
    lines = [
        row.format(t=f"{t:.4f}", q=f"{q:.6f}", p=f"{2 * q:.6f}", u=f"{u:.6f}", v=f"{3 * u:.6f}")
        for t, q, u in zip(TIME, ANGLE, TORQUE, strict=True)
    ]
    path = text(tmp_path / "data.log", lines)
    chart = {"time": {"column": 0}, "axes": [axis("list0[1]", "list1[0]")]}
    e = imported(tmp_path, path, chart).experiments[0]
    np.testing.assert_allclose(e.position[:, 0], 2 * ANGLE, atol=2e-6)
    np.testing.assert_allclose(e.torque[:, 0], TORQUE, atol=1e-6)


@pytest.mark.parametrize("limit", [None, 3.0])
@pytest.mark.parametrize("feedforward", [False, True])
def test_a_known_law_stands_for_a_torque_that_was_not_logged(tmp_path, capsys, limit, feedforward):
    goal = ANGLE + 0.02 * np.cos(5 * TIME)
    asked = 100 * (goal - ANGLE) - 1.5 * (9 * 0.4 * np.cos(9 * TIME) + 3.1 * np.cos(31 * TIME))
    asked = np.clip(asked, -limit, limit) if limit else asked
    names = ["time", "target_position_rad", "position_rad"] + ["extra_Nm"] * feedforward
    path = table(tmp_path / "a.csv", names, TIME, goal, ANGLE, *[TORQUE] * feedforward)
    law = {"stiffness": 100, "damping": 1.5} | ({"limit": limit} if limit else {})
    one = {
        "name": "A1", "position": {"column": "position_rad", "unit": "rad"},
        "position_reference": {"column": "target_position_rad", "unit": "rad"}, "controller": law,
    }  # fmt: skip
    if feedforward:
        one["torque_feedforward"] = {"column": "extra_Nm", "unit": "N·m"}
    else:
        assert list(suggested(capsys, path)["fill_in"]) == ["axes A1 controller"]
    e = imported(tmp_path, path, {"time": {"column": "time"}, "axes": [one]}).experiments[0]
    assert "not a measured one" in capsys.readouterr().err
    np.testing.assert_allclose(e.torque[5:-5, 0], (asked + feedforward * TORQUE)[5:-5], atol=0.03)
    assert e.attributes["torque_source"] == "demanded"


@pytest.mark.parametrize(
    ("names", "code"),
    [
        (["#time", "accel_x", "accel_y"], "no_motion_no_torque"),
        (["t", "ax", "gx"], "no_motion_no_torque"),
        (["freq", "psd_x", "psd_y"], "no_record_in_time"),
        (["Frequency [Hz]", "Magnitude [dB]", "Phase [deg]"], "no_record_in_time"),
    ],
)
def test_what_is_no_record_of_a_drive_is_said(tmp_path, capsys, names, code):
    path = table(tmp_path / "a.csv", names, 5 + TIME, ANGLE, TORQUE)
    assert suggested(capsys, path, status=2)["refused"]["code"] == code


@pytest.mark.parametrize(
    ("names", "time", "position", "torque"),
    [
        (
            ["ms_today", "current_in", "q_axis_current", "encoder_position", "amp_hours_used"], "ms",
            ("encoder_position", "deg"), ("q_axis_current", "A"),
        ),
        (
            ["hwRxTime", "position", "effort", "motorPosition", "motorCurrent"], "s",
            ("motorPosition", "rad"), ("motorCurrent", "A"),
        ),
        (
            ["timestamp", "actual_qd_0", "actual_current_0", "actual_q_0", "target_moment_0"], "s",
            ("actual_q_0", "rad"), ("actual_current_0", "A"),
        ),
    ],
    ids=["VESC", "HEBI", "RTDE"],
)  # fmt: skip
def test_names_of_tools_have_their_units_and_one_side(tmp_path, capsys, names, time, position, torque):
    clock = np.round(1e3 * TIME) if time == "ms" else TIME
    found = suggested(capsys, table(tmp_path / "a.csv", names, clock, TORQUE, TORQUE, ANGLE, TORQUE))["map"]
    assert found["time"] == {"column": names[0], "unit": time}
    (one,) = found["axes"]
    assert (one["position"]["column"], one["position"]["unit"]) == position
    assert (one["torque"]["column"], one["torque"]["unit"]) == torque


@pytest.mark.parametrize(("name", "content", "way"), [
    ("a.wpilog", b"WPILOG\x00\x01" + b"\0" * 40, "AdvantageScope"),
    ("a.hoot", b"\1\2" * 40, "owlet"),
    ("a.rrd", b"RRF2" + b"\0" * 40, "rerun"),
])  # fmt: skip
def test_containers_of_other_tools_are_refused_with_the_way(tmp_path, capsys, name, content, way):
    (tmp_path / name).write_bytes(content)
    found = suggested(capsys, tmp_path / name, status=2)["refused"]
    assert found["code"] == "kind_not_read"
    assert way in found["reason"]


# --- files joined by time -----------------------------------------------------------------------------------


@pytest.mark.parametrize("pairs", [1, 2])
def test_files_are_joined_by_time_each_with_its_own_clock(tmp_path, capsys, pairs):
    sources = [
        {"name": "arm", "file": "q*.csv", "time": {"column": "t_ms", "unit": "ms"}},
        {"name": "drive", "file": "tau*.csv", "time": {"column": "stamp"}, "shift_s": -100.0},
    ]
    files = []
    for k in range(pairs):
        late = TIME[3:-5] + 0.0007
        files.append(table(tmp_path / f"q{k}.csv", ["t_ms", "angle"], 1e3 * TIME, (1 + k) * ANGLE))
        torque = np.interp(late, TIME, TORQUE)
        files.append(table(tmp_path / f"tau{k}.csv", ["stamp", "torque"], 100 + late, torque))
    chart = {"sources": sources, "time": {"column": "arm:time"}, "axes": [axis("arm:angle", "drive:torque")]}
    recording = imported(tmp_path, files, chart)
    assert len(recording.experiments) == pairs
    for k, e in enumerate(recording.experiments):
        rows = slice(4, 4 + e.samples)
        np.testing.assert_allclose(e.position[:, 0], (1 + k) * ANGLE[rows], atol=1e-8)
        # Straight lines between samples of 31 rad/s miss it by (31·2 ms)²/8, twice.
        np.testing.assert_allclose(e.torque[:, 0], TORQUE[rows], atol=2e-3)
        assert e.samples == N - 9
    sources[1]["shift_s"] = 0.0
    found = refused(capsys, tmp_path, files, chart)
    assert found["code"] == "no_common_time"
    assert found["values"]["drive:time"][0] == pytest.approx(100 + TIME[3] + 0.0007)


# --- what a record cannot tell ------------------------------------------------------------------------------

SWING = 0.4 * np.sin(9 * TIME)


@pytest.mark.parametrize(
    ("position", "torque", "codes"),
    [
        (ANGLE, TORQUE, set()),
        (ANGLE, -TORQUE, {"torque_sign"}),
        (-ANGLE, TORQUE, {"torque_sign"}),
        (ANGLE + 7 * TIME, TORQUE, {"no_reversal"}),
        (np.cumsum(1.5 + np.sin(5 * TIME)) / RATE, TORQUE, {"no_reversal"}),
        (SWING, TORQUE, {"one_amplitude"}),
        (0.5 * np.arcsin(np.sin(7 * TIME)), TORQUE, {"one_amplitude"}),
        (ANGLE, np.clip(TORQUE, -1.5, 1.5), {"torque_at_limit"}),
        (ANGLE, np.clip(2 * TORQUE, -4, 4) + 0.02 * np.cos(97 * TIME), {"torque_at_limit"}),
        (0.1 * ANGLE, TORQUE, {"one_pose"}),
        (3.0 + 0.2 * ANGLE, TORQUE, {"one_pose"}),
        (ANGLE, np.abs(TORQUE), {"magnitude"}),
        (ANGLE, np.hypot(TORQUE, 0.01), {"magnitude"}),
        (ANGLE, np.mod(np.rint(1000 * TORQUE), 65536.0), set()),
        (0.0 * ANGLE, TORQUE, set()),
        (0.5 * np.arcsin(np.sin(7 * TIME)), 2 * np.sign(np.cos(7 * TIME)) + 1e-3 * TORQUE, {"one_amplitude"}),
    ],
    ids=["several lines", "torque turned round", "position turned round", "one way",
         "one way, slower and faster", "a sine", "to and fro", "cut off",
         "cut off and noisy", "near one pose", "near another", "without a sign", "rectified",
         "signed read as unsigned", "stands",
         "friction at one speed"],
)  # fmt: skip
def test_what_a_record_cannot_tell_is_said_before_any_fit(tmp_path, capsys, position, torque, codes):
    path = table(tmp_path / "a.csv", ["time", "position", "torque"], TIME, position, torque)
    imported(tmp_path, path, PLAIN)
    said = capsys.readouterr().err
    assert run(["import", str(path), "--check", str(tmp_path / "map.yaml"), "--json"]) == 0
    (file,) = json.loads(capsys.readouterr().out)["files"]
    assert {lack["code"] for lack in file["cannot_tell"]} == codes
    assert all(lack["values"] and f"cannot tell: {lack['text']}" in said for lack in file["cannot_tell"])
    assert len(suggested(capsys, path)["cannot_tell"]) == len(codes)
