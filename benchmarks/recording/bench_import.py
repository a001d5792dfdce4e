"""Import speed: rows a second and peak memory of each reader, beside the usual library for the same file.

    python benchmarks/recording/bench_import.py [--mb 50] [--kinds candump csv mf4]

One file a kind, about ``--mb`` large, of one axis at 1 kHz (SYNC and one PDO a row; time, position, torque).
Each reader works in a child of its own; peak memory is the child's with all it imports (idle: Python and
numpy). python-can, pandas, pyarrow and asammdf only read; invid checks the rows as well. Exit status 1 where
a reader of invid takes more than ``MOST_TIMES`` the file's size in memory.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

MOST_TIMES = 12.0
"""Peak memory over the file's size that is still bounded: numbers of eight bytes and the text beside them."""
LOADED_MB = 200.0
"""What Python's packages take whatever the file's size."""
COUNT = 2 * np.pi / 2**19
CHUNK = 100_000

_NUMBERS = (("status", "uint16"), ("torque", "int16"), ("position", "int32"))
_PDO = {"id": 0x181, "signals": [{"name": n, "type": t} for n, t in _NUMBERS]}
_UNITS = {"candump": ("counts", "permille"), "csv": ("rad", "Nm"), "mf4": ("rad", "Nm")}
READERS = {
    "candump": ("python-can", "invid, table", "invid import"),
    "csv": ("pandas", "pyarrow", "invid, table", "invid import"),
    "mf4": ("asammdf", "invid, table", "invid import"),
}


def chart(kind: str) -> dict[str, object]:
    """The import map of a kind."""
    angle, torque = _UNITS[kind]
    position = {"column": "position", "unit": angle, **({"per_count": COUNT} if angle == "counts" else {})}
    axis = {
        "name": "A1",
        "rated_torque": 50.0,
        "position": position,
        "torque": {"column": "torque", "unit": torque, "meaning": "measured"},
    }
    return {
        "format": "invid-import-map",
        "motion": "rotary",
        "source": {"kind": "can_log", "pdos": [_PDO]} if kind == "candump" else {},
        "time": {"column": "time"},
        "axes": [axis],
    }


def motion(start: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time [s], position [counts], torque [permille] of rows from ``start`` on."""
    k = np.arange(start, start + count)
    rng = np.random.default_rng(start)
    position = np.round(1e5 * np.sin(k / 300.0) + rng.normal(0, 1, count)).astype(int)
    return k * 1e-3, position, np.round(300 * np.sin(k / 300.0 + 0.4) + rng.normal(0, 2, count)).astype(int)


def write(kind: str, path: Path, megabytes: float) -> int:
    """Writes a file of about this size; its rows."""
    per_row = {"candump": 65, "csv": 32, "mf4": 24}[kind]
    rows = int(megabytes * 1e6 / per_row)
    if kind == "mf4":
        import asammdf

        t, p, m = motion(0, rows)
        with asammdf.MDF(version="4.10") as file:
            pair = (("position", p * COUNT, "rad"), ("torque", m * 0.05, "Nm"))
            file.append([asammdf.Signal(v.astype(float), t, name=n, unit=u) for n, v, u in pair])
            file.save(path)
        return rows
    with path.open("w", encoding="utf-8") as out:
        if kind == "csv":
            out.write("time,position,torque\n")
        for start in range(0, rows, CHUNK):
            lines = []
            for t, p, m in zip(*motion(start, min(CHUNK, rows - start)), strict=True):
                if kind == "csv":
                    lines.append(f"{t:.4f},{p * COUNT:.9f},{m * 0.05:.3f}\n")
                else:
                    data = (0x1237).to_bytes(2, "little") + int(m).to_bytes(2, "little", signed=True)
                    data += int(p).to_bytes(4, "little", signed=True)
                    lines.append(f"({t:.6f}) can0 080#\n({t + 2e-4:.6f}) can0 181#{data.hex().upper()}\n")
            out.writelines(lines)
    return rows


def child(reader: str, kind: str, path: Path) -> None:
    """Reads and prints JSON: rows, seconds of wall clock and processor, peak memory."""
    import resource
    import time

    began, spent = time.perf_counter(), time.process_time()
    rows = _read(reader, kind, path)
    used = time.perf_counter() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak = max(peak, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
    print(json.dumps({"rows": rows, "s": used, "cpu": time.process_time() - spent, "mb": peak / 1e3}))


def _read(reader: str, kind: str, path: Path) -> int:
    if reader == "nothing":
        return 0
    if reader == "python-can":
        import can

        return sum(1 for m in can.LogReader(path) if m.arbitration_id == 0x181)
    if reader == "pandas":
        import pandas

        return len(pandas.read_csv(path))
    if reader == "pyarrow":
        import pyarrow.csv

        return int(pyarrow.csv.read_csv(path).num_rows)
    if reader == "asammdf":
        import asammdf

        with asammdf.MDF(path) as file:
            return min(len(file.get(n).samples) for n in ("position", "torque"))
    from invid.recording.import_map import ImportMap
    from invid.recording.import_source import import_source
    from invid.recording.importer import read_table

    own = ImportMap.model_validate(chart(kind))
    if reader == "invid, table":
        return max(c.size for c in read_table(path, own.source).columns.values())
    return import_source([path], own, created="2026-01-01T00:00:00Z").recording.experiments[0].samples


def measured(reader: str, kind: str, path: Path) -> dict[str, float] | None:
    """What the child printed; ``None`` where its library is missing."""
    ran = subprocess.run(
        [sys.executable, __file__, "--child", reader, kind, str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    if ran.returncode:
        print(f"{kind:8} {reader:14} left out: {ran.stderr.strip().splitlines()[-1]}", flush=True)
        return None
    found: dict[str, float] = json.loads(ran.stdout.strip().splitlines()[-1])
    return found


def main() -> int:
    """Prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--mb", type=float, default=50.0)
    parser.add_argument("--kinds", nargs="*", default=list(READERS), choices=list(READERS))
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    options, _ = parser.parse_known_args()
    if options.child:
        child(options.child[0], options.child[1], Path(options.child[2]))
        return 0
    failed = 0
    with tempfile.TemporaryDirectory(prefix="bench-import-") as folder:
        idle = measured("nothing", "csv", Path(folder)) or {"mb": 0.0}
        print(f"idle: {idle['mb']:.0f} MB\n")
        print("file         MB  reader              rows       s    rows/s  peak MB  /file")
        for kind in options.kinds:
            path = Path(folder) / {"candump": "log.log", "csv": "log.csv", "mf4": "log.mf4"}[kind]
            write(kind, path, options.mb)
            size = path.stat().st_size / 1e6
            for reader in READERS[kind]:
                m = measured(reader, kind, path)
                if m is None:
                    continue
                times = (m["mb"] - idle["mb"]) / size
                failed += reader.startswith("invid") and times > MOST_TIMES + LOADED_MB / size
                speed = f"{m['s']:7.2f} {m['rows'] / m['s']:9.0f}"
                print(
                    f"{kind:8} {size:6.1f}  {reader:14} {m['rows']:9.0f} {speed} {m['mb']:8.0f} {times:6.1f}",
                    flush=True,
                )
            path.unlink()
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
