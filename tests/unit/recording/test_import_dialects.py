"""The same log in the dress of other programs: stamped, quoted, in structs; and maps that cannot be meant."""

import re
import struct
import zipfile
from datetime import datetime, timedelta
from pathlib import Path

import can
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from foreign_records import imported, suggested, text

from invid.cli.app import run
from invid.recording import Experiment
from invid.recording.import_map import load_map

COUNT = 60
TIME = np.arange(COUNT) * 0.004
POSITION = np.cumsum(np.sin(30 * TIME)) * 0.004
TORQUE = np.cos(30 * TIME)
CHART = {
    "format": "invid-import-map",
    "time": {"column": "time", "unit": "s"},
    "axes": [
        {
            "name": "A",
            "position": {"column": "position", "unit": "rad"},
            "torque": {"column": "torque", "unit": "N·m"},
        }
    ],
}


def taken(source: Path, capsys: pytest.CaptureFixture[str]) -> Experiment:
    """The suggested map, unedited, gives back what the file holds."""
    found = imported(source.parent, source, suggested(capsys, source)["map"]).experiments[0]
    assert found.time - found.time[0] == pytest.approx(TIME, abs=1e-6)
    assert found.position[:, 0] == pytest.approx(POSITION, abs=1e-6)
    assert found.torque[:, 0] == pytest.approx(TORQUE, abs=1e-6)
    return found


def written(folder: Path, times: list[str], *, sep: str = ",", comma: bool = False, quote: str = "") -> Path:
    rows = [sep.join(("time", "position", "torque"))]
    for t, q, u in zip(times, POSITION, TORQUE, strict=True):
        cells = [t, f"{q:.9f}", f"{u:.9f}"]
        cells = [c.replace(".", ",") for c in cells] if comma else cells
        rows.append(sep.join(f"{quote}{c}{quote}" for c in cells))
    return text(folder / "log.csv", rows)


@pytest.mark.parametrize(
    "pattern",
    ["%Y-%m-%dT%H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%fZ", "%Y-%m-%d %H:%M:%S.%f+02:00", "%H:%M:%S.%f",
     "%d.%m.%Y %H:%M:%S.%f", "%Y/%m/%d %H:%M:%S.%f"],
)  # fmt: skip
def test_dates_and_times_of_day_are_time(tmp_path, capsys, pattern):
    # The log runs over midnight: a time of day starts over there.
    start = datetime(2026, 1, 31, 23, 59, 59, 900_000)
    taken(written(tmp_path, [f"{start + timedelta(seconds=t):{pattern}}" for t in TIME.tolist()]), capsys)


@pytest.mark.parametrize("kind", ["timestamp", "duration"])
def test_parquet_keeps_time_as_time(tmp_path, capsys, kind):
    microseconds = np.round(1e6 * TIME).astype(np.int64)
    stamps = pa.array(microseconds, pa.timestamp("us") if kind == "timestamp" else pa.duration("us"))
    pq.write_table(
        pa.table({"time": stamps, "position": POSITION, "torque": TORQUE}), tmp_path / "log.parquet"
    )
    taken(tmp_path / "log.parquet", capsys)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (yaml.safe_dump({**CHART, "experiments": [{"period_samples": 500}]}), "period_samples"),
        (yaml.safe_dump({**CHART, "experiments": [{"drop_periods": 2}]}), "drop_periods"),
        (
            "a0: &a0 [x]\n"
            + "".join(f"a{k + 1}: &a{k + 1} [{', '.join(9 * [f'*a{k}'])}]\n" for k in range(9)),
            "references",
        ),
        ("a: &a [*a]\n", "references"),
    ],
    ids=[
        "a period longer than the log",
        "periods of no length",
        "references to references",
        "a reference to itself",
    ],
)
def test_a_map_that_cannot_be_meant_is_one_sentence(tmp_path, capsys, text, said):
    log, chart = written(tmp_path, [f"{t:.6f}" for t in TIME]), tmp_path / "map.yaml"
    chart.write_text(text, encoding="utf-8")
    assert run(["import", str(log), "--map", str(chart), "-o", str(tmp_path / "r.h5")]) == 2
    message = capsys.readouterr().err
    assert said in message
    assert len(message.strip().splitlines()) == 1


def test_an_offset_is_what_the_log_shows_at_zero(tmp_path):
    axis = {
        "name": "A",
        "position": {"column": "position", "unit": "rad", "offset": 2.0, "scale": 3.0, "sign": -1},
        "torque": {"column": "torque", "unit": "N·m"},
    }
    log = written(tmp_path, [f"{t:.6f}" for t in TIME])
    found = imported(tmp_path, log, {**CHART, "axes": [axis]}).experiments[0]
    assert found.position[:, 0] == pytest.approx(-3.0 * (POSITION - 2.0), abs=1e-8)


@pytest.mark.parametrize(
    ("names", "scales"),
    [
        ("时间(ms),关节1位置(mrad),关节1力矩(N·m)", (1e3, 1e3, 1)),
        ("時刻[s],角度[rad],トルク[mNm]", (1, 1, 1e3)),
        ("tiempo,posición,par", (1, 1, 1)),
        ("Temps (s),Position (rad),Couple (N.m)", (1, 1, 1)),
        ("Time in ms,r482: Encoder position value [rad],r80: Actual torque value [Nm]", (1e3, 1, 1)),
        ("millis,angle_mrad,torque_mNm", (1e3, 1e3, 1e3)),
        ("t/ms,q1/mrad,tau1/Nm", (1e3, 1e3, 1)),
        ("время,положение [rad],момент [mNm]", (1, 1, 1e3)),
    ],
)
def test_quantities_are_known_in_other_tongues_and_units_where_names_end(tmp_path, capsys, names, scales):
    rows = np.column_stack([TIME, POSITION, TORQUE]) * scales
    path = text(tmp_path / "log.csv", [names, *(",".join(f"{v:.9f}" for v in r) for r in rows)])
    taken(path, capsys)


def test_what_was_asked_for_is_told_from_what_was_measured_in_a_compound(tmp_path, capsys):
    rows = np.column_stack([TIME, -TORQUE, POSITION, TORQUE])
    path = tmp_path / "log.csv"
    names = "Zeit;Sollmoment [Nm];Istposition [rad];Istmoment [Nm]"
    lines = [names, *(";".join(f"{v:.9f}".replace(".", ",") for v in r) for r in rows)]
    path.write_text("\n".join(lines), "cp1252")
    taken(path, capsys)


def test_columns_of_one_name_and_lists_in_cells_are_joints(tmp_path, capsys):
    twice, lists = ["time,pos,torque,pos,torque"], ["time,position,effort"]
    for t, q, u in zip(TIME, POSITION, TORQUE, strict=True):
        twice.append(f"{t:.4f},{q:.9f},{u:.9f},{2 * q:.9f},{3 * u:.9f}")
        lists.append(f'{t:.4f},"[{q:.9f}, {2 * q:.9f}]","[{u:.9f}, {3 * u:.9f}]"')
    for name, lines in (("twice.csv", twice), ("lists.csv", lists)):
        path = text(tmp_path / name, lines)
        found = taken(path, capsys)
        assert found.position[:, 1] == pytest.approx(2 * POSITION, abs=1e-6)
        assert found.torque[:, 1] == pytest.approx(3 * TORQUE, abs=1e-6)


def test_a_row_a_joint_is_refused(tmp_path, capsys):
    path = tmp_path / "long.csv"
    rows = [f"{t:.3f},{j},{q:.6f},{q:.6f}" for t, q in zip(TIME, POSITION, strict=True) for j in ("a", "b")]
    path.write_text("\n".join(["time,name,position,effort", *rows]))
    assert "pivot" in suggested(capsys, path, status=2)["refused"]["way_out"]


@pytest.mark.parametrize("shape", ["lists", "struct"])
def test_lists_and_structs_of_parquet_are_columns(tmp_path, capsys, shape):
    if shape == "lists":
        kind = pa.list_(pa.float64())
        columns = {n: pa.array([[x] * 2 for x in v], kind) for n, v in (("q", POSITION), ("tau", TORQUE))}
    else:
        rows = [{"position": q, "effort": u} for q, u in zip(POSITION, TORQUE, strict=True)]
        columns = {"state": pa.array(rows)}
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"time": TIME, **columns}), path)
    taken(path, capsys)


def test_a_scope_export_with_a_clock_a_channel_takes_no_clock_for_a_position(tmp_path, capsys):
    lines = ["Name\tActTorque\tName\tActPos", "SampleTime[ms]\t4\tSampleTime[ms]\t4"]
    lines += ["Unit\tNm\tUnit\trad", ""]
    lines += [
        f"{1e3 * t:g}\t{u:.9f}\t{1e3 * t:g}\t{q:.9f}" for t, q, u in zip(TIME, POSITION, TORQUE, strict=True)
    ]
    path = text(tmp_path / "scope.csv", lines)
    taken(path, capsys)
    assert "interpolated" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("names", "clocks"),
    [
        ("header.stamp.sec,header.stamp.nanosec", lambda t: (1.7e9 + t // 1, 1e9 * (t % 1))),
        (
            "pc_time,device_us",
            lambda t: (1.7e9 + t + 0.003 * np.sin(1e4 * t), (1e6 * t + 2**32 - 9e4) % 2**32),
        ),
        ("logged_at,stamp_ns", lambda t: (1.7e9 + t + 0.003 * np.sin(1e4 * t), 1.7e18 + 1e9 * t)),
    ],
)
def test_the_evenest_of_two_clocks_is_taken_in_whatever_parts_it_is(tmp_path, capsys, names, clocks):
    one, other = (np.rint(1e6 * c) / 1e6 for c in clocks(TIME + 0.9))
    lines = [f"{names},position,torque"]
    for row in zip(one, other, POSITION, TORQUE, strict=True):
        lines.append("{:.6f},{:.0f},{:.9f},{:.9f}".format(*row))
    path = text(tmp_path / "log.csv", lines)
    taken(path, capsys)


def test_a_row_of_units_with_a_name_of_its_own_and_a_zip_with_a_readme_are_read(tmp_path, capsys):
    lines = ["Name,position,torque", "Unit,mrad,Nm", ""]
    lines += [f"{k},{1e3 * q:.9f},{u:.9f}" for k, (q, u) in enumerate(zip(POSITION, TORQUE, strict=True))]
    with zipfile.ZipFile(tmp_path / "log.zip", "w") as archive:
        archive.writestr("log.csv", "\n".join(lines) + "\n")
        archive.writestr("README.txt", "Measured on Monday.")
    (axis,) = suggested(capsys, tmp_path / "log.zip")["map"]["axes"]
    assert axis["position"] == {"column": "position", "unit": "mrad"}


def test_a_log_of_can_fd_without_sync_gets_a_map_that_reads_it(tmp_path, capsys):
    path = tmp_path / "fd.asc"
    counts, permille = np.rint(1e6 * POSITION).astype(int), np.rint(1e3 * TORQUE).astype(int)
    with can.Logger(str(path)) as log:
        for t, q, u in zip(TIME.tolist(), counts.tolist(), permille.tolist(), strict=True):
            data = struct.pack("<Hhi8x", 0x1237, u, q)
            log(can.Message(t, 0x183, is_extended_id=False, is_fd=True, data=data, channel=0))
    chart = suggested(capsys, path)["map"]
    position = {"column": "x183_byte4", "unit": "counts", "per_count": 1e-6}
    torque = {"column": "x183_byte2", "unit": "permille"}
    chart["motion"] = "rotary"
    chart["axes"] = [{"name": "A1", "rated_torque": 1.0, "position": position, "torque": torque}]
    found = imported(tmp_path, path, chart).experiments[0]
    assert found.position[:, 0] == pytest.approx(POSITION, abs=1e-6)
    assert found.torque[:, 0] == pytest.approx(TORQUE, abs=1e-3)


def test_signs_of_units_alone_and_printed_minus_signs_are_read_and_outer_torque_is_not_the_drives(
    tmp_path, capsys
):
    rows = np.column_stack([1e6 * TIME, np.degrees(POSITION), 0 * TIME + 0.1, TORQUE])
    lines = [",".join(f"{v:.9f}" for v in r) for r in rows]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time [µs],angle [°],tau_ext,tau", *lines]) + "\n", "cp1252")
    taken(path, capsys)
    path.write_text("\n".join(["time [µs],angle [°],tau_ext,tau", *lines]).replace("-", "−") + "\n", "utf-8")
    taken(path, capsys)


def test_more_than_one_per_cent_of_broken_rows_is_refused_and_nothing_written(tmp_path, capsys):
    chart, source, out = (tmp_path / name for name in ("m.yaml", "log.csv", "out.h5"))
    # Semicolons, decimal commas, lines of prose above the names, a line of units below them.
    lines = ["Messung vom 3. Mai; Prüfstand 2", "Regler: aus", "", "Zeit;Winkel;Moment", "s;°;mNm"]
    for i, t in enumerate(np.arange(400) / 200.0):
        angle = "---" if 100 <= i < 105 else f"{10 * np.sin(19 * t):.9f}"
        lines.append(f"{t:.6f};{angle};{np.cos(19 * t):.6f}".replace(".", ","))
    source.write_text("\r\n".join(lines) + "\r\n", encoding="latin-1")
    chart.write_text(
        "format: invid-import-map\ntime: {column: Zeit, unit: s}\naxes:\n  - name: A\n    position: {column: "
        "Winkel, unit: deg}\n    torque: {column: Moment, unit: 'mN·m', sign: -1}\n",
        encoding="utf-8",
    )
    assert run(["import", str(source), "--map", str(chart), "-o", str(out)]) == 2
    message = capsys.readouterr().err
    assert "5 of 400 rows" in message
    assert "line 106" in message
    assert not out.exists()


def test_a_log_without_sync_or_pdos_is_refused_with_the_identifiers_it_has(tmp_path, capsys):
    log, lines = tmp_path / "c.log", []
    for k in range(50):
        data = (10 * k).to_bytes(4, "little") + (k % 900).to_bytes(2, "little") + b"\x37\x06"
        lines.append(f"({1.7e9 + 0.01 * k + 1e-3:.6f}) can0 185#{data.hex().upper()}\n")
        lines.append(f"({1.7e9 + 0.01 * k + 2e-3:.6f}) can0 205#0F000A00\n")
    for pattern, status, said in (("$^", 0, "no SYNC"), (r" [0-9A-F]{3}#", 2, "0x705")):
        log.write_text(re.sub(pattern, " 705#", "".join(lines)), encoding="utf-8")
        assert run(["import", "--suggest", str(log)]) == status
        assert said in "".join(capsys.readouterr())


SHIPPED = sorted((Path(__file__).resolve().parents[3] / "configs" / "import").glob("*.yaml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_every_shipped_map_is_valid(path):
    assert load_map(path).axes
