"""How sure each cause is: every other one that may explain the same forces is fitted in its place."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.diagnosis.outcome import share_among_rivals
from invid.diagnosis.thresholds import COMPETES, EXPLAINED
from invid.diagnosis.unknown_forces.cause_search import SearchEnd, is_sound
from invid.diagnosis.unknown_forces.left_over import PlaceForce
from invid.diagnosis.unknown_forces.nameless import drag
from invid.diagnosis.unknown_forces.projected_rows import Rows
from invid.diagnosis.unknown_forces.scoring import column_fall, score, spots_of
from invid.diagnosis.unknown_forces.structures import Base, Mode
from invid.effects.catalogue.asymmetric_friction import AsymmetricFriction
from invid.effects.laws.empirical_law import NAMELESS
from invid.effects.registry import BY_CAUSE
from invid.effects.supposed.of_effect import SmoothLaw
from invid.effects.supposed_laws import supposed_laws
from invid.identification.missing_torque import axis_missing
from invid.identification.quantities import axis_and_element
from invid.likelihood.unknown_forces.fitted_hypothesis import Channel, FittedHypothesis, Hypothesis
from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.likelihood.unknown_forces.motions import PlacedLaw
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.price import NUMBER, price
from invid.likelihood.unknown_forces.shapes import with_law
from invid.likelihood.unknown_forces.worth import FRICTION, Worth, role_falls
from invid.model.diagnosis_document import Alternative
from invid.numerics import budget
from invid.recording.model import Recording
from invid.wording.sentence import sentence

REACH = 0.7
"""Share of a cause's worth that a rival must promise by its score to be fitted in its place (empirical)."""
TRIED = 3
"""Most rivals of a cause that are fitted."""
WHAT = sentence("rivals of the causes")
"""What a spent budget leaves out, in the words of the warning."""


@dataclass(frozen=True, eq=False)
class Contest:
    """The rivals of one cause that records cannot tell from it, and its share of the likelihood of all."""

    share: float
    alternatives: tuple[Alternative, ...]


@dataclass(frozen=True, eq=False)
class _Rival:
    """A cause in the place of another: the fit with it, and by how much −2 ln L is higher."""

    cause: str
    spot: Spot
    found: FittedHypothesis
    worse: float

    @property
    def missing(self) -> float:
        """Missing torque of all axes [N·m]."""
        return float(np.sqrt((axis_missing(self.found).missing ** 2).mean()))


def contests(
    end: FittedHypothesis, worths: Sequence[Worth], pursued: SearchEnd, recording: Recording
) -> dict[Hashable, Contest]:
    """By the key of each cause that stays: how sure it is, and its alternatives."""
    out: dict[Hashable, Contest] = {}
    stays = [w for w in worths if w.stays]
    for worth in stays:
        rivals = [] if worth.cause == NAMELESS else _rivals_of(end, worth, pursued, linear=recording.linear)
        rivals += _one_with_dry_friction(end, worth, stays)
        close = [r for r in rivals if r.worse < COMPETES]
        # The cause against none, which is as likely where it just pays, and against each rival.
        share = share_among_rivals([worth.rise - worth.price, *(r.worse for r in rivals)])
        said = tuple(
            Alternative(r.cause, recording.axes[axis], element, r.missing)
            for r in close
            for axis, element in (axis_and_element(end.hypothesis.structure, r.spot),)
        )
        if isinstance(worth.key, Mode) and end.hypothesis.structure.motors == 1:
            # Seen from one motor a body under its load makes the same poles and zeros.
            missing = float(axis_missing(end).missing[0])
            said += (Alternative(Base.cause, recording.axes[0], None, missing),)
        out[worth.key] = Contest(share, said)
    return out


def _one_with_dry_friction(end: FittedHypothesis, worth: Worth, stays: Sequence[Worth]) -> list[_Rival]:
    """Friction by direction in the place of a constant torque beside dry friction: the very same force."""
    if not (isinstance(worth.key, tuple) and worth.key[0] is Part.OFFSET):
        return []
    motor = worth.key[1]
    if all(w.key != (Part.DRY, motor) for w in stays):
        return []
    return [_rival((AsymmetricFriction.cause, Spot(Where.MOTOR, motor)), end, end)]


def _rivals_of(end: FittedHypothesis, worth: Worth, pursued: SearchEnd, *, linear: bool) -> list[_Rival]:
    """Every rival that was fitted in a cause's place."""
    without = _hypothesis_without(end.hypothesis, worth.key)
    if without is None or budget.is_left_out(WHAT):
        return _of_structure(worth, pursued)
    less = end.refit(without)
    own = next((p for p in end.hypothesis.laws if p.key == worth.key), None)
    each = Rows(end).price
    rivals: list[tuple[str, Spot, float, FittedHypothesis]] = []
    for placed in _within_reach(less, own or worth.key, _candidates(end, worth, pursued, linear=linear)):
        if budget.is_left_out(WHAT):
            break
        replaced = 1 if own is None else _numbers(own)
        replaced = max(replaced, len(_taken_over(end.hypothesis, placed)))
        more = each * (_numbers(placed) - replaced)
        # One of many laws that have no name: it has to do as well as the cause that has one.
        more += COMPETES if isinstance(placed.law, SmoothLaw) else 0.0
        found = with_law(less, placed)
        rivals.append((placed.law.cause, placed.spot, more, found))
    if isinstance(worth.key, tuple) and isinstance(worth.key[0], Channel):
        channel, axis = worth.key
        other = next(c for c in Channel if c is not channel)
        swapped = replace(less.hypothesis, channels=less.hypothesis.channels | {(other, axis)})
        swapped = replace(swapped, absent=swapped.absent - {(Channel.DELAY, axis)})
        found = less.refit(swapped)
        rivals.append((other.value, Spot(Where.MOTOR, axis), 0.0, found))
    return [_rival((cause, spot), found, end, more) for cause, spot, more, found in rivals if is_sound(found)]


def _rival(
    named: tuple[str, Spot], found: FittedHypothesis, than: FittedHypothesis, more: float = 0.0
) -> _Rival:
    """Worse by the rise on all records, with Schwarz's price of its further numbers; by what it is on the
    records fitted where that is decided there."""
    worse = found.total - than.total + more
    if worse < price():
        worse = sum(role_falls(found, than)) + more
    return _Rival(*named, found, worse)


def _numbers(placed: PlacedLaw) -> int:
    return len(placed.law.low) + len(placed.shape)


def _taken_over(was: Hypothesis, placed: PlacedLaw) -> frozenset[Hashable]:
    """Parts of friction, each of one number, whose place a law takes."""
    return was.plus(placed).covered - was.covered - was.absent


def _of_structure(worth: Worth, pursued: SearchEnd) -> list[_Rival]:
    """Rivals of a part of the structure, fitted beside all else that was found."""
    return [
        _rival((r.cause, r.spot), r.found, taken.found, NUMBER * (r.numbers - taken.numbers))
        for taken, r in pursued.rivals
        if taken.addition == worth.key and (r.cause, r.spot) != (taken.cause, taken.spot)
    ]


def _hypothesis_without(was: Hypothesis, key: Hashable) -> Hypothesis | None:
    """The hypothesis without a law, a channel or a part of friction; ``None`` for a part of the structure."""
    laws = tuple(p for p in was.laws if p.key != key)
    if len(laws) < len(was.laws):
        return replace(was, laws=laws)
    if key in was.channels and isinstance(key, tuple):
        late = was.absent | {(Channel.DELAY, key[1])}
        return replace(was, channels=frozenset(c for c in was.channels if c != key), absent=late)
    if isinstance(key, tuple) and isinstance(key[0], Part):
        return replace(was, absent=was.absent | {key})
    return None


def _candidates(end: FittedHypothesis, worth: Worth, pursued: SearchEnd, *, linear: bool) -> list[PlacedLaw]:
    """Laws that may stand for a cause: its look-alikes at its place, the same elsewhere, what came close in
    the search."""
    spot = _spot_of(worth.key)
    if spot is None:
        return []
    taken = {(p.law.cause, p.spot) for p in end.hypothesis.laws}
    laws = supposed_laws(linear=linear)
    alike = {*BY_CAUSE[worth.cause].looks_like}
    alike |= {law.cause for law in laws if worth.cause in law.effect.looks_like}
    friction = {(cause, part) for part, cause in FRICTION}
    out = [
        PlacedLaw(law, at, shape)
        for law in laws
        if law.cause in alike and not (isinstance(worth.key, tuple) and (law.cause, worth.key[0]) in friction)
        for at in spots_of(law, end.hypothesis.structure)
        # What is read or commanded wrongly by one axis of two may be the other's.
        if (at == spot or law.reads or law.scales) and (law.cause, at) not in taken
        for shape in law.shapes(end.motions.flat(at))
    ]
    out += [
        replace(own, spot=other)
        for own in end.hypothesis.laws
        if own.key == worth.key
        for other in spots_of(own.law, end.hypothesis.structure)
        if (own.law.cause, other) not in taken
    ]
    if isinstance(worth.key, tuple) and worth.key[0] is Part.VISCOUS:
        out.append(drag(end, worth.key[1]))
    return out + [
        rival.placed
        for won, rival in pursued.rivals
        if won.placed is not None and won.placed.key == worth.key and rival.placed is not None
        if (rival.placed.law.cause, rival.placed.spot) not in taken
    ]


def _spot_of(key: Hashable) -> Spot | None:
    if not isinstance(key, tuple):
        return None
    if isinstance(key[1], Spot):
        return key[1]
    return Spot(Where.MOTOR, int(key[1])) if isinstance(key[0], Part) else None


def _within_reach(
    less: FittedHypothesis, own: PlacedLaw | Hashable, looked: Sequence[PlacedLaw]
) -> list[PlacedLaw]:
    """The best shape of each law whose score, where a cause was taken out, comes near its ``own`` (a law, or
    the name of its column), the best first."""
    if not looked:
        return []
    best: dict[Hashable, tuple[float, PlacedLaw]] = {}
    for fall, placed in zip(score(less, looked), looked, strict=True):
        if fall > best.get(placed.key, (0.0, placed))[0]:
            best[placed.key] = float(fall), placed
    ordered = sorted(best.values(), key=lambda b: -b[0])
    least = REACH * (float(score(less, [own])[0]) if isinstance(own, PlacedLaw) else column_fall(less, own))
    return [placed for fall, placed in ordered[:TRIED] if fall > least]


def is_part_of_more(key: Hashable, forces: Sequence[PlaceForce]) -> bool:
    """Whether something without a name is sure to act at a cause's very place, and is more than a tenth (of
    the power) of what acts there without any cause: the cause may be a part of it."""
    spot, least = _spot_of(key), np.sqrt(1.0 - EXPLAINED)
    return any(f.is_sure and f.spot == spot and f.rms > least * f.before for f in forces)
