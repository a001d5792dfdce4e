"""Records to fit, and what is kept out of every fit to validate it.

Experiments with role 'validate' are kept out; without any a record more than the plant needs, else the last
period of each, else every fifth line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from invid.errors import InputError, NotIdentifiableError
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.signals.holds import find_smooth_hold, read_holds
from invid.signals.periods import true_period
from invid.signals.record import Record, make_record
from invid.wording.sentence import sentence

FIFTH = 5
"""Every so many lines one is kept out."""
AS_WEAK = 4.0
"""Energy of the torque over the least up to which an experiment tells no more than the weakest (empirical:
realisations of one plan differ by amplitudes of up to two)."""
LEAST_LINES = 12
"""Lines an axis from which anything is fitted: two masses with friction and timing have ten numbers."""

MISSING = sentence("no validation experiment (role 'validate')")


@dataclass(frozen=True, eq=False)
class Split:
    """Records to fit and records kept out, what to warn about, and what is kept out for want of better."""

    fitted: tuple[Record, ...]
    kept: tuple[Record, ...]
    warnings: tuple[str, ...]
    stopgap: tuple[str, ...] = ()


def records_of(recording: Recording, *, by_period: bool = False) -> Split:
    """The experiments as records on lines up to one frequency for all, split in those to fit and those kept
    out.

    ``by_period``: every period is a record of its own.

    Raises
    ------
    InputError
        No experiment is to be fitted.
    NotIdentifiableError
        Records too short for a plant.
    """
    experiments, warnings = _with_true_periods(recording)
    parts = _Parts(recording, experiments, by_period)
    if not parts.train:
        raise InputError(f"{recording.source}: no experiment with role 'identify'")
    fitted, kept, said = _split(parts)
    lines = sum(r.used.size for r in fitted)
    if lines < LEAST_LINES * recording.axis_count:
        raise NotIdentifiableError(
            f"{recording.source}: the records hold {lines} lines to {parts.band:.3g} Hz, and the unknowns of "
            f"a machine take {LEAST_LINES} an axis",
            way_out="record for longer, lengthen the period, or widen the band",
            code="too_few_lines",
            values={"lines": lines, "least_an_axis": LEAST_LINES, "band_hz": float(parts.band)},
        )
    known = _with_holds([*fitted, *kept], parts)  # of one machine: what one record shows holds for all
    fitted, kept = known[: len(fitted)], known[len(fitted) :]
    return Split(tuple(fitted), tuple(kept), tuple(warnings), (said,) if said else ())


def all_records(recording: Recording) -> list[Record]:
    """Every experiment as a record, none kept out."""
    experiments, _ = _with_true_periods(recording)
    parts = _Parts(recording, experiments, False)
    return _with_holds(parts.records(parts.experiments), parts)


def _with_holds(records: Sequence[Record], parts: _Parts) -> list[Record]:
    """The records with the gains of holds that they show: on lines without a command, else by the command's
    smoothness."""
    out = read_holds(records)
    slow = {e.key for e in parts.experiments if e.kind is Kind.CONSTANT_VELOCITY}
    shaken = [r for r in records if r.key not in slow]
    for m in range(parts.recording.axis_count):
        if any(np.isfinite(r.hold_damping[m]) or r.is_hold_sampled for r in out):
            continue
        law = find_smooth_hold(shaken, m)
        if law is not None:  # a stiffness that is stated stands
            out = [
                r.with_hold(m, r.hold[m] if r.hold[m] > 0 else law[0], law[1])
                if r.driven[m] and not r.tells_command(m)
                else r
                for r in out
            ]
    return out


def _with_true_periods(recording: Recording) -> tuple[tuple[Experiment, ...], list[str]]:
    """The experiments with the periods that they have, and what is said of those."""
    out, said = [], list[str]()
    for e in recording.experiments:
        period, found = (0, []) if e.kind is Kind.CONSTANT_VELOCITY else true_period(e)
        said += found
        out.append(e if period == e.period_samples else replace(e, period_samples=period))
    return tuple(out), said


@dataclass(frozen=True, eq=False)
class _Parts:
    recording: Recording
    experiments: tuple[Experiment, ...]
    by_period: bool

    @cached_property
    def train(self) -> list[Experiment]:
        return [e for e in self.experiments if e.role is Role.IDENTIFY]

    @cached_property
    def validate(self) -> list[Experiment]:
        return [e for e in self.experiments if e.role is Role.VALIDATE]

    @cached_property
    def shaken(self) -> list[Experiment]:
        """Those for fitting that show elasticity: slow moves are none to spare and none that can be cut."""
        return [e for e in self.train if e.kind is not Kind.CONSTANT_VELOCITY]

    @cached_property
    def spare(self) -> Experiment:
        """Of those that drive all axes, or of all, the last that tells no more than the weakest: the climb
        before a block is spared, not the block."""
        able = [e for e in self.shaken if _drives_all(e)] or self.shaken
        energy = [float((e.torque**2).sum()) for e in able]
        return [e for e, own in zip(able, energy, strict=True) if own <= AS_WEAK * min(energy)][-1]

    @cached_property
    def top(self) -> float | None:
        """Highest frequency that is said to be excited [Hz]; else what the records show."""
        stated = [float(e.frequencies_hz.max()) for e in self.experiments if e.frequencies_hz.size]
        return max(stated, default=None)

    def records(self, experiments: Sequence[Experiment]) -> list[Record]:
        """The experiments as records."""
        origin = min(float(e.time[0]) for e in self.experiments)
        resolution = self.recording.encoder_resolution
        if self.by_period:
            experiments = [part for e in experiments for part in _periods_of(e)]
        return [replace(make_record(e, resolution, self.band), origin=origin) for e in experiments]

    @cached_property
    def band(self) -> float:
        """Highest frequency of interest in any of them [Hz]."""
        resolution = self.recording.encoder_resolution
        return self.top or max(make_record(e, resolution).top_hz for e in self.shaken or self.train)


def _periods_of(e: Experiment) -> list[Experiment]:
    """Every whole period on its own, with the sample before it where there is one."""
    if e.periods < 2:
        return [e]
    starts = [e.samples - e.period_samples * k for k in range(e.periods, 0, -1)]
    return [e.cut(slice(max(first - 1, 0), first + e.period_samples)) for first in starts]


def _last_period_apart(e: Experiment) -> tuple[Experiment, Experiment]:
    """What is before the last period, and that period, each with a sample of the other."""
    first = e.samples - e.period_samples
    return e.cut(slice(None, first + 1)), e.cut(slice(first - 1, None))


def _drives_all(e: Experiment) -> bool:
    return not 0 <= e.excited_axis < e.hold_gain.size or e.hold_gain.size == 1


def _split(parts: _Parts) -> tuple[list[Record], list[Record], str | None]:
    """Records to fit, records kept out, and what is said where those are a stopgap."""
    if parts.validate:
        return parts.records(parts.train), parts.records(parts.validate), None
    shaken = parts.shaken
    # One more than the linear plant needs: each axis once, or M of all at once.
    if len(shaken) > parts.recording.axis_count and any(_drives_all(e) for e in shaken):
        said = sentence(
            "no validation experiment (role 'validate'): experiment {experiment} is kept out "
            "of every fit instead; record one with another realisation and amplitude",
            experiment=parts.spare.key,
        )
        rest = parts.records([e for e in parts.train if e is not parts.spare])
        return rest, parts.records([parts.spare]), said
    if shaken and all(e.period_samples and e.periods >= 2 for e in shaken):
        moves = [e for e in parts.train if e.kind is Kind.CONSTANT_VELOCITY]
        begin, last = zip(*map(_last_period_apart, shaken), strict=True)
        said = sentence(
            "{missing}: the last period of each experiment is kept out of every fit instead, "
            "which repeats the same motion; record one with another realisation",
            missing=MISSING,
        )
        return parts.records([*begin, *moves]), parts.records(last), said
    fitted, kept = [], []
    for record in parts.records(parts.train):
        number = np.arange(record.used.size)
        # The mean is one line: it is in both, or a constant torque would be worth nothing in one.
        fitted.append(replace(record, used=record.used[number % FIFTH != FIFTH - 1]))
        kept.append(replace(record, used=record.used[(number % FIFTH == FIFTH - 1) | (record.used == 0)]))
    said = sentence(
        "{missing} and no whole period to spare: every fifth line is kept out of every fit "
        "instead; record an experiment of its own for validation",
        missing=MISSING,
    )
    return fitted, kept, said
