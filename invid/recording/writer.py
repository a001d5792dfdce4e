"""``RecordingWriter``: the recording written while it is measured.

Rows are gathered in memory and go to the file in one burst for every second of data, followed by a
flush; between bursts libhdf5 is not touched, so a process killed at any other instant leaves a whole,
readable file that lacks at most the last second. A file without the attribute ``outcome`` is such a
cut-off one. A burst costs a few milliseconds: in a real-time cycle, append between experiments or
from another process.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from invid.errors import RecordingError, SafetyStop
from invid.numerics.arrays import frozen_float
from invid.recording.hdf5 import experiment_attributes, root_attributes, set_attributes
from invid.recording.model import Experiment, Kind, Outcome, Recording, Role

_FLUSH_S = 0.9
"""Data gathered before a burst [s]; below the promised second by one slow append."""
_CHUNK_ROWS = 1024
ROOM_BYTES = 8 << 20
"""Kept free on the disk: libhdf5 that meets a full one loses the whole file and takes the process with it,
and closing needs some. A guess at what others may write in a second; 50 s of rows of six axes at 1 kHz."""


class RecordingWriter:
    """Context manager: ``begin``, ``append`` rows, ``end``, …, ``close(outcome)``.

    ``header`` is a ``Recording`` whose experiments are ignored. Where ``path`` is free the file grows
    there; where a file already stands it grows beside it (``.part``) and replaces it at ``close``, so
    that a failed start never costs an earlier recording. Leaving the ``with`` block without ``close``
    closes as completed, as aborted (SafetyStop, KeyboardInterrupt) or as failed (any other exception).
    """

    def __init__(self, path: str | Path, header: Recording) -> None:
        self.path = Path(path)
        self._target = self.path.with_name(self.path.name + ".part") if self.path.exists() else self.path
        self._axes = header.axes
        self._keys = 0
        self._group: h5py.Group | None = None
        self._rows: list[tuple[npt.NDArray[Any], ...]] = []
        self._names: tuple[str, ...] = ()
        self._first = 0.0
        self._full = False
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._require_room("nothing was recorded")
            self._file: h5py.File | None = h5py.File(self._target, "w")
            set_attributes(self._file, {k: v for k, v in root_attributes(header).items() if k != "outcome"})
            self._file.create_group("experiments")
            self._file.flush()
        except RecordingError:
            raise
        except (OSError, RuntimeError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise RecordingError(f"{self.path}: cannot be written: {reason}") from None

    def begin(
        self,
        *,
        kind: Kind,
        excited_axis: int,
        sample_rate_hz: float,
        role: Role = Role.IDENTIFY,
        hold_gain: npt.ArrayLike | None = None,
        period_samples: int = 0,
        frequencies_hz: Sequence[float] | npt.ArrayLike = (),
        demand: bool = True,
        status: bool = True,
        attributes: Mapping[str, Any] | None = None,
    ) -> str:
        """Open the next experiment and return its key. ``demand`` and ``status`` say what is logged."""
        if self._group is not None:
            self.end()
        count = len(self._axes)
        empty = frozen_float(np.zeros((0, count)))
        header = Experiment(
            key=f"{self._keys:03d}",
            kind=Kind(kind),
            role=Role(role),
            excited_axis=int(excited_axis),
            hold_gain=frozen_float(np.zeros(count) if hold_gain is None else hold_gain),
            period_samples=int(period_samples),
            frequencies_hz=frozen_float(np.atleast_1d(np.asarray(frequencies_hz, dtype=float))),
            sample_rate_hz=float(sample_rate_hz),
            time=frozen_float(np.zeros(0)),
            position=empty,
            torque=empty,
            attributes=dict(attributes or {}),
        )
        group = self._open().create_group(f"experiments/{header.key}")
        set_attributes(group, experiment_attributes(header))
        names = ["time", "position", "torque"] + ["torque_demand"] * demand + ["status"] * status
        for name in names:
            width = () if name == "time" else (count,)
            group.create_dataset(
                name,
                shape=(0, *width),
                maxshape=(None, *width),
                chunks=(_CHUNK_ROWS, *width),
                dtype=np.uint16 if name == "status" else np.float64,
                compression="gzip",
                compression_opts=1,
                shuffle=True,
            )
        self._group, self._names = group, tuple(names)
        self._keys += 1
        return header.key

    def append(
        self,
        time: npt.ArrayLike,
        position: npt.ArrayLike,
        torque: npt.ArrayLike,
        demand: npt.ArrayLike | None = None,
        status: npt.ArrayLike | None = None,
    ) -> None:
        """Add rows: ``time`` (k,) [s], the rest (k, M). One row may be given as a scalar and (M,)."""
        if self._group is None:
            raise RecordingError(f"{self.path}: rows appended outside an experiment; call begin first")
        given = {
            "time": time,
            "position": position,
            "torque": torque,
            "torque_demand": demand,
            "status": status,
        }
        if self._full:
            self._require_room("the recording so far is kept")
            self._full = False
        instants = np.atleast_1d(np.asarray(time, dtype=np.float64))
        rows: list[npt.NDArray[Any]] = [instants]
        for name in self._names[1:]:
            values = given[name]
            if values is None:
                raise RecordingError(f"{self.path}: this experiment logs {name!r}, but no value was given")
            block = np.atleast_2d(np.asarray(values, dtype=np.uint16 if name == "status" else np.float64))
            if block.shape != (instants.size, len(self._axes)):
                raise RecordingError(
                    f"{self.path}: {name!r} has shape {block.shape}, "
                    f"need ({instants.size}, {len(self._axes)})"
                )
            rows.append(block)
        if instants.size == 0:
            return
        if not self._rows:
            self._first = float(instants[0])
        self._rows.append(tuple(r.copy() for r in rows))
        if instants[-1] - self._first >= _FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Write the gathered rows and flush the file.

        Raises
        ------
        RecordingError
            The disk is nearly full. The gathered rows are dropped; what was written before stays, and the
            file can still be closed.
        """
        if self._group is not None and self._rows:
            try:
                self._require_room("the recording so far is kept")
            except RecordingError:
                self._rows, self._full = [], True
                raise
            for i, name in enumerate(self._names):
                block = np.concatenate([r[i] for r in self._rows])
                dataset = self._group[name]
                start = dataset.shape[0]
                dataset.resize(start + block.shape[0], axis=0)
                dataset[start:] = block
            self._rows = []
        self._open().flush()

    def _require_room(self, kept: str) -> None:
        free = shutil.disk_usage(self.path.parent).free
        if free < ROOM_BYTES:
            raise RecordingError(
                f"{self.path}: the disk is nearly full: {free / 2**20:.1f} MiB are free, {ROOM_BYTES >> 20} "
                f"MiB are kept back to close the file; {kept}. Free some space and measure again"
            )

    def end(self) -> None:
        """Close the experiment; one without rows is taken out again."""
        if self._group is None:
            return
        self.flush()
        if self._group["time"].shape[0] == 0:
            del self._open()[self._group.name]
        self._group = None
        self._open().flush()

    def close(self, outcome: Outcome | str = Outcome.COMPLETED) -> None:
        """Mark how the measurement ended and put the file in its place; safe to call twice."""
        if self._file is None:
            return
        self.end()
        self._file.attrs["outcome"] = str(Outcome(outcome))
        self._file.close()
        self._file = None
        if self._target != self.path:
            self._target.replace(self.path)

    def _open(self) -> h5py.File:
        if self._file is None:
            raise RecordingError(f"{self.path}: the recording is closed; nothing more can be written")
        return self._file

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close(Outcome.COMPLETED)
        elif issubclass(kind, (SafetyStop, KeyboardInterrupt)):
            self.close(Outcome.ABORTED)
        else:
            self.close(Outcome.FAILED)
