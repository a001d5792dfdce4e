"""Where a search over causes starts: the records of a machine that is shaken, and its fit with friction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.errors import NotIdentifiableError
from invid.identification.contest import NOTHING, Known, begin, begin_open
from invid.identification.fitted_model import plant_of
from invid.identification.kept_out import Split, all_records, records_of
from invid.identification.missing_torque import missed_share
from invid.identification.own_time import AxisTones, changes_within, sized, tones_of
from invid.likelihood.unknown_forces.fitted_hypothesis import (
    Bench,
    FittedHypothesis,
    Hypothesis,
    first_strength,
    fit_hypothesis,
    settle_hypothesis,
)
from invid.likelihood.unknown_forces.motor_laws import Part, first_shapes
from invid.likelihood.unknown_forces.price import NUMBER
from invid.likelihood.unknown_forces.shapes import reshape, scan_friction
from invid.likelihood.unknown_forces.stack import hold_damping, stack_records
from invid.likelihood.unknown_forces.timing import Timing
from invid.likelihood.unknown_forces.value import Numbers
from invid.model.chains import CoupledChains
from invid.model.plant import Structure
from invid.numerics import budget
from invid.recording.model import Recording
from invid.recording.roll_off import low_passed_axes
from invid.signals.record import Record
from invid.signals.tones import refine_tones, remove_tones
from invid.wording.sentence import sentence

TIME_TO_BEGIN = 0.7
"""Share of the time that is left for the first fits, of which most end sooner: from chains that are astray no
cause is found (empirical: what is done of them without a budget)."""

STILL = 1e-4
"""Velocity over that of the fastest axis below which friction of an axis is not seen (numerical)."""
Start = Callable[[Bench, Structure, Bench | None, Known], FittedHypothesis]
"""The first fit of a structure on records fitted and kept out, with what is known."""


@dataclass(frozen=True, eq=False)
class SearchStart:
    """Where a search over causes of a recording starts.

    ``declared``: masses of each axis as asked for; ``None`` where the records are to say, and chains may
    become longer.
    """

    recording: Recording
    first: FittedHypothesis
    declared: tuple[int, ...] | None
    warnings: tuple[str, ...]
    alike: tuple[tuple[int, ...], ...] = ()
    """Other numbers of masses that explain the records as well."""
    tones: tuple[AxisTones, ...] = ()
    """Torque taken out since it repeats with no period: an undamped mode would take it for its own."""
    stopgap: tuple[str, ...] = ()
    """What is kept out for want of records for validation, to warn of where there are none."""

    @property
    def sizes(self) -> tuple[int, ...]:
        """Masses of each axis."""
        return self.first.hypothesis.structure.sizes

    @property
    def missed(self) -> float:
        """Rms share of the torque that is missing beyond noise on what is kept out, of the worst axis."""
        return missed_share(self.first)


def begin_elastic(
    recording: Recording,
    sizes: Sequence[int] | None,
    known: CoupledChains | None = None,
    *,
    start: Start = begin,
) -> SearchStart:
    """The fit with friction at the motors that a search starts from, of the recording without tones.

    ``sizes``: masses of each axis; as many as the records ask for where not given. ``known``: chains of so
    many masses that the first fit starts from. ``start``: how chains of so many masses are first fitted.
    """
    before = NOTHING if known is None else Known(plant=plant_of(known))
    begun = _begin(recording, sizes, before, start)
    tones = tones_of(begun.first)
    if not tones or budget.is_left_out(sentence("torque that keeps its own time")):
        return _each_period(begun)
    hz = refine_tones(recording, sorted({t.hz for axis in tones for t in axis.tones}))
    again = _begin(remove_tones(recording, hz), sizes, before, start)
    worse = _whole(again.first) - _whole(begun.first)
    if worse > 3 * NUMBER * len(hz):
        return _each_period(
            begun
        )  # a part of the motion was taken out: what keeps its own time is on no line of a period
    return _each_period(replace(again, tones=sized(tones, recording, again.first.numbers.plant)))


def _whole(found: FittedHypothesis) -> float:
    """−2 ln L of all records."""
    return found.total + found.kept_total


def _each_period(begun: SearchStart) -> SearchStart:
    """The same with every period on its own where the machine changes within a record: a period's lines show
    the mean of what it was.

    Of a torque that went through a low-pass nobody knows what its noise is within the band.
    """
    if not changes_within(begun.first) or low_passed_axes(begun.recording.experiments):
        return begun
    if budget.is_left_out(sentence("each period on its own")):
        return begun
    benches = _benches(records_of(begun.recording, by_period=True))
    first = fit_hypothesis(benches, begun.first.hypothesis, begun.first.numbers)
    return replace(begun, first=reshape(scan_friction(first)))


def _benches(split: Split) -> tuple[Bench, Bench]:
    """Records fitted and kept out, of one damping of holds."""
    damping = hold_damping((*split.fitted, *split.kept))
    return Bench(stack_records(split.fitted, damping)), Bench(stack_records(split.kept, damping))


def _bench(records: Sequence[Record]) -> Bench:
    return Bench(stack_records(records, hold_damping(records)))


def _begin(recording: Recording, sizes: Sequence[int] | None, known: Known, start: Start) -> SearchStart:
    split = records_of(recording)
    bench, beside = _benches(split)
    declared = None if sizes is None else tuple(sizes)
    alike: tuple[tuple[int, ...], ...] = ()
    try:
        with budget.use_share(TIME_TO_BEGIN, 0.0, 0.3):
            budget.tell("fitting the machine alone", 0.0)
            if declared is None:
                first, alike = begin_open(bench, recording.axis_count, beside)
            else:
                first = start(bench, Structure(declared), beside, known)
    except np.linalg.LinAlgError as error:
        raise NotIdentifiableError(
            f"{recording.source}: {error}",
            way_out="check signs, units and the number of masses",
            code="nothing_fits",
        ) from None
    return SearchStart(recording, first, declared, split.warnings, alike, stopgap=split.stopgap)


def on_all_records(now: FittedHypothesis, recording: Recording) -> FittedHypothesis:
    """A hypothesis without laws fitted to every record of a recording, none kept out."""
    bench = _bench(all_records(recording))
    return reshape(fit_hypothesis((bench, None), now.hypothesis, now.numbers))


def settled_about(chains: CoupledChains, records: Sequence[Record]) -> FittedHypothesis:
    """A known plant with friction at its motors on records: strengths and timing as the records have them."""
    bench, plant = _bench(records), plant_of(chains)
    timing = Timing.of_records(bench.stacks)
    power = np.mean([(r.motion.velocity**2).mean(axis=0) for r in records], axis=0)
    still = np.flatnonzero(power <= STILL**2 * power.max())
    absent = frozenset((part, int(motor)) for motor in still for part in Part)
    hypothesis = Hypothesis(plant.structure, first_shapes(bench.stacks), absent=absent)
    numbers = Numbers(plant, timing, first_strength(bench.stacks, plant.structure))
    return settle_hypothesis(bench, hypothesis, numbers)
