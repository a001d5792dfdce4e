"""Every kind of file ``invid import`` takes, with known contents written here, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from invid.cli.app import run
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
