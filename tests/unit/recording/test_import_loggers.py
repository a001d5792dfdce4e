"""What loggers and drive tools write: MDF, MCAP, scopes; two records in one file; what a map must ask."""

from pathlib import Path

import numpy as np
import pytest
from foreign_records import imported, json_bag, refused, suggested
from mcap_ros2.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from invid.recording import Recording
from invid.recording.import_map import Source
from invid.recording.readers.kinds import read_table

RATE, COUNT = 500.0, 240
TIME = np.arange(COUNT) / RATE
ANGLE, TORQUE = 0.1 * np.sin(23 * TIME), 2 * np.sin(23 * TIME + 0.3)
JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def holds(recording: Recording, angle=ANGLE, torque=TORQUE) -> None:
    found = recording.experiments[0]
    assert found.sample_rate_hz == pytest.approx(RATE, rel=1e-6)
    assert found.position[:, 0] == pytest.approx(angle, abs=1e-6)
    assert found.torque[:, 0] == pytest.approx(torque, abs=1e-6)


def test_a_file_without_time_is_asked_for_its_rate_and_nothing_else(tmp_path, capsys):
    path = tmp_path / "log.csv"
    rows = [f"{q:.9f},{u:.9f}" for q, u in zip(ANGLE, TORQUE, strict=True)]
    path.write_text("\n".join(["position_rad,torque_nm", *rows]) + "\n", encoding="utf-8")
    said = suggested(capsys, path)
    chart, asked = said["map"], said["fill_in"]
    assert list(asked) == ["time.sample_rate_hz"]
    assert "sample_rate_hz" in refused(capsys, tmp_path, [path], chart)["reason"]
    chart["time"]["sample_rate_hz"] = RATE
    holds(imported(path.parent, path, chart))


@pytest.mark.parametrize("separate", [False, True])
def test_an_mdf_file_is_read_also_where_its_groups_have_clocks_of_their_own(tmp_path, capsys, separate):
    asammdf = pytest.importorskip("asammdf", reason="asammdf is missing: pip install 'invid[mdf]'")
    path = tmp_path / "log.mf4"
    signal = asammdf.Signal
    with asammdf.MDF(version="4.10") as file:
        torque = signal(TORQUE, TIME, unit="Nm", name="motor_torque")
        if separate:
            fine = np.arange(-10, 10 * COUNT) / (10 * RATE)
            angle = signal(0.1 * np.sin(23 * fine), fine, unit="rad", name="motor_position")
            file.append([angle])
            file.append([torque])
        else:
            file.append([signal(ANGLE, TIME, unit="rad", name="motor_position"), torque])
        file.save(path)
    said = suggested(capsys, path)
    chart, asked = said["map"], said["fill_in"]
    assert not asked
    recording = imported(path.parent, path, chart)
    found = recording.experiments[0]
    # Between instants 0.2 ms apart a straight line misses the sine by no more than (23·0.2 ms)²/8 of it.
    kept = np.isin(np.round(TIME, 9), np.round(found.time, 9))
    assert kept.sum() >= COUNT - 1
    assert found.position[:, 0] == pytest.approx(ANGLE[kept], abs=0.1 * (23 * 2e-4) ** 2 / 8 + 1e-9)
    assert found.torque[:, 0] == pytest.approx(TORQUE[kept], abs=1e-9)
    assert ("interpolated" in capsys.readouterr().err) == separate


def test_samples_of_an_mdf_channel_that_are_marked_invalid_are_left_out(tmp_path):
    asammdf = pytest.importorskip("asammdf", reason="asammdf is missing: pip install 'invid[mdf]'")
    path, marked = tmp_path / "log.mf4", np.zeros(COUNT, dtype=bool)
    marked[50:60] = True
    with asammdf.MDF(version="4.10") as file:
        torque = asammdf.Signal(np.where(marked, 1e6, TORQUE), TIME, name="torque", invalidation_bits=marked)
        file.append([asammdf.Signal(ANGLE, TIME, name="position"), torque])
        file.save(path)
    table = read_table(path, Source())
    assert table.columns["position"] == pytest.approx(ANGLE)
    assert table.columns["torque"] == pytest.approx(TORQUE[~marked])
    assert table.columns[table.clocks["torque"]] == pytest.approx(TIME[~marked])
    assert table.columns[table.clocks["position"]] == pytest.approx(TIME)


@pytest.mark.parametrize("kind", ["waveforms", "dates", "a column of seconds", "two rates"])
def test_a_tdms_file_is_read_whatever_keeps_its_time(tmp_path, capsys, kind):
    tdms = pytest.importorskip("nptdms", reason="npTDMS is missing: pip install 'invid[tdms]'")
    path = tmp_path / "log.tdms"
    wave = {"wf_increment": 1 / RATE, "wf_start_offset": 0.25} if kind in ("waveforms", "two rates") else {}
    angle, fine = ANGLE, {}
    if kind == "two rates":
        angle = 0.1 * np.sin(23 * (np.arange(4 * COUNT) / (4 * RATE)))
        fine = {"wf_increment": 0.25 / RATE}
    channels = [
        tdms.ChannelObject("drive", "Motor torque", TORQUE, properties={"unit_string": "N·m", **wave}),
        tdms.ChannelObject(
            "drive", "Motor position", angle, properties={"unit_string": "rad", **wave, **fine}
        ),
    ]
    if kind == "dates":
        stamps = np.datetime64("2026-03-01T10:00:00", "us") + np.round(1e6 * TIME).astype("timedelta64[us]")
        channels.append(tdms.ChannelObject("drive", "Timestamp", stamps))
    if kind == "a column of seconds":
        channels.append(tdms.ChannelObject("drive", "Time", TIME, properties={"unit_string": "s"}))
    with tdms.TdmsWriter(path) as file:
        file.write_segment(channels)
    said = suggested(capsys, path)
    chart, asked = said["map"], said["fill_in"]
    assert not asked
    holds(imported(path.parent, path, chart))


@pytest.mark.parametrize("encoding", ["cdr", "json", "db3", "bag"])
def test_joint_states_of_a_bag_are_read_by_their_own_stamps(tmp_path, capsys, encoding):
    path = tmp_path / ("bag.mcap" if encoding in ("cdr", "json") else f"a.{encoding}")
    bag(path, encoding)
    if encoding == "db3":
        (path,) = path.glob("*.db3")
    said = suggested(capsys, path)
    chart, asked = said["map"], said["fill_in"]
    assert not asked
    assert [a["name"] for a in chart["axes"]] == ["shoulder", "elbow"]
    recording = imported(path.parent, path, chart)
    holds(recording)
    assert recording.experiments[0].position[:, 1] == pytest.approx(2 * ANGLE, abs=1e-9)
    assert "joints of /joint_states: shoulder, elbow" in "".join(read_table(path, Source()).reasons)


def bag(path: Path, encoding: str) -> None:
    """Joint states stamped at TIME, logged up to 1 ms later."""
    late = np.random.default_rng(3).integers(0, 1_000_000, COUNT)
    stamps = 1_700_000_000_000_000_000 + np.round(TIME * 1e9).astype(int)
    if encoding in ("db3", "bag"):
        _ros_bag(path, encoding, stamps, late)
        return
    messages = []
    for stamp, q, u, wait in zip(stamps.tolist(), ANGLE, TORQUE, late.tolist(), strict=True):
        header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": ""}
        state = {"name": ["shoulder", "elbow"], "position": [q, 2 * q], "velocity": [0.0, 0.0]}
        messages.append(("/joint_states", stamp + wait, {"header": header, **state, "effort": [u, 2 * u]}))
    if encoding == "json":
        json_bag(path, messages)
        return
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        for topic, at, body in messages:
            writer.write_message(topic, schema, body, log_time=at, publish_time=at)
        writer.finish()


def _ros_bag(path: Path, encoding: str, stamps: np.ndarray, late: np.ndarray) -> None:
    """The same as ROS 2 writes it into SQLite, and as ROS 1 does."""
    store = get_typestore(Stores.ROS2_HUMBLE if encoding == "db3" else Stores.ROS1_NOETIC)
    state = "sensor_msgs/msg/JointState"
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    writer = Writer2(path, version=8) if encoding == "db3" else Writer1(path)
    serialize = store.serialize_cdr if encoding == "db3" else store.serialize_ros1
    with writer:
        connection = writer.add_connection("/joint_states", state, typestore=store)
        for stamp, q, u, wait in zip(stamps.tolist(), ANGLE, TORQUE, late.tolist(), strict=True):
            counted = {"seq": 0} if encoding == "bag" else {}
            body = store.types[state](
                header(stamp=time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="", **counted),
                ["shoulder", "elbow"], np.array([q, 2 * q]), np.zeros(2), np.array([u, 2 * u]),
            )  # fmt: skip
            writer.write(connection, stamp + wait, serialize(body, state))


@pytest.mark.parametrize("comma", [False, True])
@pytest.mark.parametrize("shared", [False, True])
def test_a_scope_export_of_twincat_is_read_whichever_options_it_was_written_with(
    tmp_path, capsys, comma, shared
):
    path = tmp_path / "scope.csv"
    path.write_text(scope(comma=comma, shared=shared), encoding="utf-8")
    said = suggested(capsys, path)
    chart, asked = said["map"], said["fill_in"]
    assert list(asked) == ["axes A1 rated_torque"]
    chart["axes"][0]["rated_torque"] = 100.0
    recording = imported(path.parent, path, chart)
    holds(recording)


def scope(*, comma: bool, shared: bool) -> str:
    """An export with position and torque at 2 ms and a slower temperature, as the scope lays it out."""
    channels = [("ActPosition", "rad", 2, ANGLE), ("ActTorque", "%", 2, TORQUE), ("Temp", "(None)", 10, TIME)]
    head: dict[str, list[str]] = {
        k: [] for k in ("Name", "SymbolComment", "Data-Type", "SampleTime[ms]", "Unit")
    }
    columns: list[list[str]] = []
    for number, (name, unit, step, values) in enumerate(channels):
        own = len(values) // (step // 2)
        if not (shared and number == 1):
            for key in head:
                head[key].append(key)
            columns.append([f"{i * step}" for i in range(own)])
        for key, cell in zip(head, (name, "", "LREAL", str(step), unit), strict=True):
            head[key].append(cell)
        columns.append([f"{v:.9f}" for v in values[:: step // 2][:own]])
    rows = [[c[i] if i < len(c) else " " for c in columns] for i in range(COUNT)]
    rows = [[cell.replace(".", ",") if comma else cell for cell in row] for row in rows]
    lines = ["Name\tscope", "File\tC:\\a.csv", "Starttime of export\t132959733843760000\tMontag", "", ""]
    lines += ["\t".join(cells) for cells in head.values()]
    return "\n".join([*lines, "", *("\t".join(r) for r in rows), "EOF"]) + "\n"
