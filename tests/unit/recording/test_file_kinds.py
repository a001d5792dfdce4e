"""What a file is: told by its bytes and its head whatever its name, read, or refused with the way out."""

from __future__ import annotations

import base64
import bz2
import gzip
import lzma
import sqlite3
import zipfile
from pathlib import Path

import can
import numpy as np
import pytest

from invid.cli.app import run
from invid.errors import InputError
from invid.recording.hdf5 import read_recording
from invid.recording.import_map import Source
from invid.recording.import_source import suggest_map
from invid.recording.readers.kinds import read_table

N = 300
TIME = np.arange(N) * 1e-3
ANGLE = np.round(np.sin(9 * TIME) * (1 + TIME), 6)
TORQUE = np.round(3 * np.cos(9 * TIME), 6)
CSV = "time,position,torque\n" + "\n".join(
    f"{t:.4f},{a:.6f},{u:.6f}" for t, a, u in zip(TIME, ANGLE, TORQUE, strict=True)
)


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, lzma.compress], ids=["gz", "bz2", "xz"])
@pytest.mark.parametrize("name", ["log.csv.{}", "log.data"])
def test_packed_text_is_read_as_what_is_inside(tmp_path, pack, name):
    path = tmp_path / name.format("gz")
    path.write_bytes(pack(CSV.encode()))
    np.testing.assert_allclose(read_table(path, Source()).columns["torque"], TORQUE)


def test_a_packed_file_that_breaks_off_and_a_zip_of_one_and_of_many(tmp_path):
    cut = tmp_path / "cut.csv.gz"
    cut.write_bytes(gzip.compress(CSV.encode())[:-200])
    with pytest.raises(InputError, match="is it whole"):
        read_table(cut, Source())
    one, two = tmp_path / "one.zip", tmp_path / "two.zip"
    with zipfile.ZipFile(one, "w") as archive:
        archive.writestr("run/log.csv", CSV)
    np.testing.assert_allclose(read_table(one, Source()).columns["position"], ANGLE)
    with zipfile.ZipFile(two, "w") as archive:
        archive.writestr("a.csv", CSV)
        archive.writestr("b.csv", CSV)
    with pytest.raises(InputError, match=r"2 files \(a.csv, b.csv\)"):
        read_table(two, Source())


@pytest.mark.parametrize("pack", [np.savez, np.savez_compressed])
def test_numpys_arrays_are_columns_by_their_names(tmp_path, pack):
    pack(tmp_path / "log.npz", time=TIME, q=np.c_[ANGLE, 2 * ANGLE], tau=TORQUE)
    table = read_table(tmp_path / "log.npz", Source())
    np.testing.assert_array_equal(table.columns["q[1]"], 2 * ANGLE)
    rows = np.zeros(N, [("time", float), ("q", float)])
    rows["time"], rows["q"] = TIME, ANGLE
    np.save(tmp_path / "log.npy", rows)
    np.testing.assert_array_equal(read_table(tmp_path / "log.npy", Source()).columns["log.q"], ANGLE)


def sqlite(path: Path, *tables: str) -> bytes:
    base = sqlite3.connect(path)
    for table in tables:
        base.execute(f"create table {table}")
    base.commit()
    base.close()
    return path.read_bytes()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.bag", b"#ROSBAG V2.0\nE\0\0\0\x0a", "ROS 1 bag.*mcap"),
        ("a.dat", b"#ROSBAG V1.2\n", "ROS 1 bag"),
        ("a.db3", ("topics (id, name)", "messages (id, data)"), "ROS 2 bag in SQLite.*ros2 bag convert"),
        ("a.sqlite", ("runs (t, q)",), "tables runs.*-csv"),
        ("a.xls", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + b"\0" * 99, "old Excel workbook.*CSV"),
        ("a.csv", b"<!DOCTYPE html>\n<html><body>404</body></html>", "web page.*raw"),
        ("a.csv", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "git lfs pull"),
        ("a.txt", b'[{"t": 0, "q": 1}, {"t": 1, "q": 2}]', "JSON.*to_csv"),
        ("a.log", b'{"t": 0, "q": 1}\n{"t": 1, "q": 2}\n', "JSON"),
        ("a.bin", b"ULog\x01\x12\x35\x01" + b"\0" * 99, "PX4 log.*ulog2csv"),
        ("a.pkl", b"\x80\x04\x95" + b"\0" * 99, "Python pickle.*to_csv"),
        ("a.csv.zst", b"\x28\xb5\x2f\xfd" + b"\0" * 99, "unpack it"),
        ("a.csv", b"%PDF-1.4\n", "PDF"),
    ],
)
def test_what_is_not_read_is_named_with_the_way_out(tmp_path, capsys, name, content, said):
    path = tmp_path / name
    if isinstance(content, tuple):
        sqlite(path, *content)
    else:
        path.write_bytes(content)
    assert run(["import", str(path), "--suggest"]) == 2
    error = capsys.readouterr().err
    with pytest.raises(InputError, match=said):
        read_table(path, Source())
    assert "delimiter" not in error
    assert "encoding" not in error


@pytest.mark.parametrize(
    ("member", "said"),
    [
        ("xl/workbook.xml", "Excel workbook.*CSV"),
        ("modelDescription.xml", "FMU.*--against"),
        ("content.xml", "OpenDocument"),
    ],
)
def test_what_else_is_a_zip_is_named(tmp_path, member, said):
    with zipfile.ZipFile(tmp_path / "a.xlsx", "w") as archive:
        archive.writestr(member, "x")
        archive.writestr("other", "x")
    with pytest.raises(InputError, match=said):
        read_table(tmp_path / "a.xlsx", Source())


FRAMES = [
    can.Message(timestamp=1.7e9 + k * 1e-3 + d, arbitration_id=i, data=data, is_extended_id=False)
    for k in range(N)
    for d, i, data in (
        (0.0, 0x80, b""),
        (2e-4, 0x181, int(1e6 * ANGLE[k]).to_bytes(4, "little", signed=True)),
    )
]
PDOS = Source.model_validate({"pdos": [{"id": 0x181, "signals": [{"name": "q", "type": "int32"}]}]})


@pytest.mark.parametrize("ending", [".csv", ".db", ".mf4", ".blf", ".asc", ".log", ".log.gz"])
@pytest.mark.parametrize("rename", [False, True])
def test_logs_that_python_can_writes_are_recognised(tmp_path, ending, rename):
    if ending == ".mf4":
        pytest.importorskip("asammdf")
    path = tmp_path / f"log{ending}"
    with can.Logger(path) as log:
        for frame in FRAMES:
            log.on_message_received(frame)
    if rename:
        path = path.rename(tmp_path / "log.txt")
    table = read_table(path, PDOS)
    rows = table.columns["q"].size
    assert rows > (
        200 if ending == ".db" else N - 1
    )  # python-can's SQLite writer drops what waits at its end
    np.testing.assert_array_equal(table.columns["q"], [int(1e6 * a) for a in ANGLE[:rows]])
    assert any("0x181" in r for r in suggest_map([path], None)[1].reasons)


@pytest.mark.parametrize("name", ["EngineData", "SYNC"])
def test_an_asc_with_names_says_that_identifiers_are_needed(tmp_path, name):
    lines = ["date Tue Feb 3 12:00:00 2026", "base hex  timestamps absolute"]
    lines += [f"   {t:.6f} 1  {name}        Rx   d 2 01 02" for t in TIME]
    (tmp_path / "a.asc").write_text("\n".join(lines))
    with pytest.raises(InputError, match=f"line 3 names its frame '{name}'.*identifiers"):
        read_table(tmp_path / "a.asc", PDOS)


def lvm(x: str, decimal: str, rows: list[list[float]], names: list[str]) -> str:
    width = len(names)
    head = ["LabVIEW Measurement\t", "Writer_Version\t2", "Separator\tTab", f"Decimal_Separator\t{decimal}"]
    head += [f"X_Columns\t{x}", "***End_of_Header***\t", "\t"]
    units = {"position": "deg", "torque": "Nm"}
    own = [units[n] for n in names if n in units]
    head += ["Channels\t2", "Y_Unit_Label\t" + "\t".join(own), "X_Dimension\tTime\tTime", "X0\t0\t0"]
    head += [f"Delta_X\t0{decimal}001\t0{decimal}001", "***End_of_Header***" + "\t" * width]
    head += ["\t".join([*names, "Comment"])]
    return "\n".join([*head, *("\t".join(f"{v:.6f}".replace(".", decimal) for v in r) for r in rows)])


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("x", ["One", "No", "Multi"])
def test_lvm_is_read_by_its_names_and_its_own_clock(tmp_path, x, decimal):
    columns = {"One": [TIME, ANGLE, TORQUE], "No": [ANGLE, TORQUE], "Multi": [TIME, ANGLE, TIME, TORQUE]}[x]
    clock = {"One": ["X_Value"], "No": [], "Multi": ["X_Value"]}[x]
    names = [*clock, "position", *(clock if x == "Multi" else []), "torque"]
    path = tmp_path / "run.lvm"
    path.write_text(lvm(x, decimal, np.array(columns).T.tolist(), names))
    proposal = suggest_map([path], None)[1]
    assert proposal.document["time"] == {"column": "X_Value", "unit": "s"}
    assert proposal.document["axes"][0]["position"] == {"column": "position", "unit": "deg"}
    table = read_table(path, Source())
    np.testing.assert_allclose(table.columns["torque"], TORQUE)
    np.testing.assert_allclose(table.columns["X_Value"], TIME, atol=1e-9)


@pytest.mark.parametrize(
    ("stamp", "cell"),
    [("{} -> ", "\t"), ("{} > ", ","), ("[{}] ", " "), ("[2026-02-03 {}] ", ";")],
    ids=["Arduino", "PlatformIO", "brackets", "dates"],
)
def test_lines_that_a_serial_monitor_stamped_are_read_without_its_stamps(tmp_path, stamp, cell):
    lines = [stamp.format("12:36:19.000") + cell.join(["t_us", "position", "torque"])]
    for k in range(N):
        at = stamp.format(f"12:36:19.{16 * (k // 16):03d}")
        lines.append(at + cell.join([str(1000 * k), f"{ANGLE[k]:.6f}", f"{TORQUE[k]:.6f}"]))
    path = tmp_path / "serial.txt"
    path.write_text("\n".join(lines))
    document = suggest_map([path], None)[1].document
    assert document["time"] == {"column": "t_us", "unit": "us"}
    np.testing.assert_allclose(read_table(path, Source()).columns["position"], ANGLE)


@pytest.mark.parametrize("beside", ["README.md", "plot_results.py", "metadata.yaml", "LICENSE", "readme.txt"])
def test_a_document_in_the_folder_stops_no_import(tmp_path, capsys, beside):
    folder = tmp_path / "runs"
    folder.mkdir()
    for k in (1, 2):
        (folder / f"run{k}.csv").write_text(CSV)
    (folder / beside).write_text("# What was measured\n\nSee the paper.\n")
    assert run(["import", str(folder), "--suggest"]) == 0
    said = capsys.readouterr().out
    chart = tmp_path / "map.yaml"
    chart.write_text(said)
    assert beside not in said.split("format:")[1]
    out = tmp_path / "r.h5"
    assert run(["import", str(folder), "--map", str(chart), "-o", str(out)]) == 0
    assert len(read_recording(out).experiments) == 2


@pytest.mark.parametrize(
    "line",
    ["t_us:{},pos:{},torque:{}", "t_us: {} pos: {} torque: {}", "12:36:19.016 -> t_us={}\tpos={}\ttorque={}"],
)
def test_values_with_their_labels_are_columns(tmp_path, line):
    rows = [line.format(1000 * k, f"{ANGLE[k]:.6f}", f"{TORQUE[k]:.6f}") for k in range(N)]
    (tmp_path / "a.txt").write_text("\n".join(["ready", *rows]))
    table = read_table(tmp_path / "a.txt", Source())
    np.testing.assert_allclose(table.columns["torque"], TORQUE)
    np.testing.assert_allclose(table.columns["t_us"], 1000 * np.arange(N))


@pytest.mark.parametrize(
    "head", ["time,position,torque", "=~=~= PuTTY log 2026.02.03 =~=~=\ntime,position,torque"]
)
def test_a_table_called_log_is_no_can_log(tmp_path, head):
    (tmp_path / "a.log").write_text(head + CSV.partition("torque")[2])
    np.testing.assert_allclose(read_table(tmp_path / "a.log", Source()).columns["torque"], TORQUE)


def test_a_base64_of_python_can_is_no_table(tmp_path):
    head = "timestamp,arbitration_id,extended,remote,error,dlc,data"
    rows = [f"{1.7e9 + t},0x80,0,0,0,0," for t in TIME]
    rows += [f"{1.7e9 + t},0x181,0,0,0,4,{base64.b64encode(bytes(4)).decode()}" for t in TIME]
    (tmp_path / "a.txt").write_text("\n".join([head, *sorted(rows)]))
    assert set(read_table(tmp_path / "a.txt", PDOS).columns) == {"time", "q"}


@pytest.mark.parametrize(("delimiter", "decimal"), [(",", "."), (";", ","), ("\t", ".")])
def test_a_table_is_the_same_without_pyarrow(tmp_path, monkeypatch, delimiter, decimal):
    rows = np.column_stack([TIME, ANGLE, TORQUE])
    lines = [delimiter.join(f"{v:.9g}".replace(".", decimal) for v in row) for row in rows]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([delimiter.join(["time", "position", "torque"]), *lines]))
    with_it = read_table(path, Source())
    monkeypatch.setattr("invid.recording.readers.text_table.find_spec", lambda name: None)
    without = read_table(path, Source())
    assert list(with_it.columns) == list(without.columns) == ["time", "position", "torque"]
    for name, numbers in with_it.columns.items():
        np.testing.assert_array_equal(numbers, without.columns[name])
