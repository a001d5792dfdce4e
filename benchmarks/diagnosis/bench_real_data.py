"""Records of real machines from raw file to named cause, by the commands: what is named and what is missed.

Reads the records of ``records`` (`invid fetch-data --to records`) or ``../shared/data``. Nothing here is
known to the product: maps are ordinary map files. What a record must show is asked in
``tests/docs/test_real_machines.py``. Records that are not there are named, loudly.

    python benchmarks/diagnosis/bench_real_data.py [WORD …]
        records whose title holds a word; all without
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

from benchmarks.frozen.cases import command

ROOT = Path(__file__).resolve().parents[2]
PLACES = (ROOT / "records", ROOT.parent / "shared" / "data", ROOT.parents[1] / "shared" / "data")
DATA = next((p for p in PLACES if p.is_dir()), PLACES[0])
RECORDS: list[tuple[str, str, str]] = [
    ("emps", "emps", "emps"),
    ("flexible_drive, measured current", "flexible_drive/MultisineTypeB.mat", "flexible_drive"),
    ("flexible_drive, commanded current", "flexible_drive/MultisineTypeB.mat", "flexible_drive_commanded"),
    ("silverbox", "silverbox", "silverbox"),
    ("screw_drives 1", "screw_drives/driveNo1", "screw_drive_1"),
    ("screw_drives 3", "screw_drives/driveNo3", "screw_drive_3"),
    ("double_pendulum", "double_pendulum", "double_pendulum"),
    ("kr300 axis 1", "kr300", "kr300"),
]
"""Title, source, map."""


def row(source: Path, chart: Path, folder: Path) -> str:
    """Verdict, causes with their parameters, and what is missed, by import and diagnose."""
    record, out = folder / "record.h5", folder / "diagnosis.json"
    command("import", str(source), "--map", str(chart), "-o", str(record))
    command("diagnose", str(record), "-o", str(out), fine=(0, 3))
    found = json.loads(out.read_text(encoding="utf-8"))
    named = "; ".join(
        f"{f['cause']} {f['axis']} "
        + ", ".join(f"{name} {p['value']:.4g} {p['unit']}" for name, p in f["parameters"].items())
        for f in found["findings"]
    )
    left = "; ".join(
        f"{r['axis']} {r['before']:.3g} → {r['after']:.3g} {r['unit']}" for r in found["residual"]
    )
    return f"{found['verdict']} | {named} | {left}"


def main(wanted: list[str]) -> int:
    """Print the table; the exit status is 1 where a record is missing."""
    missing = 0
    print("| record | verdict | named | missed on data kept out |\n| --- | --- | --- | --- |")
    for title, source, chart in RECORDS:
        if wanted and not any(w in title for w in wanted):
            continue
        if not (DATA / source).exists():
            missing += 1
            print(f"| {title} | NOT CHECKED: {DATA / source} is not there | | |")
            continue
        with tempfile.TemporaryDirectory() as folder:
            told = row(DATA / source, ROOT / "configs" / "import" / f"{chart}.yaml", Path(folder))
        print(f"| {title} | {told} |", flush=True)
    return int(missing > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
