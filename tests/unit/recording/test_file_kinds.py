"""What a file is: told by its bytes and its head whatever its name, read, or refused with the way out."""

import bz2
import gzip
import lzma
import sqlite3
from importlib import reload
from pathlib import Path

import can
import numpy as np
import pytest
from foreign_records import text

from invid.cli.app import run
from invid.errors import InputError
from invid.recording.hdf5 import read_recording
from invid.recording.import_map import Source
from invid.recording.import_source import suggest_map
from invid.recording.readers.kinds import read_table
from invid.recording.tables import good_rows

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
        ("a.bag", b"#ROSBAG V2.0\nE\0\0\0\x0a", "cannot be read as bag"),
        ("a.db3", ("topics (id, name)", "messages (id, data)"), "cannot be read as bag"),
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
    writer = can.Logger
    if ending == ".mf4":  # which this program keeps from python-can until it has such a file
        pytest.importorskip("asammdf")
        writer = reload(can.io.mf4).MF4Writer
    path = tmp_path / f"log{ending}"
    with writer(path) as log:
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
    path = text(tmp_path / "serial.txt", lines)
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
    ("odd", "broken"),
    [("# a remark", 0), ("", 0), ("0.5;;", 1), ("NaN;1;x", 1), ("1;2;3;4", 1), ("0.1;0 .2;3", 1), ("EOF", 0)],
)
def test_a_row_that_is_no_plain_numbers_is_told_with_its_line(tmp_path, odd, broken):
    rows = [f"{t:.3f};{q:.6f};{u:.6f}" for t, q, u in zip(TIME, ANGLE, TORQUE, strict=True)]
    rows.insert(100, odd)
    path = text(tmp_path / "a.csv", ["time;position;torque", *rows])
    table = read_table(path, Source())
    columns = table.columns
    inside = np.ones(table.lines.size, dtype=bool)
    good, skipped = good_rows(table, ("time", "position", "torque"), columns["time"], inside, path)
    assert [b.line for b in skipped] == [102] * broken
    np.testing.assert_allclose(columns["torque"][good], TORQUE)


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("cell", ["{} ", "  {}", '"{}"'], ids=["blank behind", "blanks before", "quoted"])
def test_blanks_and_quotation_marks_about_a_number_are_no_part_of_it(tmp_path, decimal, cell):
    lines = ["time;position;torque"]
    for row in zip(TIME, ANGLE, TORQUE, strict=True):
        lines.append(";".join(cell.format(f"{v:.6f}".replace(".", decimal)) for v in row))
    path = text(tmp_path / "a.csv", lines)
    np.testing.assert_allclose(read_table(path, Source()).columns["torque"], TORQUE, atol=1e-6)
