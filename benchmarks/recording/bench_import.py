"""Import of large files beside the libraries that read them.

    python benchmarks/recording/bench_import.py [--megabytes 200]

Three axes of a rotary machine at 1 kHz, written as CSV, as a candump log and as MDF 4. Each way runs in a
process of its own on one core; counted is its processor time after `import invid`, the library's own import
with it, and its largest memory.

library    every column (CSV by polars, MDF by asammdf) or every frame (candump by python-can), thrown away
read       the product's table of the same file (of MDF in a process of its own, which a damaged file may end)
import     `invid import`: the table read, its clock, units and signs judged, the recording written

Bars: `read` within twice the library, the memory of `import` within ten times the file.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import numpy as np

from invid.api import import_recording
from invid.recording.hdf5 import write_recording
from invid.recording.import_map import load_map
from invid.recording.readers.kinds import read_table

RATE, AXES = 1000.0, 3
BYTES_A_ROW = {"csv": 85, "log": 156, "mf4": 56}
TWICE, TEN = 2.0, 10.0
MAP = """format: invid-import-map
format_version: 1
robot: bench
{source}time: {{column: time, unit: s}}
axes:
{axes}
experiments: [{{rows: [0, null]}}]
"""


def columns(rows: int) -> dict[str, np.ndarray]:
    """Time, positions [rad] and torques [N·m]."""
    rng, time_s = np.random.default_rng(0), np.arange(rows) / RATE
    out = {"time": time_s}
    for i in range(1, AXES + 1):
        swing = np.sin(2 * i * time_s) * (1.5 + np.sin(0.1 * time_s))
        out[f"p{i}"] = swing + 1e-4 * rng.standard_normal(rows)
        out[f"t{i}"] = 5.0 * np.cos(2 * i * time_s) + 0.02 * rng.standard_normal(rows)
    return out


def write(path: Path, rows: int) -> None:
    """The file, and its map beside it."""
    found, kind = columns(rows), path.suffix[1:]
    source, unit, torque = "", "unit: rad", "unit: N·m, meaning: measured"
    if kind == "csv":
        import_module("polars").DataFrame({n: np.round(v, 8) for n, v in found.items()}).write_csv(path)
    elif kind == "mf4":
        clock, asammdf = found["time"], import_module("asammdf")
        signals = [asammdf.Signal(v, clock, name=n) for n, v in found.items() if n != "time"]
        with asammdf.MDF(version="4.10") as file:
            file.append(signals)
            file.save(path)
    else:
        pdo = "  - {{id: {}, signals: [{{name: p{n}, type: int32}}, {{name: t{n}, type: int16}}]}}\n"
        source = "source:\n  pdos:\n" + "".join(pdo.format(0x180 + n, n=n) for n in range(1, AXES + 1))
        unit, torque = "unit: counts, per_count: 1.0e-5", "unit: N·m, scale: 0.01, meaning: measured"
        counts = [np.rint(found[f"p{n}"] * 1e5).astype("<i4") for n in range(1, AXES + 1)]
        felt = [np.rint(found[f"t{n}"] * 100).astype("<i2") for n in range(1, AXES + 1)]
        with path.open("w") as out:
            for k, t in enumerate(found["time"]):
                out.write(f"({1.7e9 + t:.6f}) can0 080#\n")
                for n in range(AXES):
                    data = (counts[n][k].tobytes() + felt[n][k].tobytes()).hex().upper()
                    out.write(f"({1.7e9 + t + 2e-4 * (n + 1):.6f}) can0 {0x181 + n:03X}#{data}\n")
    axes = "\n".join(
        f"- {{name: A{n}, position: {{column: p{n}, {unit}}}, torque: {{column: t{n}, {torque}}}}}"
        for n in range(1, AXES + 1)
    )
    path.with_suffix(f".{kind}.yaml").write_text(MAP.format(source=source, axes=axes))


def read_by_library(path: Path) -> None:
    """Everything in a file, by the library of its kind, which is imported for it as the product does."""
    if path.suffix == ".csv":
        import_module("polars").read_csv(path)
    elif path.suffix == ".mf4":
        with import_module("asammdf").MDF(path) as file:
            for signal in file.iter_channels():
                signal.samples.sum()
    else:
        for _ in import_module("can").LogReader(path):
            pass


def spent(way: str, path: Path) -> tuple[float, float]:
    """Processor time [s] and largest memory [bytes] of one way in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, "--way", way, str(path)], stdout=subprocess.PIPE, text=True, check=True
    )
    seconds, memory = json.loads(done.stdout.splitlines()[-1])
    return seconds, memory


def work(way: str, path: Path) -> None:
    """One way, and what it used, as JSON."""
    mapping = path.with_suffix(f"{path.suffix}.yaml")
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    before = sum(os.times()[:4])
    if way == "library":
        read_by_library(path)
    elif way == "read":
        read_table(path, load_map(mapping).source, beside=mapping.parent)
    else:
        write_recording(import_recording(path, mapping), path.with_suffix(".h5"))
    with suppress(ChildProcessError):
        os.waitpid(-1, 0)
    used = sum(os.times()[:4]) - before
    kept = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    print(json.dumps([used, 1024 * max(kept)]))


def main() -> int:
    """Print a row a kind; exit status 1 where a bar is missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--megabytes", type=float, default=200.0)
    parser.add_argument("--way", nargs=2, metavar=("WAY", "FILE"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.way:
        work(given.way[0], Path(given.way[1]))
        return 0
    missed = False
    print(f"{'':<6}{'file':>8}{'library':>10}{'read':>10}{'ratio':>8}{'import':>10}{'':>12}{'memory':>14}")
    with tempfile.TemporaryDirectory() as folder:
        for kind, size in BYTES_A_ROW.items():
            path = Path(folder) / f"big.{kind}"
            write(path, int(given.megabytes * 1e6 / size))
            whole = path.stat().st_size
            (library, _), (read, _), (total, memory) = (spent(w, path) for w in ("library", "read", "import"))
            missed |= read > TWICE * library or memory > TEN * whole
            print(
                f"{kind:<6}{whole / 1e6:5.0f} MB{library:8.2f} s{read:8.2f} s{read / library:8.2f}"
                f"{total:8.2f} s{whole / 1e6 / total:7.0f} MB/s{memory / whole:6.1f} × file"
            )
            path.unlink()
    print("a bar is missed" if missed else "all bars met")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
