"""``invid measure``: shake the axes and record position and torque."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import typer

from invid.api import read_recording, screen
from invid.cli.output import EXIT_NOT_TRUSTWORTHY, EXIT_OK, emit, note
from invid.comparison.answers import Screening
from invid.config import CellConfig, load_config
from invid.errors import BusError, DriveError, InputError, SafetyStop, left_by, note_left
from invid.model.diagnosis_document import load_model
from invid.model.document import Model, load_json
from invid.planning import Plan
from invid.planning.belief import Belief, from_model
from invid.planning.build import require_all_axes
from invid.planning.goal import judge_of
from invid.planning.screening import screening_plan
from invid.planning.separating_experiments import to_separate
from invid.planning.stopping_distance import StoppingBudget
from invid.sweep import Progress
from invid_drivers.cli.expectation import (
    NOTHING,
    belief_of,
    expectation,
    expected_text,
    limits_of,
    limits_text,
)
from invid_drivers.measurement import MeasurementResult, measure_to_file
from invid_drivers.readiness import ask, foresee, loads_to_support, support_sentence
from invid_drivers.simulated.config import sensor_noise
from invid_drivers.stop_flag import StopFlag
from invid_drivers.stopping_budgets import Wish
from invid_drivers.timing import timing_of

STDERR = 2
WORDS = "the emergency stop is within reach and nobody is within reach of the axes"
"""What a person says before hardware moves."""


@contextlib.contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """An event that Ctrl-C, a closed terminal and a polite kill set, so that the drives are stopped in order.

    Ctrl-Z too: a measurement cannot be suspended, the axes would go on without anybody who reads.
    """
    stop = StopFlag()

    def ask(number: int, frame: object) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()
        # Past Python's own buffer: a line that the signal interrupted may be in it, and may not be entered
        # twice. The terminal may be gone.
        with contextlib.suppress(OSError):
            os.write(STDERR, b"invid measure: stopping; once more to stop at once\n")

    before = {}
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP):
        with contextlib.suppress(ValueError):  # not in the main thread
            if number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN:
                continue  # nohup: to go on is what was asked for
            before[number] = signal.signal(number, ask)
    try:
        yield stop
    except KeyboardInterrupt as error:
        stopped = SafetyStop("stopped at once on request", code="asked")
        note_left(stopped, left_by(error) or ("make sure that every axis is off",))
        raise stopped from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def confirm(cell: CellConfig, *, confirmed: bool) -> None:
    """Ask on the terminal, unless it was confirmed on the command line or no hardware stands behind the cell.

    Without a terminal there is nobody to ask: whoever had the command started there answers for it, and is
    told so.

    Raises
    ------
    InputError
        The answer was not yes.
    """
    if cell.simulated:
        return
    axes = ", ".join(a.name for a in cell.axes)
    tried = loads_to_support(cell)
    if tried:
        note(f"{cell.robot}: {support_sentence(tried)}")
    if confirmed:
        return
    if sys.stdin is None or not sys.stdin.isatty():
        note(
            f"{cell.robot} will move: {axes}. Nobody could be asked (no terminal): whoever started this "
            f"answers for it that {WORDS} (--confirmed says so)"
        )
        return
    note(f"{cell.robot} will move: {axes}. Confirm that {WORDS}. Type yes to go on:")
    try:
        answer = sys.stdin.readline()
    except KeyboardInterrupt:
        answer = ""
    if answer.strip().lower() not in ("y", "yes"):
        raise InputError(f"measure: not confirmed that {WORDS}; nothing was opened and nothing moved")


class ProgressLine:
    """Prints a line on stderr for every phase and every five seconds of robot time."""

    def __init__(self) -> None:
        self._phase = ""
        self._eta = float("inf")

    def __call__(self, progress: Progress) -> None:
        """Print the line where one is due."""
        if progress.phase == self._phase and self._eta - progress.eta_s < 5.0:
            return
        self._phase, self._eta = progress.phase, progress.eta_s
        where = f" {progress.axis}" if progress.axis else ""
        line = f" {progress.frequency:.3g} Hz" if progress.frequency else ""
        with contextlib.suppress(OSError):  # nobody reads any more: no reason to stop, nor to fail
            note(f"  {progress.fraction:4.0%}  {progress.eta_s:5.0f} s left  {progress.phase}{where}{line}")


def plan_text(plan: Plan, robot: str) -> str:
    """The plan as text for a person: experiments, torque, travel, velocity, power."""
    lines = [
        f"{robot}: {len(plan.recorded)} experiments, {plan.duration_s:.0f} s of robot time; "
        f"bus load {plan.budget.load:.0%} of at most {plan.budget.max_load:.0%}",
        f"  {'experiment':<11}{'kind':<18}{'role':<10}{'axes':<14}{'seconds':>8}  band",
    ]
    for e in plan.recorded:
        axes = ",".join(plan.axes[i] for i in e.excited)
        band = (
            f"{e.frequencies_hz.min():.3g}…{e.frequencies_hz.max():.3g} Hz, {e.frequencies_hz.size} lines"
            if e.frequencies_hz.size
            else ""
        )
        lines.append(
            f"  {e.key:<11}{e.kind!s:<18}{e.role!s:<10}{axes:<14}{e.cycles * plan.cycle_s:>8.1f}  {band}"
        )
    lines.append("  at most, from the first cycle to the last, trials, starts and moves included:")
    lines.append(f"  {'axis':<11}{'torque':<18}{'travel':<22}{'velocity':<18}power")
    for f in plan.forecast:
        unit = "m" if f.unit == "N" else "rad"
        cells = (
            f"{f.peak_torque:.3g} {f.unit}",
            f"±{f.travel:.3g} {unit}",
            f"{f.velocity:.3g} {unit}/s",
            f"{f.power:.3g} W",
        )
        lines.append(
            f"  {f.axis:<11}" + "".join(f"{c:<{w}}" for c, w in zip(cells, (18, 22, 18, 0), strict=True))
        )
    lines += [f"  note: {w}" for w in plan.warnings]
    return "\n".join(lines)


def budget_lines(budgets: Sequence[StoppingBudget], *, linear: bool) -> list[str]:
    """Lines for a person on how each axis comes to rest."""
    if not budgets:
        return []
    head = "  to rest, beyond the window, at most:"
    return [head, *(f"    {b.text(linear=linear)}" for b in budgets)]


def result_text(result: MeasurementResult) -> str:
    """A finished measurement as text for a person."""
    lines = [
        f"{result.path}: {result.duration_s:.0f} s of robot time, {result.outcome}"
        + (" (simulated: no hardware moved)" if result.simulated else "")
    ]
    for axis, peak in result.peaks.items():
        lines.append(
            f"  {axis}: travel {peak['travel']:.3g}, velocity {peak['velocity']:.3g}, torque "
            f"{peak['torque']:.3g} at most"
        )
    if result.skipped_slots:
        lines.append(f"  skipped SYNC slots: {result.skipped_slots}")
    if result.jitter_us:
        lines.append("  SYNC late by " + ", ".join(f"{k} {v:.0f} µs" for k, v in result.jitter_us.items()))
    if result.energised:
        lines.append(f"  energised, held by their drives: {', '.join(result.energised)}; see the notes")
    lines += [f"  note: {w}" for w in result.warnings]
    return "\n".join(lines)


def _required(out: Path | None) -> Path:
    if out is None:
        raise InputError("measure: no recording named; add -o REC.h5 (or --dry-run)")
    return out


def tell_plan(cell: CellConfig, wish: Wish, belief: Belief | None, *, as_json: bool) -> int:
    """Print the dry run of a plan, within what the drives that are there leave."""
    why, noise = tuple[str, ...](), sensor_noise(cell)
    try:
        within = ask(cell, wish).require()
    except (BusError, DriveError) as error:  # at a desk, say
        within = foresee(cell, wish)
        why = (f"the drives were not asked or are not ready, the limits are the config's: {error}",)
    plan, cell, budgets = within.plan, within.config, within.budgets
    found, timing = expectation(cell, plan, belief, noise), timing_of(cell)
    limits = limits_of(cell, plan, belief, noise)
    beyond = [*why, *within.said, *timing.warnings(plan)]
    document = {
        "dry_run": True,
        "robot": cell.robot,
        "simulated": cell.simulated,
        **plan.to_json(),
        "budgets": [b.to_json() for b in budgets],
        "expected": None if found is None else found.to_json(),
        "detection_limits": [limit.to_json() for limit in limits],
        "timing": timing.to_json(),
    }
    document["warnings"] = [*document["warnings"], *beyond]
    shown = [
        plan_text(plan, cell.robot),
        *budget_lines(budgets, linear=cell.linear),
        f"  {timing.text()}",
        *(f"  note: {w}" for w in beyond),
        f"  note: {NOTHING}" if found is None else expected_text(found, linear=cell.linear),
        *([limits_text(limits)] if limits else []),
    ]
    emit(document, "\n".join(shown), as_json=as_json)
    return EXIT_OK


def screen_cell(
    cell: CellConfig,
    model: Model,
    out: Path,
    *,
    progress: Callable[[Progress], None] | None = None,
    stop: threading.Event | None = None,
) -> tuple[MeasurementResult, Screening]:
    """Measure for seconds; the measurement, and what it says of whether anything changed since the model."""
    plan = screening_plan(cell, from_model(model, cell), sensor_noise(cell))
    result = measure_to_file(cell, out, Wish(plan=plan), progress=progress, stop=stop)
    return result, screen(read_recording(out), model)


def run_screening(cell: CellConfig, model: Model, out: Path, *, as_json: bool) -> int:
    """Screen; return 3 where nothing can be told."""
    with stop_on_signals() as stop:
        result, found = screen_cell(cell, model, out, progress=ProgressLine(), stop=stop)
    document, said = {**result.to_json(), "screening": found.to_json()}, found.sentence
    untold = found.verdict == "cannot tell"
    if untold:
        document["warnings"] = [*document["warnings"], said]
    emit(document, f"{result_text(result)}\n  {found.verdict}: {said}", as_json=as_json)
    return EXIT_NOT_TRUSTWORTHY if untold else EXIT_OK


def cell_to_separate(cell: CellConfig, path: Path, *, screening: bool) -> CellConfig:
    """The cell with the experiments that a diagnosis asks for, told in words."""
    if screening:
        raise InputError("--separate plans its own experiments: leave --screen")
    document = load_json(path)
    if not isinstance(document, dict):
        raise InputError(f"{path}: no diagnosis: the document is no object")
    separation = to_separate(document, cell)
    for sentence in separation.sentences:
        note(f"invid measure: {sentence}")
    return separation.config


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    def measure(
        config: Path = typer.Argument(..., help="The cell's config."),
        out: Path | None = typer.Option(None, "-o", "--out", help="Recording to write (HDF5)."),
        dry_run: bool = typer.Option(
            False,
            "--dry-run",
            help="Print the plan; move nothing. Drives that are there are asked for their limits.",
        ),
        axes: str | None = typer.Option(
            None, "--axes", help="Axes to excite, as A1,A2: all, unless --separate says what for."
        ),
        amplitude: float = typer.Option(1.0, "--amplitude", help="Factor on every torque, at most 1."),
        model: Path | None = typer.Option(
            None, "--model", help="Last accepted model: foretells travel and uncertainty."
        ),
        screening: bool = typer.Option(
            False,
            "--screen",
            help="Test in seconds whether anything changed since --model.",
        ),
        separate: Path | None = typer.Option(
            None,
            "--separate",
            help="Diagnosis: run what tells its alternatives apart instead.",
        ),
        confirmed: bool = typer.Option(
            False,
            "--yes",
            "--confirmed",
            help="The emergency stop is within reach and people are out: do not ask.",
        ),
        as_json: bool = typer.Option(False, "--json", help="One JSON document on stdout."),
    ) -> int:
        """Shake the axes and record position and torque."""
        cell = load_config(config)
        if separate is not None:
            cell = cell_to_separate(cell, separate, screening=screening)
        chosen = None if axes is None else [a.strip() for a in axes.split(",") if a.strip()]
        if separate is None:
            require_all_axes(cell, chosen)
        belief = belief_of(cell, model)
        known = None if model is None else belief
        if screening:
            if model is None:
                raise InputError("--screen needs the accepted model to test against: --model MODEL.json")
            if chosen is not None or amplitude != 1.0:
                raise InputError(
                    "--screen excites all axes at the amplitude it needs: leave --axes and --amplitude"
                )
            accepted = load_model(model)
            if dry_run:
                believed = from_model(accepted, cell)
                plan = screening_plan(cell, believed, sensor_noise(cell))
                return tell_plan(cell, Wish(plan=plan), believed, as_json=as_json)
            out = _required(out)
            confirm(cell, confirmed=confirmed)
            return run_screening(cell, accepted, out, as_json=as_json)
        wish = Wish(chosen, amplitude, known)
        if dry_run:
            return tell_plan(cell, wish, belief, as_json=as_json)
        out = _required(out)
        confirm(cell, confirmed=confirmed)
        with stop_on_signals() as stop:
            result = measure_to_file(
                cell,
                out,
                wish,
                progress=ProgressLine(),
                stop=stop,
                judge=judge_of(cell, lambda found: note(f"  so far: {found.sentence}")),
            )
        emit(result.to_json(), result_text(result), as_json=as_json)
        return EXIT_OK
