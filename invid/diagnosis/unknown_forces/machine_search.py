"""The search on one machine: records, the basin, causes one after another, what each is worth at the end.

After the first fit a whole answer exists at every instant: each later stage has its share of the time that is
left, and a stage that it ends leaves what was found so far.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np

from invid.diagnosis.unknown_forces.backward import Worth, first_order_worths, worths
from invid.diagnosis.unknown_forces.fitted_model import plant_of
from invid.diagnosis.unknown_forces.kept_out import Split, records_of
from invid.diagnosis.unknown_forces.left_over import (
    PlaceForce,
    at_their_places,
    missed_share,
    place_forces,
)
from invid.diagnosis.unknown_forces.named_terms import axis_and_element
from invid.diagnosis.unknown_forces.nameless import add_laws
from invid.diagnosis.unknown_forces.own_time import AxisTones, changes_within, sized, tones_of
from invid.diagnosis.unknown_forces.pursuit import Pursued, pursue
from invid.diagnosis.unknown_forces.structures import additions_of, with_masses_seen, without
from invid.effects.supposed_laws import supposed_laws
from invid.errors import NotIdentifiableError
from invid.identification.contest import NOTHING, Known, begin, begin_open
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.plant import Structure
from invid.likelihood.unknown_forces.shapes import reshape, scan_friction
from invid.likelihood.unknown_forces.stack import hold_damping, stack_records
from invid.likelihood.unknown_forces.supposition import Bench, Channel, Supposed, suppose
from invid.model.chains import CoupledChains
from invid.numerics import budget
from invid.recording.model import Recording
from invid.signals.tones import refine_tones, remove_tones

TIME_TO_BEGIN, TIME_TO_PURSUE, TIME_TO_WEIGH = 0.5, 0.6, 0.5
"""Shares of the time that is left for the first fits, for the causes, and for what each is worth (empirical:
what is done of them without a budget)."""
CAUSES = "further causes"
"""What a spent budget leaves out without which nothing is certain, in the words of the warning."""


@dataclass(frozen=True, eq=False)
class Begun:
    """Where a search over causes of a recording starts.

    ``declared``: masses of each axis as asked for; ``None`` where the records are to say, and chains may
    become longer.
    """

    recording: Recording
    first: Supposed
    declared: tuple[int, ...] | None
    warnings: tuple[str, ...]
    tones: tuple[AxisTones, ...] = ()
    """Torque taken out since it repeats with no period: an undamped mode would take it for its own."""

    @property
    def sizes(self) -> tuple[int, ...]:
        """Masses of each axis."""
        return self.first.hypothesis.structure.sizes

    @property
    def missed(self) -> float:
        """Rms share of the torque that is missing beyond noise on what is kept out, of the worst axis."""
        return missed_share(self.first)


@dataclass(frozen=True, eq=False)
class ElasticSearch:
    """What a search found on one recording.

    ``named`` is the fit with the causes that have a name, ``end`` that with laws without one besides,
    ``bare`` the plant alone. ``forces`` are left at the places of ``end``, ``forces_named`` at those of
    ``named``.
    """

    recording: Recording
    pursued: Pursued
    end: Supposed
    worths: tuple[Worth, ...]
    bare: Supposed
    named: Supposed
    forces: tuple[PlaceForce, ...]
    forces_named: tuple[PlaceForce, ...]
    is_cut_short: bool = False


def search_elastic(begun: Begun) -> ElasticSearch:
    """The search over causes on the records for fitting, judged on those kept out."""
    recording = begun.recording

    def tell(now: Supposed, share: float) -> None:
        budget.tell_found(found_so_far(now, recording.axes))
        budget.tell("looking for causes", share)

    with budget.use_share(TIME_TO_PURSUE, 0.3, 0.75):
        laws = supposed_laws(linear=recording.linear)
        pursued = pursue(begun.first, laws, tell=tell, growing=begun.declared is None)
    is_cut_short = CAUSES in budget.left_out()
    with budget.use_share(TIME_TO_WEIGH, 0.75, 0.85):
        budget.tell("weighing each cause", 0.0)
        found, weighed = budget.or_else(
            "what each cause is worth", lambda: _weighed(with_masses_seen(pursued.end)), None
        ) or _by_first_order(pursued.end)
    budget.tell("what is left", 0.85)
    named = budget.or_else("what is left at each place", lambda: at_their_places(weighed), weighed)
    bare = without_causes(named)
    nothing: tuple[PlaceForce, ...] = ()
    forces_named = budget.or_else("what is left at each place", lambda: place_forces(named, bare), nothing)
    end, forces = named, forces_named
    with_law = budget.or_else("a law without a name", lambda: add_laws(named, forces_named), None)
    if with_law is not None:
        found, end = budget.or_else(
            "what each cause is worth", lambda: _weighed(with_law), None
        ) or _by_first_order(with_law)
        forces = budget.or_else("what is left at each place", lambda: place_forces(end, bare), nothing)
    return ElasticSearch(recording, pursued, end, found, bare, named, forces, forces_named, is_cut_short)


def begin_elastic(
    recording: Recording, sizes: Sequence[int] | None, known: CoupledChains | None = None
) -> Begun:
    """The fit with friction at the motors that a search starts from, of the recording without tones.

    ``sizes``: masses of each axis; as many as the records ask for where not given. ``known``: chains of so
    many masses that the first fit starts from.
    """
    before = NOTHING if known is None else Known(plant=plant_of(known))
    begun = _begin(recording, sizes, before)
    tones = tones_of(begun.first)
    if not tones or budget.is_left_out("torque that keeps its own time"):
        return _each_period(begun)
    hz = refine_tones(recording, sorted({t.hz for axis in tones for t in axis.tones}))
    again = _begin(remove_tones(recording, hz), sizes, before)
    return _each_period(replace(again, tones=sized(tones, recording, again.first.numbers.plant)))


def _each_period(begun: Begun) -> Begun:
    """The same with every period on its own where the machine changes within a record: a period's lines show
    the mean of what it was."""
    if not changes_within(begun.first) or budget.is_left_out("each period on its own"):
        return begun
    benches = _benches(records_of(begun.recording, by_period=True))
    first = suppose(benches, begun.first.hypothesis, begun.first.numbers)
    return replace(begun, first=reshape(scan_friction(first)))


def _benches(split: Split) -> tuple[Bench, Bench]:
    """Records fitted and kept out, of one damping of holds."""
    damping = hold_damping((*split.fitted, *split.kept))
    return Bench(stack_records(split.fitted, damping)), Bench(stack_records(split.kept, damping))


def _begin(recording: Recording, sizes: Sequence[int] | None, known: Known) -> Begun:
    split = records_of(recording)
    bench, beside = _benches(split)
    declared = None if sizes is None else tuple(sizes)
    try:
        with budget.use_share(TIME_TO_BEGIN, 0.0, 0.3):
            budget.tell("fitting the machine alone", 0.0)
            if declared is None:
                first = begin_open(bench, recording.axis_count, beside)
            else:
                first = begin(bench, Structure(declared), beside, known)
    except np.linalg.LinAlgError as error:
        raise NotIdentifiableError(
            f"{recording.source}: {error}; check signs, units and the number of masses"
        ) from None
    return Begun(recording, first, declared, split.warnings)


def found_so_far(now: Supposed, axes: Sequence[str]) -> list[budget.Found]:
    """The laws of a hypothesis and the friction that is sure, at their places, for whoever waits."""
    out = []
    for placed in now.hypothesis.laws:
        axis, element = axis_and_element(now.hypothesis.structure, placed.spot)
        out.append(budget.Found(placed.law.cause, axes[axis], None, element))
    for worth in first_order_worths(now):
        if worth.stays and isinstance(worth.key, tuple) and isinstance(worth.key[0], Part):
            out.append(budget.Found(worth.cause, axes[worth.key[1]], None, "mass 1"))
    return out


def _weighed(now: Supposed) -> tuple[tuple[Worth, ...], Supposed]:
    """What each cause is worth, and the fit with those that pay."""
    found = tuple(worths(now))
    return found, only(now, found)


def _by_first_order(now: Supposed) -> tuple[tuple[Worth, ...], Supposed]:
    """The same without a fit: worth to first order, and the fit with all that was found."""
    return tuple(first_order_worths(now)), now


def only(now: Supposed, found: Sequence[Worth]) -> Supposed:
    """The hypothesis with the causes that pay, fitted."""
    for addition in additions_of(now.hypothesis.structure):
        if any(w.key == addition and not w.stays for w in found):
            now = without(now, addition)
    gone = {w.key for w in found if not w.stays}
    # Friction that rises at slow speed rises above dry friction.
    gone -= {(Part.DRY, w.key[1]) for w in found if w.stays and _is_rise(w.key)}
    laws = tuple(p for p in now.hypothesis.laws if p.key not in gone)
    columns = {k for k in gone if isinstance(k, tuple) and isinstance(k[0], Part)}
    pairs = {k for k in now.hypothesis.structure.pairs if not any(w.key == k and w.stays for w in found)}
    absent = now.hypothesis.absent | columns | pairs
    channels = frozenset(c for c in now.hypothesis.channels if c not in gone)
    return now.refit(
        replace(now.hypothesis, laws=laws, absent=frozenset(absent), channels=channels), iterations=15
    )


def _is_rise(key: Hashable) -> TypeGuard[tuple[Part, int]]:
    return isinstance(key, tuple) and key[0] is Part.RISE


def without_causes(now: Supposed) -> Supposed:
    """The plant alone, fitted to the same records."""
    for addition in additions_of(now.hypothesis.structure):
        now = without(now, addition)
    names = {c.name for c in now.fit.problem.columns}
    on_time = {(Channel.DELAY, axis) for _, axis in now.hypothesis.channels}
    absent = frozenset(now.hypothesis.absent | names | on_time | set(now.hypothesis.structure.pairs))
    bare = replace(now.hypothesis, laws=(), absent=absent, channels=frozenset())
    return now.refit(bare, iterations=15)
