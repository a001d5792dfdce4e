"""Throughput of ``invid batch``: one process, a pool, a Dask cluster on loopback; results bit for bit.

    python benchmarks/batch/bench_batch.py [--recordings 12] [--workers 2]

Recordings are of one axis of two masses (four periods of 2,048 samples), the cheapest there are: what
a batch itself costs shows most.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "system"))
from test_contract_surface import write_recording


def timed(folder: Path, results: Path, *arguments: str) -> float:
    """Seconds of one batch."""
    command = [sys.executable, "-m", "invid", "batch", str(folder), "-o", str(results), *arguments, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(json.loads(done.stdout)["seconds"])


def documents(results: Path) -> dict[str, bytes]:
    """All that a batch left, by its path."""
    return {str(p.relative_to(results)): p.read_bytes() for p in results.rglob("*.*") if p.is_file()}


def main() -> int:
    """Print a line a way of working; status 1 where results differ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, default=12)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        (root / "in").mkdir()
        for k in range(given.recordings):
            write_recording(root / "in" / f"{k:04d}.h5", np.arange(5 + k % 3, 400, 7 + k % 5), 5.0, 0.01)
        cores = len(os.sched_getaffinity(0))
        print(f"{given.recordings} recordings, {cores} cores, load {os.getloadavg()[0]:.1f} at the start")
        seconds = {"one process": timed(root / "in", root / "one", "--workers", "1")}
        pool = f"pool of {given.workers}"
        seconds[pool] = timed(root / "in", root / "pool", "--workers", str(given.workers))
        dask = f"Dask, {given.workers} workers of one thread"
        seconds[dask] = with_cluster(root, given.workers)
        for way, took in seconds.items():
            rate, gain = 3600 * given.recordings / took, seconds["one process"] / took
            print(f"  {way:<32} {took:7.1f} s {rate:8.0f} recordings/h {gain:5.2f} times")
        same = documents(root / "one") == documents(root / "pool") == documents(root / "dask")
        print(f"documents and index the same bit for bit: {'yes' if same else 'NO'}")
    return 0 if same else 1


def with_cluster(root: Path, workers: int) -> float:
    """Seconds on a cluster that is up."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster:
        time.sleep(1.0)
        return timed(root / "in", root / "dask", "--scheduler", cluster.scheduler_address)


if __name__ == "__main__":
    sys.exit(main())
