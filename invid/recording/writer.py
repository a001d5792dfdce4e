"""``RecordingWriter``: the recording written while it is measured.

Rows are gathered in memory and go to disk in one write for every second of data, into a file of their own
beside the recording (``.rows``, see ``invid.recording.spool``). ``close`` makes the HDF5 file of them, in
memory and then in one piece. A process killed at any instant leaves the rows, which lack at most the last
second (after a power cut the last six); ``read_recording`` and ``invid import`` read them as a recording
whose ``outcome`` is "failed", ``put_in_place`` makes its file.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from invid.disk import MEBIBYTE, WAY_OUT, not_written, room
from invid.errors import DiskFullError, RecordingError, SafetyStop
from invid.recording.hdf5 import hdf5_image
from invid.recording.model import Kind, Outcome, Recording, Role
from invid.recording.spool import Spool, read_spool, sync_folder
from invid.recording.stored import stored
from invid.wording.sentence import sentence

_FLUSH_S = 0.9
"""Data gathered before a burst [s]; below the promised second by one slow append."""
ROOM_BYTES = 8 * MEBIBYTE
"""Kept free on the disk beside what closing needs, which is at most as much again as the rows take. A guess
at what others may write in a second; 50 s of rows of six axes at 1 kHz."""


def put_in_place(rows: Path, target: Path, outcome: Outcome | None = None) -> None:
    """Make the recording ``target`` of the rows of a measurement, then remove them; a cut at any instant
    leaves one of the two.

    ``outcome`` is how it ended; ``None``: as the rows say.

    Raises
    ------
    OSError
        The disk does not take it; the rows stay.
    RecordingError
        The rows were cut off before their header was whole.
    """
    part = target.with_name(target.name + ".part")
    found = read_spool(rows)
    if outcome is not None:
        found = replace(found, attributes={**found.attributes, "outcome": str(outcome)})
    image = hdf5_image(found)
    try:
        with part.open("wb") as written:
            written.write(image)
            written.flush()
            os.fsync(written.fileno())
        part.replace(target)
        sync_folder(target.parent)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    with contextlib.suppress(OSError):
        rows.unlink()


def require_room(path: Path, rows: int, axes: int) -> None:
    """Raise DiskFullError where the disk does not hold so many rows and, beside them, their recording."""
    free, needed = shutil.disk_usage(path.parent).free, ROOM_BYTES + 2 * rows * (8 + 26 * axes)
    if free < needed:
        raise DiskFullError(
            f"{path}: it may need {needed / MEBIBYTE:.0f} MiB, {room(path.parent)}; nothing moved",
            way_out=f"{WAY_OUT}, then measure again",
        )


class RecordingWriter:
    """Context manager: ``begin``, ``append`` rows, ``end``, …, ``close(outcome)``.

    ``header`` is a ``Recording`` whose experiments are ignored. ``path`` is replaced at ``close`` and not
    before, so that a failed start never costs an earlier recording. Leaving the ``with`` block without
    ``close`` closes as completed, as aborted (SafetyStop, KeyboardInterrupt) or as failed (any other
    exception).
    """

    def __init__(self, path: str | Path, header: Recording) -> None:
        self.path = Path(path)
        self._axes = header.axes
        self._keys = 0
        self._inside = False
        self._rows: list[list[npt.NDArray[Any]]] = []
        self._names: tuple[str, ...] = ()
        self._full = False
        self._spool: Spool | None = None
        attributes = {k: v for k, v in stored(header).attributes.items() if k != "outcome"}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._require_room("nothing was recorded")
            self._spool = Spool(self.path, attributes)
        except OSError as error:
            raise not_written(self.path, error, otherwise=RecordingError) from None

    @property
    def rows_file(self) -> Path:
        """Where rows lie until the recording is closed; ``read_recording`` reads those that were flushed."""
        if self._spool is None:
            raise RecordingError(f"{self.path}: the recording is closed")
        return self._spool.path

    def begin(  # noqa: PLR0913 - the contract: the attributes of an experiment
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
        if self._inside:
            self.end()
        key = f"{self._keys:03d}"
        stated = {
            **(attributes or {}),
            "kind": str(Kind(kind)),
            "role": str(Role(role)),
            "excited_axis": int(excited_axis),
            "hold_gain": np.zeros(len(self._axes))
            if hold_gain is None
            else np.asarray(hold_gain, dtype=float),
            "period_samples": int(period_samples),
            "frequencies_hz": np.atleast_1d(np.asarray(frequencies_hz, dtype=float)),
            "sample_rate_hz": float(sample_rate_hz),
        }
        names = ["time", "position", "torque"] + ["torque_demand"] * demand + ["status"] * status
        self._guarded(lambda spool: spool.begin(key, names, stated))
        self._inside, self._names = True, tuple(names)
        self._keys += 1
        return key

    def append(
        self,
        time: npt.ArrayLike,
        position: npt.ArrayLike,
        torque: npt.ArrayLike,
        demand: npt.ArrayLike | None = None,
        status: npt.ArrayLike | None = None,
    ) -> None:
        """Add rows: ``time`` (k,) [s], the rest (k, M). One row may be given as a scalar and (M,)."""
        if not self._inside:
            raise RecordingError(f"{self.path}: rows appended outside an experiment; call begin first")
        if self._full:
            self._require_room(sentence("the recording so far is kept"))
            self._full = False
        given = {"position": position, "torque": torque, "torque_demand": demand, "status": status}
        block: list[npt.NDArray[Any]] = [np.array(time, dtype=np.float64, ndmin=1)]
        for name in self._names[1:]:
            if given[name] is None:
                raise RecordingError(f"{self.path}: this experiment logs {name!r}, but no value was given")
            values = np.array(given[name], dtype=np.uint16 if name == "status" else np.float64, ndmin=2)
            needed = (block[0].size, len(self._axes))
            if values.shape != needed:
                raise RecordingError(f"{self.path}: {name!r} has shape {values.shape}, need {needed}")
            block.append(values)
        if block[0].size:
            self._rows.append(block)
            if block[0][-1] - self._rows[0][0][0] >= _FLUSH_S:
                self.flush()

    def flush(self) -> None:
        """Write the gathered rows.

        Raises
        ------
        RecordingError
            The disk is nearly full or does not take them. The gathered rows are dropped; what was written
            before stays, and the recording can still be closed.
        """
        if not self._inside or not self._rows:
            return
        try:
            self._require_room(sentence("the recording so far is kept"))
            block = [np.concatenate(parts) for parts in zip(*self._rows, strict=True)]
            self._guarded(lambda spool: spool.rows(block))
        except RecordingError:
            self._rows, self._full = [], True
            raise
        self._rows = []

    def _guarded(self, write: Callable[[Spool], None]) -> None:
        spool = self._spool
        if spool is None:
            raise RecordingError(f"{self.path}: the recording is closed; nothing more can be written")
        try:
            write(spool)
        except OSError as error:
            kept = sentence("the recording so far is kept")
            raise not_written(self.path, error, kept=kept, otherwise=RecordingError) from None

    def _require_room(self, kept: str) -> None:
        free = shutil.disk_usage(self.path.parent).free
        needed = ROOM_BYTES + (self._spool.size if self._spool is not None else 0)
        if free < needed:
            raise DiskFullError(
                f"{self.path}: the disk is nearly full: {room(self.path.parent)}, "
                f"{needed / MEBIBYTE:.0f} MiB are kept back to close the file; {kept}",
                way_out=f"{WAY_OUT}, then measure again",
            )

    def end(self) -> None:
        """Close the experiment; one without rows leaves nothing."""
        if not self._inside:
            return
        try:
            self.flush()
        finally:
            self._inside = False
        self._guarded(Spool.end)

    def close(self, outcome: Outcome | str = Outcome.COMPLETED) -> None:
        """Mark how the measurement ended and put the file in its place; safe to call twice.

        Raises
        ------
        RecordingError
            The disk does not take it; the rows that it took before stay in their own file, which is named.
        """
        spool = self._spool
        if spool is None:
            return
        refused = None
        try:
            self.end()
        except RecordingError as error:
            refused = error  # what was taken before is closed all the same
        self._rows, self._spool = [], None
        with contextlib.suppress(OSError):
            spool.outcome(str(Outcome(outcome)))
        spool.close()
        try:
            put_in_place(spool.path, self.path, Outcome(outcome))
        except OSError as error:
            kept = (
                f"what was measured is in {spool.path}: `invid import {spool.path} -o {self.path}` makes it"
            )
            raise not_written(self.path, error, kept=kept, otherwise=RecordingError) from None
        if refused is not None:
            raise refused

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        is_aborted = kind is not None and issubclass(kind, (SafetyStop, KeyboardInterrupt))
        unhurt = Outcome.ABORTED if is_aborted else Outcome.FAILED
        self.close(Outcome.COMPLETED if kind is None else unhurt)
