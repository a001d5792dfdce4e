"""The same log in the dress of other programs: stamped, quoted, in structs; and maps that cannot be meant."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
import yaml

from invid.cli.app import run
from invid.recording import read_recording
from invid.recording.importer import integrated
from invid.recording.readers.text_table import seconds_of
from invid.recording.units import MachineConstants, factor

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


def taken(source: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The suggested map, unedited, gives back what the file holds."""
    capsys.readouterr()
    assert run(["import", str(source), "--suggest"]) == 0
    chart, record = source.parent / "suggested.yaml", source.parent / "record.h5"
    chart.write_text(capsys.readouterr().out, encoding="utf-8")
    assert run(["import", str(source), "--map", str(chart), "-o", str(record)]) == 0
    found = read_recording(record).experiments[0]
    assert found.time - found.time[0] == pytest.approx(TIME, abs=1e-6)
    assert found.position[:, 0] == pytest.approx(POSITION, abs=1e-6)
    assert found.torque[:, 0] == pytest.approx(TORQUE, abs=1e-6)


def written(folder: Path, times: list[str], *, sep: str = ",", comma: bool = False, quote: str = "") -> Path:
    rows = [sep.join(("time", "position", "torque"))]
    for t, q, u in zip(times, POSITION, TORQUE, strict=True):
        cells = [t, f"{q:.9f}", f"{u:.9f}"]
        cells = [c.replace(".", ",") for c in cells] if comma else cells
        rows.append(sep.join(f"{quote}{c}{quote}" for c in cells))
    path = folder / "log.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "pattern",
    ["%Y-%m-%dT%H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%fZ", "%Y-%m-%d %H:%M:%S.%f+02:00", "%H:%M:%S.%f",
     "%d.%m.%Y %H:%M:%S.%f", "%Y/%m/%d %H:%M:%S.%f"],
)  # fmt: skip
def test_dates_and_times_of_day_are_time(tmp_path, capsys, pattern):
    # The log runs over midnight: a time of day starts over there.
    start = datetime(2026, 1, 31, 23, 59, 59, 900_000)
    taken(written(tmp_path, [f"{start + timedelta(seconds=t):{pattern}}" for t in TIME.tolist()]), capsys)


def test_an_instant_is_seconds_and_what_is_none_is_no_number():
    assert seconds_of("1970-01-02T00:00:01.5Z") == 86401.5
    assert seconds_of("1970-01-01 02:00:00+02:00") == 0.0
    assert seconds_of("1969-12-31 19:30:00-04:30") == 0.0
    assert seconds_of("2.1.1970 00:00") == seconds_of("1/2/1970 00:00") == 86400.0
    for text in ("", "paused", "1.5", "12-3", "2026-13-01T00:00:00", "2026-02-30", "::", "-1:00"):
        assert np.isnan(seconds_of(text)), text


def test_a_stamped_column_in_another_unit_is_refused(tmp_path, capsys):
    times = [f"{datetime(2026, 1, 1) + timedelta(seconds=t):%H:%M:%S.%f}" for t in TIME.tolist()]
    chart = tmp_path / "map.yaml"
    chart.write_text(yaml.safe_dump({**CHART, "time": {"column": "time", "unit": "ms"}}), encoding="utf-8")
    log = written(tmp_path, times)
    assert run(["import", str(log), "--map", str(chart), "-o", str(tmp_path / "r.h5")]) == 2
    assert "times of day" in capsys.readouterr().err


def test_a_separator_inside_quotation_marks_separates_nothing(tmp_path, capsys):
    taken(written(tmp_path, [f"{t:.6f}" for t in TIME], comma=True, quote='"'), capsys)


def test_units_below_the_names_in_brackets_are_read(tmp_path, capsys):
    path = written(tmp_path, [f"{1e3 * t:.6f}" for t in TIME], sep=";")
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join([lines[0], "[ms];[rad];[Nm]", *lines[1:]]) + "\n", encoding="utf-8")
    taken(path, capsys)


def test_an_array_of_structs_is_a_table(tmp_path, capsys):
    log = np.zeros(COUNT, dtype=[("time", "f8"), ("position", "f8"), ("torque", "f8")])
    log["time"], log["position"], log["torque"] = TIME, POSITION, TORQUE
    scipy.io.savemat(tmp_path / "log.mat", {"log": log})
    taken(tmp_path / "log.mat", capsys)
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["data"] = log
    taken(tmp_path / "log.h5", capsys)


def test_units_stand_in_the_attributes_of_hdf5_datasets(tmp_path, capsys):
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name, values, unit in (
            ("time", 1e3 * TIME, "ms"),
            ("run/position", np.rad2deg(POSITION), b"deg"),
            ("run/torque", 1e3 * TORQUE, "mNm"),
        ):
            file[name] = values
            file[name].attrs["unit"] = unit
    taken(tmp_path / "log.h5", capsys)


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


# From the units' own definitions, not from the code; with 2 N·m/A, 50 N·m rated and 0.001 a count.
UNITS = [
    ("time", "ms", 0.001), ("time", "µs", 1e-6), ("time", "ns", 1e-9), ("time", "min", 60.0),
    ("position", "mrad", 0.001), ("position", "deg", 0.0174532925), ("position", "turns", 6.2831853072),
    ("position", "mm", 0.001), ("position", "µm", 1e-6), ("position", "in", 0.0254),
    ("position", "counts", 0.001),
    ("velocity", "rpm", 0.1047197551), ("velocity", "U/min", 0.1047197551), ("velocity", "°/s", 0.0174532925),
    ("velocity", "rev/s", 6.2831853072), ("velocity", "Hz", 6.2831853072),
    ("velocity", "mm/s", 0.001), ("velocity", "mm/min", 1.6666667e-5),
    ("velocity", "um/s", 1e-6),
    ("torque", "mNm", 0.001), ("torque", "Ncm", 0.01), ("torque", "Nmm", 0.001), ("torque", "kNm", 1000.0),
    ("torque", "mN", 0.001), ("torque", "kN", 1000.0), ("torque", "A", 2.0), ("torque", "V", 2.0),
    ("torque", "%", 0.5), ("torque", "‰", 0.05), ("torque", "counts", 0.001),
]  # fmt: skip


@pytest.mark.parametrize(("quantity", "unit", "size"), UNITS)
def test_every_unit_is_as_large_as_its_definition_says(quantity, unit, size):
    constants = MachineConstants(torque_constant=2.0, rated_torque=50.0, per_count=0.001)
    assert factor(quantity, unit, constants, "here") == pytest.approx(size, rel=1e-6)


def test_a_position_from_velocity_gives_the_velocity_back():
    time, velocity = np.array([0.0, 0.1, 0.3, 0.4]), np.array([1.0, -2.0, 3.0, 4.0])
    position = integrated(time, velocity)
    assert np.diff(position) / np.diff(time) == pytest.approx(velocity[:-1])


def test_an_offset_is_what_the_log_shows_at_zero(tmp_path):
    axis = {
        "name": "A",
        "position": {"column": "position", "unit": "rad", "offset": 2.0, "scale": 3.0, "sign": -1},
        "torque": {"column": "torque", "unit": "N·m"},
    }
    chart = tmp_path / "map.yaml"
    chart.write_text(yaml.safe_dump({**CHART, "axes": [axis]}), encoding="utf-8")
    log = written(tmp_path, [f"{t:.6f}" for t in TIME])
    assert run(["import", str(log), "--map", str(chart), "-o", str(tmp_path / "r.h5")]) == 0
    found = read_recording(tmp_path / "r.h5").experiments[0]
    assert found.position[:, 0] == pytest.approx(-3.0 * (POSITION - 2.0), abs=1e-8)
