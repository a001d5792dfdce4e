"""``measure_to_file``: the one way to measure, used by the command, the demo and the service."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import yaml

from invid.config import CellConfig
from invid.errors import ConfigError, DriveError, InvidError, SafetyStop, left_by, note_left
from invid.numerics.arrays import frozen_float
from invid.planning import AxisForecast, Plan
from invid.planning.goal import Judge
from invid.recording import Outcome, Recording
from invid.recording.writer import require_room
from invid.sweep import Progress, Sink, Sweep, SweepResult
from invid.sweep.recorder import Recorder
from invid.wording.sentence import sentence
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.connect import connect, is_virtual
from invid_drivers.filing import Judged
from invid_drivers.protocol import AxisStates
from invid_drivers.readiness import prepare, require_plan
from invid_drivers.relay import ALL_OFF, Listeners, measure_in_process
from invid_drivers.stopping_budgets import Wish, measured_budgets

__all__ = ["MeasurementResult", "Progress", "measure_to_file"]


@dataclass(frozen=True)
class MeasurementResult:
    """A finished measurement."""

    path: Path
    outcome: Outcome
    duration_s: float
    """Robot time [s]."""
    simulated: bool
    amplitude_scale: float
    skipped_slots: int = 0
    missed_tpdos: dict[str, int] = field(default_factory=dict)
    peaks: dict[str, dict[str, float]] = field(default_factory=dict)
    forecast: tuple[AxisForecast, ...] = ()
    """What was announced after the trials."""
    jitter_us: dict[str, float] | None = None
    """Lateness of SYNC against its slot, in real time: median, 99th and 99.9th percentile, worst."""
    jitter_histogram: dict[str, int] | None = None
    """How many SYNCs were at most so late."""
    drives: tuple[dict[str, Any], ...] = ()
    energised: tuple[str, ...] = ()
    """Axes that their drives hold in quick stop active."""
    warnings: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "recording": str(self.path),
            "outcome": str(self.outcome),
            "simulated": self.simulated,
            "duration_s": self.duration_s,
            "amplitude_scale": self.amplitude_scale,
            "skipped_slots": self.skipped_slots,
            "missed_tpdos": self.missed_tpdos,
            "peaks": self.peaks,
            "forecast": [f.to_json() for f in self.forecast],
            "jitter_us": self.jitter_us,
            "jitter_histogram": self.jitter_histogram,
            "drives": list(self.drives),
            "energised": list(self.energised),
            "warnings": list(self.warnings),
        }


def measure_to_file(  # noqa: PLR0913 - a run, and who is told, asked and may stop it
    config: CellConfig,
    out: Path,
    wish: Wish = Wish(),
    *,
    progress: Callable[[Progress], None] | None = None,
    seen: Callable[[AxisStates], None] | None = None,
    stop: threading.Event | None = None,
    judge: Judge | None = None,
) -> MeasurementResult:
    """Run the config's experiments, or those that are wished for, and write the recording.

    ``judge`` may end the run early; ``seen`` hears the states of axes behind hardware. ``out`` is not touched
    before the first experiment begins. Whatever ends the run, the drives are stopped and restored, and what
    was measured is closed and marked in ``out``.

    Raises
    ------
    ConfigError
        Before anything is opened.
    SafetyStop, DriveError, BusError
        The measurement ended early; the recording so far is in ``out``.
    """
    out = Path(out)
    require_plan(config, wish)
    if is_virtual(config):
        return run_measurement(config, wish, connect(config), out, progress=progress, stop=stop, judge=judge)
    _require_file(out)
    listeners = Listeners(progress, seen, stop or threading.Event())
    result: MeasurementResult = measure_in_process(config, out, wish, listeners, judge)
    return result


class ClosingSink(Sink, Protocol):
    """A sink of samples that is told at the end how the measurement ended."""

    def close(self, outcome: Outcome) -> None:
        """Mark how the measurement ended, and close."""
        ...


def _require_file(out: Path) -> None:
    """Refuse a path that could not be written after the measurement, or would replace a device."""
    if out.is_dir():
        raise ConfigError(f"{out}: is a folder; name a file for the recording")
    if out.exists() and not out.is_file():
        raise ConfigError(f"{out}: is no ordinary file; name a file for the recording")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out.parent):
            pass
    except OSError as error:
        raise ConfigError(
            f"{out}: cannot be written there ({error.strerror or error}); name a file for the recording in a "
            "folder that can"
        ) from None


def run_measurement(  # noqa: PLR0913 - a run, and who is told, asked and may stop it
    config: CellConfig,
    wish: Wish | Plan,
    cell: Cia402Cell,
    out: Path,
    *,
    progress: Callable[[Progress], None] | None = None,
    stop: threading.Event | None = None,
    open_sink: Callable[[Recording], tuple[ClosingSink, Sequence[str]]] | None = None,
    judge: Judge | None = None,
    asked: Callable[[], bool] | None = None,
) -> MeasurementResult:
    """The measurement on a connected cell, which is closed at the end.

    ``open_sink`` says where samples go instead of into ``out`` and what is to be said of that, and ``asked``
    who then answers whether the next experiment is needed (see ``Sweep.go_on``); without it ``judge`` is
    called in between, which only a cell in virtual time can wait for.
    """
    recorder: ClosingSink | None = None
    outcome = Outcome.FAILED
    try:
        _require_file(out)
        if stop is not None:
            cell.cancelled = stop.is_set
        # before anything is enabled: what would end with missing answers is refused
        wish = Wish(plan=wish) if isinstance(wish, Plan) else wish
        found = prepare(cell, config, wish, cancelled=cell.cancelled)
        plan, notes = found.plan, list(found.said)
        require_room(out, sum(e.record_to - e.record_from for e in plan.recorded), len(plan.axes))
        header = _header(config, cell)
        if open_sink is not None:
            recorder, more = open_sink(header)
            notes += more
        else:
            judged = Judged(out, header, judge)
            recorder = Recorder(judged.open, plan.cycle_s, len(plan.axes))
            asked = None if judge is None else judged.ask_later()
        permit = measured_budgets(found.config, cell.reports, plan)
        sweep = Sweep(
            plan, found.config, cell, recorder, progress=progress, stop=stop, go_on=asked, permit=permit
        )
        cell.tell = sweep.say
        result = sweep.run()
        outcome = Outcome.COMPLETED
        complaints = cell.close()
        if cell.not_off or cell.not_held:
            failed = (*cell.not_off, *cell.not_held)
            raise DriveError("the measurement is complete, but not every axis is off or held", axes=failed)
    except BaseException as error:
        if isinstance(error, (SafetyStop, KeyboardInterrupt)):
            outcome = Outcome.ABORTED
        _leave(cell, recorder, outcome, error)
        raise
    recorder.close(outcome)
    return _result(config, cell, out, result, [*notes, *complaints])


def _leave(cell: Cia402Cell, recorder: ClosingSink | None, outcome: Outcome, error: BaseException) -> None:
    """Stop the drives, restore them, close the file, in this order; what is left is noted in the error.

    The drives first: a file that cannot be closed must not keep an axis energised. What interrupts this, a
    second Ctrl-C or a fault of this program, carries what is known by then.
    """
    try:
        cell.suspect(error)
        cell.close()
    except BaseException as worse:
        cell.stop()  # it may have been interrupted
        note_left(worse, (*left_by(error), *_left(cell, worse)))
        raise
    finally:
        note_left(error, _left(cell, error))
        try:
            if recorder is not None:
                recorder.close(outcome)
        except InvidError as failure:
            note_left(error, (str(failure),))


def _left(cell: Cia402Cell, error: BaseException) -> tuple[str, ...]:
    """What is known of the axes; whoever ended it at once is told where all are off, too."""
    if cell.left or not isinstance(error, KeyboardInterrupt):
        return cell.left
    return (ALL_OFF,)


def _header(config: CellConfig, cell: Cia402Cell) -> Recording:
    masses = [a.masses for a in config.axes]
    known = [m for m in masses if m is not None]
    document = config.model_dump(mode="json", exclude_none=True)
    return Recording(
        robot=config.robot,
        axes=cell.axes,
        position_unit="m" if config.linear else "rad",
        torque_unit="N" if config.linear else "N·m",
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        experiments=(),
        masses_per_axis=tuple(known) if len(known) == len(masses) else None,
        rated_torque=frozen_float(cell.rated_torque),
        encoder_resolution=frozen_float(cell.resolution),
        config=yaml.safe_dump(document, sort_keys=False, allow_unicode=True),
        attributes={"simulated": config.simulated},
    )


def _result(
    config: CellConfig,
    cell: Cia402Cell,
    out: Path,
    result: SweepResult,
    complaints: list[str],
) -> MeasurementResult:
    seen = result.statistics
    axes = cell.axes
    warnings = [*result.warnings, *complaints, *cell.notes]
    for report in cell.reports:
        warnings += report.warnings
        warnings += [
            sentence("axis {axis}: the drive lacks {what}", axis=report.axis, what=what)
            for what in report.lacks
        ]
    rows = seen.cycles * len(axes)
    lost = sum(seen.missed_tpdos or [])
    if lost > 0.001 * rows:
        warnings.append(
            sentence(
                "{lost} of {rows} samples did not arrive and were filled from their neighbours",
                lost=lost,
                rows=rows,
            )
        )
    if seen.skipped_slots > 0.001 * max(seen.cycles, 1):
        warnings.append(
            sentence(
                "{skipped_slots} of {cycles} SYNC slots were skipped: the computer was late",
                skipped_slots=seen.skipped_slots,
                cycles=seen.cycles,
            )
        )
    return MeasurementResult(
        path=out,
        outcome=Outcome.COMPLETED,
        duration_s=result.measured_s,
        simulated=config.simulated,
        amplitude_scale=result.scale,
        skipped_slots=seen.skipped_slots,
        missed_tpdos=dict(zip(axes, seen.missed_tpdos or [], strict=False)),
        peaks={
            a: {"travel": x, "velocity": v, "torque": t}
            for a, x, v, t in zip(
                axes,
                seen.peak_travel or [],
                seen.peak_velocity or [],
                seen.peak_torque or [],
                strict=False,
            )
        },
        forecast=result.forecast,
        jitter_us=None if is_virtual(config) else cell.jitter.percentiles(),
        jitter_histogram=None if is_virtual(config) else cell.jitter.to_json(),
        drives=tuple(r.to_json() for r in cell.reports),
        energised=cell.held_at_end,
        warnings=tuple(dict.fromkeys(warnings)),
    )
