"""The terms that a large motion's torque is made of: M(q) q̈ + friction + laws = τ.

Friction of motors and the catalogue's supposed laws are those of the search in elastic machines, an axis is
one mass.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from invid.effects.catalogue.asymmetric_friction import AsymmetricAtMotor, LowSpeed
from invid.effects.catalogue.cogging import CoggingLaw
from invid.effects.catalogue.cubic_stiffness import CubicStiffnessLaw
from invid.effects.catalogue.gravity import GravityLaw
from invid.effects.catalogue.presliding_friction import HeldAtMotor, PreslidingAtMotor
from invid.effects.large_motion.load_dependent_friction import LoadFrictionLaw
from invid.effects.large_motion.quadratic_stiffness import QuadraticStiffnessLaw
from invid.effects.laws.slider import SliderLaw, slide
from invid.effects.supposed.law import Shape, SpotMotion, SupposedLaw
from invid.effects.supposed.of_effect import EffectLaw
from invid.effects.supposed_laws import supposed_laws
from invid.likelihood.unknown_forces.motor_laws import FrictionShape, Part, force
from invid.likelihood.unknown_forces.worth import FRICTION
from invid.model.plant import Structure
from invid.numerics.arrays import Float64
from invid.signals.motion_record import Motion

LEAST_TRAVEL = 0.2
"""Travel [rad] below which sine and cosine of the angle are an offset and a spring (physical: to 2 %)."""
RIPPLES = 4.0
"""Periods on the travel below which a ripple is no other than any smooth law of position (physical)."""
SPEEDS, LOW_SPEED = 12, 0.25
"""Speeds at which friction may bend that are looked at, and the highest over the largest speed: what bends
over the whole range is no law of low speed (empirical)."""


class Base(Enum):
    """What every rigid machine has, and the delay of a drive."""

    INERTIA = "inertia"
    TIME_OFFSET = "time_offset"
    COUPLING = "coupling"
    CONFIGURATION = "configuration"
    CARRIED = "carried_weight"
    GROUND_SPRING = "ground_spring"
    DELAY = "torque_delay"


GRAVITY, COGGING, BY_DIRECTION = GravityLaw(), CoggingLaw(), AsymmetricAtMotor()
RISE, BEND, ANY_BEND = LowSpeed(0.0), LowSpeed(-np.inf, -np.inf), LowSpeed(-np.inf)
HELD, PRESLIDING = HeldAtMotor(), PreslidingAtMotor()
SPRINGS = (CubicStiffnessLaw(), QuadraticStiffnessLaw())
LOADS = (LoadFrictionLaw(whole=False), LoadFrictionLaw(whole=True))
CAUSES = dict(FRICTION)
ONE_MASS = Structure((1,))


@dataclass(frozen=True)
class Term:
    """One law at its place.

    Attributes
    ----------
    other
        The second axis of a coupling; of gravity the axis that carries this one.
    others
        Of carried weights the axes that turn what this one carries.
    load
        Terms with their coefficients that make up the load of friction that depends on it.
    """

    law: Base | Part | SupposedLaw
    axis: int
    shape: Shape = ()
    other: int | None = None
    others: tuple[int, ...] = ()
    load: tuple[tuple[Term, tuple[float, ...]], ...] = ()

    @property
    def cause(self) -> str:
        """The contract's name, or that of a part of the base."""
        if isinstance(self.law, Part):
            return CAUSES[self.law]
        return self.law.value if isinstance(self.law, Base) else self.law.cause

    @property
    def low(self) -> tuple[float, ...]:
        """(k,) least coefficients."""
        if isinstance(self.law, SupposedLaw):
            return self.law.low
        if self.law in (Base.CONFIGURATION, Base.CARRIED):
            return (-np.inf,) * (2 if self.law is Base.CONFIGURATION else 4 * len(self.others))
        return (0.0 if self.law in (Base.INERTIA, Part.DRY, Part.VISCOUS) else -np.inf,)

    @property
    def is_base(self) -> bool:
        """Whether it is no cause."""
        return isinstance(self.law, Base) and self.law is not Base.DELAY

    @property
    def axes(self) -> list[int]:
        """The axes whose torque it is part of."""
        return [self.axis] if self.other is None else [self.axis, self.other]

    @property
    def label(self) -> tuple[object, int, int | None]:
        """Identity without the shape."""
        return (self.law, self.axis, self.other)

    @property
    def numbers(self) -> int:
        """Coefficients and shapes."""
        return len(self.low) + len(self.shape)


def columns(term: Term, motion: Motion) -> Float64:
    """(n, M, k) torque on every axis for each coefficient at one."""
    n, axes = motion.position.shape
    i, j = term.axis, -1 if term.other is None else term.other
    out = np.zeros((n, axes, len(term.low)))
    match term.law:
        case Base.INERTIA:
            out[:, i, 0] = motion.acceleration[:, i]
        case Base.COUPLING:
            out[:, i, 0], out[:, j, 0] = motion.acceleration[:, j], motion.acceleration[:, i]
        case Base.CONFIGURATION:
            _fill_configuration(out, motion, i, j)
        case Base.CARRIED:
            turned = [f(motion.position) for f in (np.sin, np.cos)]
            out[:, i] = np.stack(
                [a[:, i] * b[:, k] for k in term.others for a in turned for b in turned], axis=1
            )
        case Base.GROUND_SPRING:
            out[:, i, 0] = motion.position[:, i]
        case Base():
            out[:, i, 0] = motion.torque_rate[:, i]
        case Part():
            width = FrictionShape(max(0.5 * float(motion.rest[i]), 1e-300), 1.0)
            out[:, i, 0] = force(term.law, motion.velocity[:, i], width)
        case SliderLaw():
            # Its place is the reading's: what a filter takes away at a stop looks like a way back.
            most = float(np.exp(term.shape[0])) if term.shape else float(motion.blur[i])
            out[:, i, 0] = slide(motion.reading[:, i], most, periodic=False) / most
        case law:
            out[:, term.axes] = law.waves(spot_motion(term, motion), term.shape)[:, None]
    return out


def spot_motion(term: Term, motion: Motion) -> SpotMotion:
    """The motion that a law uses: of its axis, or of an axis that another carries."""
    position = motion.position[:, term.axes].sum(axis=1)
    time = np.arange(position.size, dtype=np.float64) * float(motion.step)
    load = load_on(term, motion) if term.load else motion.torque[:, term.axis]
    return SpotMotion(position, motion.velocity[:, term.axis], position, time, load)


def load_on(term: Term, motion: Motion) -> Float64:
    """(n,) torque that the terms of ``term.load`` ask of its axis."""
    return torque_of(term.load, motion)[:, term.axis]


def torque_of(parts: Iterable[tuple[Term, Sequence[float] | Float64]], motion: Motion) -> Float64:
    """(n, M) torque that terms with their coefficients ask of a motion."""
    out: Float64 = np.zeros_like(motion.position)
    for term, value in parts:
        out = out + columns(term, motion) @ np.asarray(value)
    return out


def _fill_configuration(out: Float64, motion: Motion, i: int, j: int) -> None:
    """Two links in series, joint j carried by joint i: b = m₂ l₁ r₂ (inertia that varies with q_j)."""
    cos, sin = np.cos(motion.position[:, j]), np.sin(motion.position[:, j])
    vi, vj = motion.velocity[:, i], motion.velocity[:, j]
    ai, aj = motion.acceleration[:, i], motion.acceleration[:, j]
    # cosine and sine components of b, for a joint zero that is not the stretched arm
    for k, (c, s) in enumerate(((cos, sin), (-sin, cos))):
        out[:, i, k] = 2 * c * ai + c * aj - s * (2 * vi * vj + vj**2)
        out[:, j, k] = c * ai + s * vi**2


@dataclass(frozen=True)
class Extent:
    """Range and speed of each axis' motion, which decide which terms are meaningful.

    ``travel``, ``speed`` (M,): peak-to-peak position and largest speed; ``slow`` (M,): slowest 2 % of the
    speeds while moving, at least twice the blur of the direction.
    """

    travel: Float64
    speed: Float64
    slow: Float64
    both_ways: tuple[bool, ...]
    rotary: bool
    steady: bool

    def falls(self, axis: int, springs: set[int]) -> bool:
        """Whether a weight on an axis would show: beside a spring to ground, a sine over less than half a
        turn is a spring that is not linear."""
        least = np.pi if axis in springs else LEAST_TRAVEL
        return self.rotary and not self.steady and bool(self.travel[axis] > least)


def extent(motions: Sequence[Motion], rotary: bool) -> Extent:
    """Extent of all motions."""
    q, v = (np.concatenate(x) for x in zip(*((m.position, m.velocity) for m in motions), strict=True))
    rest, fast = np.max([m.rest for m in motions], axis=0), np.abs(v).max(axis=0)
    moving = [np.abs(s)[np.abs(s) > r] for s, r in zip(v.T, rest, strict=True)]
    slow = np.array([float(np.quantile(m, 0.02)) if m.size else 0.0 for m in moving])
    ways = [(s > r).mean() > 0.05 < (s < -r).mean() for s, r in zip(v.T, rest, strict=True)]
    return Extent(
        travel=np.ptp(q, axis=0),
        speed=fast,
        slow=np.maximum(np.maximum(slow, 1e-3 * fast), 2.0 * rest),
        both_ways=tuple(bool(w) for w in ways),
        rotary=rotary,
        steady=all(m.steady for m in motions),
    )


def base_terms(reach: Extent, springs: set[int]) -> list[Term]:
    """Rigid inertia of every axis, its couplings, springs to ground, and the sampling instant of its torque.

    The torque that acts may lag the record by part of a sample (it is held over the sample, and read at
    some instant of it): τ(t − δ) ≈ τ − δ τ̇. That much is convention, not a fault.
    """
    if reach.steady:
        return []
    axes = range(reach.travel.size)
    terms = [Term(law, i) for law in (Base.INERTIA, Base.TIME_OFFSET) for i in axes]
    terms += [Term(Base.COUPLING, i, other=j) for i in axes for j in axes if i < j]
    return terms + [Term(Base.GROUND_SPRING, i) for i in sorted(springs)]


def first_terms(reach: Extent, springs: set[int]) -> list[Term]:
    """What every axis is expected to have: dry and viscous friction, and its weight or a constant torque.

    Of two axes that turn the second hangs on the first.
    """
    terms = []
    for i in range(reach.travel.size):
        hangs = reach.travel.size == 2 and i == 1 and reach.falls(0, set())
        weight = Term(GRAVITY, i, other=0 if hangs else None)
        terms += [Term(Part.DRY, i), Term(Part.VISCOUS, i)]
        if reach.falls(i, springs):
            terms.append(weight)
        elif reach.both_ways[i]:  # one way a constant torque is dry friction, which is expected
            terms.append(Term(Part.OFFSET, i))
    return terms


def candidate_terms(reach: Extent, springs: set[int], motions: Sequence[Motion]) -> list[Term]:
    """Every law that the record could show, at every shape to look at."""
    found: list[Term] = []
    for i in range(reach.travel.size):
        slow = float(reach.slow[i])
        speeds = np.geomspace(slow, max(LOW_SPEED * reach.speed[i], 1.01 * slow), SPEEDS if slow > 0 else 0)
        bends = [(float(np.log(s)), exponent) for exponent in (1.0, 2.0) for s in speeds]
        found += [Term(part, i) for part in (Part.DRY, Part.VISCOUS, Part.OFFSET)[: 2 + reach.both_ways[i]]]
        found += [Term(RISE, i, shape) for shape in bends]
        if reach.both_ways[i]:
            found += [Term(BEND, i, shape) for shape in bends] + [Term(BY_DIRECTION, i)]
        if i in springs:
            found += [Term(law, i) for law in SPRINGS]
        if reach.falls(i, springs):
            found += [Term(GRAVITY, i), *_ripples(i, reach, motions)]
        spots = [spot_motion(Term(Base.INERTIA, i), m) for m in motions]
        laws = [law for law in supposed_laws(linear=not reach.rotary) if isinstance(law, EffectLaw)]
        laws = [law for law in laws if any(p.kind == "mass" for p in law.places(ONE_MASS))]
        found += [Term(law, i, shape) for law in laws for shape in law.shapes(spots)]
    if reach.travel.size > 2:
        # Without the arm's geometry: a weight's torque is linear in sine and cosine of each joint between.
        falling = {i for i in range(reach.travel.size) if reach.falls(i, springs)}
        found += [Term(Base.CARRIED, i, others=(*falling - {i},)) for i in falling if falling - {i}]
    if reach.travel.size == 2 and reach.falls(0, set()) and reach.falls(1, set()):
        found += [Term(GRAVITY, 1, other=0), Term(Base.CONFIGURATION, 0, other=1)]
    return found


def _ripples(axis: int, reach: Extent, motions: Sequence[Motion]) -> list[Term]:
    """Cogging that comes often enough on the travel and passes the filter of the rows half of the time."""
    spots = [spot_motion(Term(Base.INERTIA, axis), m) for m in motions]
    speed = float(np.median(np.abs(np.concatenate([s.velocity for s in spots]))))
    most = 2 * np.pi * float(motions[0].band.rows_hz[axis]) / max(speed, 1e-300)
    least = 2 * np.pi * RIPPLES / float(reach.travel[axis])
    return [Term(COGGING, axis, s) for s in COGGING.shapes(spots) if least < np.exp(s[0]) < most]


def fits_beside(term: Term, there: Term) -> bool:
    """Whether ``there`` may stand beside ``term``, or goes where that comes.

    A weight holds its joint with a constant of its own; friction by direction holds what bends alike both
    ways; of the weights on one joint, its own link's and that of all that hangs on it, one acts.
    """
    if term.axis != there.axis or term is there:
        return True
    if term.law in (GRAVITY, Part.OFFSET):
        return there.law not in (GRAVITY, Part.OFFSET)
    if isinstance(term.law, LoadFrictionLaw):
        return not isinstance(there.law, LoadFrictionLaw)
    is_bend_of_bend = {term.law, there.law} == {RISE, BEND}
    return not is_bend_of_bend and (term.label != there.label or term.law is COGGING)
