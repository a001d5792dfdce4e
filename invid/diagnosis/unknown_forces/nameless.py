"""A law without a name: what acts at a place, smooth over one quantity of its motion or two, tried in the
likelihood.

The law is a spline whose shapes are chosen by what the rows tell (Demmler and Reinsch), all else projected
out. It is never read from the smoothed force, which is shrunk. What a spring, a damper or a constant torque
may stand for is none of its parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.diagnosis.thresholds import COMPETES, EXPLAINED, FLOOR
from invid.diagnosis.unknown_forces.left_over import PlaceForce, place_of
from invid.diagnosis.unknown_forces.projected_rows import Rows
from invid.diagnosis.unknown_forces.scoring import score
from invid.effects.laws.empirical_law import KNOTS, EmpiricalLaw, is_known, is_like_law, knots_of, most_knots
from invid.effects.motion_effect import OF_RATE, PAIRS
from invid.effects.supposed.of_effect import SmoothLaw
from invid.identification.missing_torque import axis_missing
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis, Hypothesis
from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.likelihood.unknown_forces.motions import PlacedLaw
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.price import NUMBER, pays, price
from invid.likelihood.unknown_forces.shapes import curvature
from invid.likelihood.unknown_forces.worth import role_falls
from invid.numerics import budget
from invid.numerics.arrays import Bool, Float64
from invid.numerics.smooth_parts import smooth_parts

FIRST, FIRST_OF_TWO, ROUNDS = 6, 15, 3
"""Most shapes of a law that is fitted first, over one quantity and over two, and how often they are chosen
anew (empirical)."""
FITTED = 3
"""Laws of the scores that are fitted (empirical, for the time)."""
SIMPLER = 3 * NUMBER
"""Rise of −2 ln L at which a law stands for its place's friction as well: the odds of three numbers."""
AT_MASS, AT_SPRING = ("velocity", "position"), ("deflection", "deflection rate")


@dataclass(frozen=True, eq=False)
class Choice:
    """A law at a place with the fall that it promises, its price paid."""

    placed: PlacedLaw
    worth: float


def add_laws(now: FittedHypothesis, forces: Sequence[PlaceForce]) -> FittedHypothesis | None:
    """The fit with a law at one place of each axis on which something is sure to act, and for viscous
    friction that is none; ``None``: none."""
    start, structure = now, now.hypothesis.structure
    sure = {place_of(structure, f.spot)[0] for f in forces if f.is_sure}
    for axis in range(structure.motors):
        curved = _drag_for_damper(now, axis)
        if axis in sure and (curved is now or not _is_at_noise(curved, axis)):
            curved = _law_on(now, axis) or curved
        now = curved
    return None if now is start else now


def drag(now: FittedHypothesis, motor: int) -> PlacedLaw:
    """Resistance v·|v| of a motor, of which viscous friction is the mean at one amplitude."""
    spot = Spot(Where.MOTOR, motor)
    knots = knots_of([m.velocity for m in now.motions.flat(spot)]) or [-1.0, 1.0]
    square = np.array([[v * abs(v)] for v in knots])
    return PlacedLaw(SmoothLaw(EmpiricalLaw("velocity", knots, square)), spot)


def _drag_for_damper(now: FittedHypothesis, motor: int) -> FittedHypothesis:
    """The fit with a drag for a motor's viscous friction, where it is better by more than chance."""
    key, placed = (Part.VISCOUS, motor), drag(now, motor)
    names = [c.name for c in now.fit.problem.columns]
    is_curved = any(p.spot == placed.spot and isinstance(p.law, SmoothLaw) for p in now.hypothesis.laws)
    if is_curved or not now.fit.value.coefficients[names.index(key)]:
        return now
    if score(now, [placed])[0] < COMPETES:  # beside the damper it would do better still
        return now
    found = _with_law(now, replace(now.hypothesis, absent=now.hypothesis.absent | {key}), placed)
    return found if sum(role_falls(now, found)) > COMPETES else now


def _law_on(now: FittedHypothesis, axis: int) -> FittedHypothesis | None:
    """The fit with the law that takes most on an axis; ``None`` where none is sure or takes enough."""
    curves = [over for spot_kind in (AT_MASS, AT_SPRING) for over in spot_kind]
    best = _best(now, _choices(now, axis, [(over, "") for over in curves]))
    if best is not None and _is_at_noise(best, axis):
        return best
    wider = _best(now, _choices(now, axis, PAIRS))
    if wider is None or not _takes_nearly_all(now, wider, axis):
        return best if best is not None and _takes_nearly_all(now, best, axis) else None
    return wider if best is None or wider.total + SIMPLER < best.total else best


def _choices(now: FittedHypothesis, axis: int, quantities: Sequence[tuple[str, str]]) -> list[Choice]:
    """Laws over these quantities at every place of an axis, the best first."""
    structure, out = now.hypothesis.structure, []
    for over, across in quantities:
        for spot in now.fit.problem.spots.spots:
            at, element, other = place_of(structure, spot)
            is_of_chain = other is None and element.startswith(("mass", "spring"))
            if at != axis or not is_of_chain or (over in AT_SPRING) is not (spot.where is Where.SPRING):
                continue
            budget.check()
            instead = _instead(now, spot, over)
            for base in [now] if instead is None else [now.refit(instead, iterations=4), now]:
                chosen = _choose(Rows(base), (over, across), spot, FIRST_OF_TWO if across else FIRST)
                if chosen is not None:
                    out.append(replace(chosen, worth=chosen.worth - (base.total - now.total)))
                    break
    return sorted(out, key=lambda c: -c.worth)


def _instead(now: FittedHypothesis, spot: Spot, over: str) -> Hypothesis | None:
    """The hypothesis without what a law over this quantity at a place may stand for; ``None`` where there is
    no such cause."""
    was = now.hypothesis
    laws = tuple(
        p
        for p in was.laws
        if p.spot != spot or isinstance(p.law, SmoothLaw) or not is_like_law(p.law.effect, over)
    )
    absent = was.absent
    if over == "velocity" and spot.where is Where.MOTOR:
        absent = absent | {(part, spot.number) for part in (Part.DRY, Part.RISE, Part.VISCOUS)}
    return None if (laws, absent) == (was.laws, was.absent) else replace(was, laws=laws, absent=absent)


def _choose(rows: Rows, quantities: tuple[str, str], spot: Spot, most: int) -> Choice | None:
    """The law with the shapes that pay their price, ``most`` at most; ``None`` for none."""
    over, across = quantities
    motions = rows.now.motions.flat(spot)
    knots = []
    for q in filter(None, quantities):
        waves = [m.velocity if q in OF_RATE else m.position for m in motions]
        own = knots_of(waves, most_knots(q, two=bool(across)))
        if own is None:
            return None
        knots.append(own)
    first, second = knots[0], knots[1] if across else [0.0]
    law = EmpiricalLaw(over, first, np.eye(len(first) * len(second)), across, second)
    columns = rows.of_law(PlacedLaw(SmoothLaw(law), spot))
    if not np.isfinite(columns).all():
        return None

    def parts_without(straight: Float64) -> tuple[Float64, Float64]:
        rest = columns - (columns @ straight) @ straight.T
        return smooth_parts(rest, -rows.missing, rows.price, most, len(second))

    straight = law.straight()
    shapes, x = parts_without(straight)
    if spot.where is not Where.SPRING:  # a spring's straight lines are its stiffness, its damper and its load
        if not x.size:
            shapes, x = parts_without(straight[:, :0])
        shapes, x = parts_without(straight[:, _is_undone(columns @ straight, straight, shapes @ x)])
    if not x.size:
        return None
    placed = PlacedLaw(SmoothLaw(EmpiricalLaw(over, first, shapes, across, second)), spot)
    return Choice(placed, float(x @ x) - rows.price * x.size)


def _is_undone(felt: Float64, straight: Float64, law: Float64) -> Bool:
    """(s,) whether straight parts (k, s), ``felt`` (m, s) in rows beside all else, are known to no third of a
    ``law`` (k,)."""
    std = np.abs(straight).max(axis=0) / np.maximum(np.linalg.norm(felt, axis=0), 1e-300)
    out: Bool = 3.0 * std > np.abs(law).max(initial=0.0)
    return out


def _best(now: FittedHypothesis, choices: Sequence[Choice]) -> FittedHypothesis | None:
    """The fit with the best of the leading laws, its shapes at their best, where it pays the price of a cause
    and is known; else ``None``."""
    found = [_first_fit(now, c.placed) for c in choices[:FITTED]]
    for first, base in sorted(found, key=lambda f: f[0].total):
        best = _shaped(first, base)
        if pays(*role_falls(now, best), price()) and _is_law_known(best):
            return best
    return None


def _first_fit(now: FittedHypothesis, placed: PlacedLaw) -> tuple[FittedHypothesis, Hypothesis]:
    """The fit with a law, or with the law instead of what it may stand for where it does as well; and the
    hypothesis without the law."""
    law, beside = placed.law, _with_law(now, now.hypothesis, placed)
    instead = _instead(now, placed.spot, law.law.over if isinstance(law, SmoothLaw) else "")
    if instead is None:
        return beside, now.hypothesis
    alone = _with_law(now, instead, placed)
    return (alone, instead) if alone.total < beside.total + SIMPLER else (beside, now.hypothesis)


def _shaped(best: FittedHypothesis, base: Hypothesis) -> FittedHypothesis:
    """A fit with a law beside ``base``, its shapes chosen anew from where it ends while that is better."""
    placed = best.hypothesis.laws[-1]
    for _ in range(ROUNDS):
        budget.check()
        law = best.hypothesis.laws[-1].law
        if not isinstance(law, SmoothLaw):
            break
        bare = best.refit(base, iterations=0)
        again = _choose(Rows(bare), (law.law.over, law.law.across), placed.spot, KNOTS)
        if again is None:
            break
        more = _with_law(best, base, again.placed)
        if more.total > best.total - 2.0 * Rows(bare).price:
            break
        best = more
    return best


def _with_law(now: FittedHypothesis, base: Hypothesis, placed: PlacedLaw) -> FittedHypothesis:
    found = now.refit(replace(base, laws=(*base.laws, placed)))
    return found if placed.spot.where is Where.MOTOR else found.renewed()


def _is_at_noise(found: FittedHypothesis, axis: int) -> bool:
    left = axis_missing(found)
    return bool(left.missing[axis] <= FLOOR * left.floor[axis])


def _takes_nearly_all(now: FittedHypothesis, found: FittedHypothesis, axis: int) -> bool:
    """Whether a law brings its axis to the noise, or takes nine tenths of what is missing there on records
    kept out: what takes less may be a part of any law."""
    before, after = axis_missing(now), axis_missing(found)
    left = after.missing[axis] ** 2 - after.floor[axis] ** 2
    whole = before.missing[axis] ** 2 - before.floor[axis] ** 2
    return _is_at_noise(found, axis) or bool(left <= (1.0 - EXPLAINED) * whole)


def _is_law_known(found: FittedHypothesis) -> bool:
    """Whether the last law stands out of three deviations of it somewhere in the motion."""
    placed = found.hypothesis.laws[-1]
    value, covariance = coefficients_of(found, placed)
    waves = np.concatenate([placed.law.waves(m, ()) for m in found.motions.flat(placed.spot)])
    return is_known(waves, value, covariance)


def coefficients_of(found: FittedHypothesis, placed: PlacedLaw) -> tuple[Float64, Float64]:
    """(k,) sizes of a law's shapes and their (k, k) covariance."""
    known = curvature(found)
    names = [c.name for c in found.fit.problem.columns]
    at = [names.index((*placed.key, i)) for i in range(len(placed.law.low))]
    index = known.numbers + np.searchsorted(known.free, at)
    return found.fit.value.coefficients[at], known.covariance[np.ix_(index, index)]
