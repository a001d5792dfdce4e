"""Work out the response as it grows on the page while the robot is being measured.

A process of its own, at the lowest priority, looks at the growing rows: the cycle that shakes the robot
is not disturbed by it. After each experiment |Θ|/|T| of every driven axis on the excited lines is told.
It is a live picture, no result: with several axes moving at once it is not the FRF, which needs all
experiments and comes with the result.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from invid.errors import InvidError
from invid.recording.spool import SUFFIX, as_hdf5, finished_experiments

_MOST_LINES = 300
_LOOK_EVERY_S = 0.5


class ResponseWatch:
    """Context manager that runs the process that works out responses, and hands on what it tells."""

    def __init__(self, path: Path, tell: Callable[[dict[str, Any]], None]) -> None:
        self._path, self._tell = path, tell
        self._process: subprocess.Popen[bytes] | None = None
        self._told: set[str] = set()
        self._thread = threading.Thread(target=self._hear, name="response", daemon=True)

    def __enter__(self) -> ResponseWatch:
        with contextlib.suppress(OSError):
            self._process = subprocess.Popen(
                [sys.executable, "-m", "invid_service.jobs.response", str(self._path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        process = self._process
        if process is not None:
            if process.stdin is not None:
                process.stdin.close()
            try:
                process.wait(1.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            self._thread.join(1.0)
        # Nothing moves any more: what a starved process did not get to see is looked at here.
        with contextlib.suppress(OSError, KeyError, ValueError, RuntimeError, InvidError):
            for response in look(self._path, self._told):
                self._tell(response)

    def _hear(self) -> None:
        if self._process is None or self._process.stdout is None:
            return
        for line in self._process.stdout:
            with contextlib.suppress(ValueError):
                response = json.loads(line)
                self._told.add(str(response["experiment"]))
                self._tell(response)


def look(path: Path, told: set[str]) -> Iterator[dict[str, Any]]:
    """Yield responses of the finished experiments that were not told yet."""
    rows = path.with_name(path.name + SUFFIX)
    if rows.exists():
        finished = finished_experiments(rows)
        if finished > len(told):
            with as_hdf5(rows) as file:
                yield from _responses(file, sorted(file["experiments"])[:finished], told)
    elif path.exists():
        with h5py.File(path, "r") as file:
            yield from _responses(file, sorted(file["experiments"]), told)


def _responses(file: h5py.File, keys: list[str], told: set[str]) -> Iterator[dict[str, Any]]:
    for key in keys:
        if key in told:
            continue
        node = file["experiments"][key]
        response = response_of(node) if node["time"].shape[0] else None
        told.add(key)
        if response is not None:
            yield {"experiment": key, **response}


def main() -> None:
    """Work out responses until stdin ends, then once more."""
    os.nice(19)
    path, told, ended = Path(sys.argv[1]), set[str](), threading.Event()

    def listen() -> None:
        sys.stdin.buffer.read()
        ended.set()

    threading.Thread(target=listen, daemon=True).start()
    last = False
    while not last:
        last = ended.wait(_LOOK_EVERY_S)
        with contextlib.suppress(OSError, KeyError, ValueError, RuntimeError, InvidError):
            for response in look(path, told):
                sys.stdout.write(json.dumps(response) + "\n")
                sys.stdout.flush()


def response_of(node: h5py.Group) -> dict[str, Any] | None:
    """Return lines [Hz] and, per axis, |Θ|/|T| in dB; ``None`` where nothing is excited."""
    lines = np.atleast_1d(np.asarray(node.attrs.get("frequencies_hz", []), dtype=float))
    if lines.size == 0:
        return None
    rate = float(node.attrs["sample_rate_hz"])
    position, torque = np.asarray(node["position"]), np.asarray(node["torque"])
    period = int(node.attrs.get("period_samples", 0)) or position.shape[0]
    whole = (position.shape[0] // period) * period
    if whole == 0:
        return None
    position, torque = position[-whole:], torque[-whole:]
    bins = np.round(lines * whole / rate).astype(int)
    keep = (bins > 0) & (bins < whole // 2)
    step = max(1, int(np.ceil(keep.sum() / _MOST_LINES)))
    lines, bins = lines[keep][::step], bins[keep][::step]
    theta = np.fft.rfft(position - position.mean(axis=0), axis=0)[bins]
    force = np.fft.rfft(torque, axis=0)[bins]
    axes: list[list[float | None] | None] = []
    for i in range(position.shape[1]):
        driven = np.abs(force[:, i]) > 1e-3 * np.abs(force).max()
        if driven.mean() < 0.2:
            axes.append(None)
            continue
        ratio = np.abs(theta[:, i]) / np.maximum(np.abs(force[:, i]), 1e-300)
        db = 20 * np.log10(np.maximum(ratio, 1e-300))
        axes.append([round(float(v), 2) if ok else None for v, ok in zip(db, driven, strict=True)])
    return {"frequency_hz": [round(float(f), 4) for f in lines], "db": axes}


if __name__ == "__main__":
    main()
