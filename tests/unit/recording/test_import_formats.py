"""What ``invid import`` refuses of files of plain kinds, and the maps that are shipped."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from invid.cli.app import run
from invid.recording.import_map import load_map

TIME = np.arange(400) / 200.0


def test_more_than_one_per_cent_of_broken_rows_is_refused_and_nothing_written(tmp_path, capsys):
    chart, source, out = (tmp_path / name for name in ("m.yaml", "log.csv", "out.h5"))
    # Semicolons, decimal commas, lines of prose above the names, a line of units below them.
    lines = ["Messung vom 3. Mai; Prüfstand 2", "Regler: aus", "", "Zeit;Winkel;Moment", "s;°;mNm"]
    for i, t in enumerate(TIME):
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
