"""A writer that keeps what it has written, so that a running measurement can be judged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from invid.numerics.arrays import frozen_float
from invid.recording import Experiment, Recording, RecordingWriter


class CollectingWriter(RecordingWriter):
    """A ``RecordingWriter`` whose finished experiments can be looked at before the file is closed."""

    def __init__(self, path: str | Path, header: Recording) -> None:
        super().__init__(path, header)
        self._header = header
        self._finished: list[Experiment] = []
        self._settings: dict[str, Any] = {}
        self._key = ""
        self._kept: list[tuple[Any, ...]] = []

    @property
    def recording(self) -> Recording:
        """The experiments that have ended."""
        return replace(self._header, experiments=tuple(self._finished))

    def begin(self, **settings: Any) -> str:
        """Open the next experiment and return its key, as ``RecordingWriter.begin`` does."""
        key = super().begin(**settings)
        self._key, self._settings, self._kept = key, settings, []
        return key

    def append(self, time: Any, position: Any, torque: Any, demand: Any = None, status: Any = None) -> None:
        """Add rows, as ``RecordingWriter.append`` does."""
        super().append(time, position, torque, demand, status)
        parts = (time, position, torque, demand)
        self._kept.append(tuple(None if p is None else np.array(p, dtype=float) for p in parts))

    def end(self) -> None:
        """Close the experiment, as ``RecordingWriter.end`` does."""
        super().end()
        if not self._key or not self._kept:
            return
        time, position, torque, demand = (
            None if part[0] is None else frozen_float(np.concatenate([np.asarray(p) for p in part]))
            for part in zip(*self._kept, strict=True)
        )
        settings = self._settings
        if time is not None and position is not None and torque is not None:
            self._finished.append(
                Experiment(
                    key=self._key,
                    kind=settings["kind"],
                    role=settings["role"],
                    excited_axis=settings["excited_axis"],
                    hold_gain=frozen_float(settings["hold_gain"]),
                    period_samples=settings["period_samples"],
                    frequencies_hz=frozen_float(settings["frequencies_hz"]),
                    sample_rate_hz=settings["sample_rate_hz"],
                    time=time,
                    position=position,
                    torque=torque,
                    torque_demand=demand,
                )
            )
        self._key, self._kept = "", []


class Judged:
    """A recording that is being written, and the judge who says whether it needs another experiment."""

    def __init__(self, out: Path, header: Recording, go_on: Callable[[Recording], bool]) -> None:
        self._out, self._header, self._go_on = out, header, go_on
        self._writer: CollectingWriter | None = None

    def open(self) -> CollectingWriter:
        """Open the file, with the first row."""
        self._writer = CollectingWriter(self._out, self._header)
        return self._writer

    def ask(self, number: int) -> bool:
        """Whether the next experiment is needed."""
        return self._writer is None or self._go_on(self._writer.recording)
