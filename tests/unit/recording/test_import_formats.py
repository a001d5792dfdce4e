"""Every kind of file ``invid import`` takes, with known contents written here, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
import scipy.io

from invid.cli.app import run
from invid.recording import read_recording
from invid.recording.import_map import load_map

ROOT = Path(__file__).resolve().parents[3]
N = 400
TIME = np.arange(N) / 200.0
DEGREES = 10.0 * np.sin(2 * np.pi * 3.0 * TIME) + 1.25
TORQUE = np.round(0.7 * np.cos(2 * np.pi * 3.0 * TIME), 6)


def chart(path: Path, *, time: str, position: str, torque: str, source: str = "") -> Path:
    """A map for position in degrees and torque in mN·m, the sign of the torque reversed."""
    path.write_text(
        f"format: invid-import-map\n{source}\ntime: {{column: {time!r}, unit: s}}\naxes:\n  - name: A\n    "
        f"position: {{column: {position!r}, unit: deg}}\n    torque: {{column: {torque!r}, unit: 'mN·m', "
        "sign: -1}\n",
        encoding="utf-8",
    )
    return path


def imported(tmp_path: Path, source: Path, map_file: Path):
    out = tmp_path / "out.h5"
    assert run(["import", str(source), "--map", str(map_file), "-o", str(out)]) == 0
    recording = read_recording(out)
    assert recording.position_unit == "rad"
    assert recording.torque_unit == "N·m"
    return recording.experiments[0]


def check_values(e, rows=slice(None)) -> None:
    np.testing.assert_allclose(e.time, TIME[rows], atol=1e-9)
    np.testing.assert_allclose(e.position[:, 0], np.deg2rad(DEGREES[rows]), atol=1e-7)
    np.testing.assert_allclose(e.torque[:, 0], -1e-3 * TORQUE[rows], atol=1e-12)


def test_mat_v5_with_a_struct_is_read(tmp_path):
    source = tmp_path / "log.mat"
    scipy.io.savemat(source, {"rec": {"t": TIME, "q": np.column_stack([0 * TIME, DEGREES]), "tau": TORQUE}})
    check_values(
        imported(
            tmp_path, source, chart(tmp_path / "m.yaml", time="rec.t", position="rec.q[1]", torque="rec.tau")
        )
    )


def test_mat_v73_is_read(tmp_path):
    source = tmp_path / "log.mat"
    # MATLAB writes a 512-byte block before the HDF5 signature, arrays transposed, and class names.
    with h5py.File(source, "w", userblock_size=512) as file:
        for name, values in (("t", TIME[None, :]), ("tau", TORQUE[None, :])):
            file[name] = values
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["rec/q"] = np.vstack([0 * TIME, DEGREES])
        file["note"] = np.frombuffer("bench".encode("utf-16-le"), dtype=np.uint16)[:, None]
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
    with source.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    check_values(
        imported(tmp_path, source, chart(tmp_path / "m.yaml", time="t", position="rec.q[1]", torque="tau"))
    )


def test_hdf5_with_other_names_is_read(tmp_path):
    source = tmp_path / "log.hdf5"
    with h5py.File(source, "w") as file:
        file["run 1/clock"] = TIME
        file["run 1/drive/angle"] = DEGREES
        file["run 1/drive/moment"] = TORQUE.astype(np.float64)
    m = chart(
        tmp_path / "m.yaml", time="run 1/clock", position="run 1/drive/angle", torque="run 1/drive/moment"
    )
    check_values(imported(tmp_path, source, m))


def test_parquet_is_read(tmp_path):
    source = tmp_path / "log.parquet"
    table = pyarrow.table({"t": TIME, "name": ["x"] * N, "angle": DEGREES, "moment": TORQUE})
    pyarrow.parquet.write_table(table, source)
    check_values(
        imported(tmp_path, source, chart(tmp_path / "m.yaml", time="t", position="angle", torque="moment"))
    )


def spreadsheet(path: Path, *, broken: int = 0) -> Path:
    """Semicolons, decimal commas, lines of prose above the names, a line of units below them."""
    lines = ["Messung vom 3. Mai; Prüfstand 2", "Regler: aus", "", "Zeit;Winkel;Moment", "s;°;mNm"]
    for i in range(N):
        cells = [f"{TIME[i]:.6f}", f"{DEGREES[i]:.9f}", f"{TORQUE[i]:.6f}"]
        if 100 <= i < 100 + broken:
            cells[1] = "---"
        lines.append(";".join(cells).replace(".", ","))
    path.write_text("\r\n".join(lines) + "\r\n", encoding="latin-1")
    return path


SPREADSHEET_MAP = {"time": "Zeit", "position": "Winkel", "torque": "Moment"}


def test_more_than_one_per_cent_of_broken_rows_is_refused_and_nothing_written(tmp_path, capsys):
    m = chart(tmp_path / "m.yaml", **SPREADSHEET_MAP)
    source = spreadsheet(tmp_path / "log.csv", broken=5)
    assert run(["import", str(source), "--map", str(m), "-o", str(tmp_path / "out.h5")]) == 2
    message = capsys.readouterr().err
    assert "5 of 400 rows" in message
    assert "line 106" in message
    assert not (tmp_path / "out.h5").exists()


SHIPPED = sorted((ROOT / "configs" / "import").glob("*.yaml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_every_shipped_map_is_valid(path):
    assert load_map(path).axes
