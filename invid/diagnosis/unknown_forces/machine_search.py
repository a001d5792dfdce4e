"""The search on one machine: records, the basin, causes one after another, what each is worth at the end.

After the first fit a whole answer exists at every instant: each later stage has its share of the time that is
left, and a stage that it ends leaves what was found so far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from invid.diagnosis.unknown_forces.backward import deletions_of
from invid.diagnosis.unknown_forces.cause_search import SearchEnd, search_causes
from invid.diagnosis.unknown_forces.left_over import PlaceForce, place_forces
from invid.diagnosis.unknown_forces.nameless import add_laws
from invid.diagnosis.unknown_forces.structures import additions_of, without
from invid.effects.supposed_laws import supposed_laws
from invid.identification.fewer_masses import with_masses_seen
from invid.identification.quantities import axis_and_element
from invid.identification.search_start import SearchStart
from invid.likelihood.unknown_forces.fitted_hypothesis import Channel, FittedHypothesis
from invid.likelihood.unknown_forces.worth import Worth, prune, without_loose_springs
from invid.numerics import budget
from invid.recording.model import Recording
from invid.wording.sentence import sentence

TIME_TO_PURSUE, TIME_TO_WEIGH = 0.6, 0.5
"""Shares of the time that is left for the causes, and for what each is worth (empirical: what is done of them
without a budget)."""


@dataclass(frozen=True, eq=False)
class ElasticSearch:
    """What a search found on one recording.

    ``named`` is the fit with the causes that have a name, ``end`` that with laws without one besides,
    ``bare`` the plant alone. ``forces`` are left at the places of ``end``, ``forces_named`` at those of
    ``named``.
    """

    recording: Recording
    pursued: SearchEnd
    end: FittedHypothesis
    worths: tuple[Worth, ...]
    bare: FittedHypothesis
    named: FittedHypothesis
    forces: tuple[PlaceForce, ...]
    forces_named: tuple[PlaceForce, ...]
    is_cut_short: bool = False


def search_elastic(begun: SearchStart) -> ElasticSearch:
    """The search over causes on the records for fitting, judged on those kept out."""
    recording = begun.recording

    def tell(now: FittedHypothesis, share: float) -> None:
        budget.tell_found(found_so_far(now, recording.axes))
        budget.tell("looking for causes", share)

    with budget.use_share(TIME_TO_PURSUE, 0.3, 0.75):
        laws = supposed_laws(linear=recording.linear)
        pursued = search_causes(begun.first, laws, tell=tell, growing=begun.declared is None)
    is_cut_short = budget.FURTHER_CAUSES in budget.left_out()
    with budget.use_share(TIME_TO_WEIGH, 0.75, 0.85):
        budget.tell("weighing each cause", 0.0)
        found, named = prune(without_loose_springs(with_masses_seen(pursued.end)), deletions_of)
    budget.tell("what is left", 0.85)
    named = named.with_motion()  # there was no time for any, where the first cause was cut
    bare = without_causes(named)
    nothing: tuple[PlaceForce, ...] = ()
    forces_named = budget.or_else(
        sentence("what is left at each place"), lambda: place_forces(named, bare), nothing
    )
    end, forces = named, forces_named
    with_law = budget.or_else(sentence("a law without a name"), lambda: add_laws(named, forces_named), None)
    if with_law is not None:
        found, end = prune(with_law, deletions_of)
        forces = budget.or_else(
            sentence("what is left at each place"), lambda: place_forces(end, bare), nothing
        )
    return ElasticSearch(recording, pursued, end, found, bare, named, forces, forces_named, is_cut_short)


def found_so_far(now: FittedHypothesis, axes: Sequence[str]) -> list[budget.Found]:
    """The laws of a hypothesis at their places, for whoever waits."""
    places = ((p.law.cause, axis_and_element(now.hypothesis.structure, p.spot)) for p in now.hypothesis.laws)
    return [budget.Found(cause, axes[axis], None, element) for cause, (axis, element) in places]


def without_causes(now: FittedHypothesis) -> FittedHypothesis:
    """The plant alone, fitted to the same records."""
    for addition in additions_of(now.hypothesis.structure):
        now = without(now, addition)
    names = {c.name for c in now.fit.problem.columns}
    on_time = {(Channel.DELAY, axis) for _, axis in now.hypothesis.channels}
    absent = frozenset(now.hypothesis.absent | names | on_time | set(now.hypothesis.structure.pairs))
    bare = replace(now.hypothesis, laws=(), absent=absent, channels=frozenset())
    return now.refit(bare)
