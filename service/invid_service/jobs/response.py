"""The response as it grows on the page while the robot is being measured.

After each experiment its rows are read back from the growing file and |Θ|/|T| of every driven axis on
the excited lines is told. It is a live picture, no result: with several axes moving at once it is not
the FRF, which needs all experiments and comes with the result.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

_MOST_LINES = 300


class ResponseWatch:
    """Looks at the file when the phase of the measurement changes."""

    def __init__(self, path: Path, tell: Callable[[dict[str, Any]], None]) -> None:
        self._path, self._tell = path, tell
        self._phase = ""
        self._told = 0

    def look(self, phase: str) -> None:
        """Called with every progress; does something only between experiments."""
        if phase == self._phase:
            return
        self._phase = phase
        if not self._path.exists():
            return
        try:
            with h5py.File(self._path, "r") as file:
                keys = sorted(file["experiments"])
                # The newest may still be growing.
                for key in keys[self._told : len(keys) - 1]:
                    node = file["experiments"][key]
                    if node["time"].shape[0] == 0:
                        break
                    response = response_of(node)
                    self._told += 1
                    if response is not None:
                        self._tell({"experiment": key, **response})
        except (OSError, KeyError, ValueError, RuntimeError):
            return  # a picture is not worth a measurement


def response_of(node: h5py.Group) -> dict[str, Any] | None:
    """Lines [Hz] and, per axis, |Θ|/|T| in dB; ``None`` where nothing is excited."""
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
