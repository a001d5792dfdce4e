"""The terms a large motion's torque is made of: rigid inertia, gravity, friction, springs to ground.

Each term gives columns on the fine grid, (n, M, k): the torque per unit of each coefficient on every
axis. Signs: friction opposes the motion and is positive, M(q) q̈ + … + friction = τ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.effects.effect import PlaceMotion
from invid.effects.laws.empirical_law import EmpiricalLaw
from invid.effects.motion_effect import MotionEffect
from invid.effects.registry import effect_of, further_effects
from invid.model.parameters import ChainStructure
from invid.numerics.arrays import Float64
from invid.signals.motion_record import Motion

ASYMMETRIC = ("coulomb_positive", "coulomb_negative", "viscous_positive", "viscous_negative")
"""Coefficients of friction that differs by direction."""


@dataclass(frozen=True)
class Regressor:
    """One cause at its place.

    Attributes
    ----------
    names
        Coefficients, in the order of the columns.
    positive
        Coefficients that physics wants ≥ 0.
    held
        Those of them that are held at 0, where the data alone would have them below.
    shape
        The nonlinear parameter, found by search over ``grid``; ``None`` where the term is linear.
    replaces
        Causes on the same axis that this term contains.
    needs
        Causes on the same axis of which one must be there before this one is tried.
    excludes
        Causes on the same axis beside which this one is not tried.
    load
        Terms with their coefficients that make up the load of friction that depends on it.
    law
        The law itself, where the catalogue has none of that cause's shape.
    """

    cause: str
    axis: int
    names: tuple[str, ...]
    positive: tuple[str, ...] = ()
    shape: float | None = None
    exponent: int = 0
    replaces: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    excludes: tuple[str, ...] = ()
    other: int | None = None
    base: bool = False
    tag: str = ""
    load: tuple[tuple[Regressor, tuple[float, ...]], ...] = ()
    held: tuple[str, ...] = ()
    law: EmpiricalLaw | None = None

    @property
    def label(self) -> tuple[str, int, int | None, str]:
        """Identity of a term without its shape parameter."""
        return (self.cause, self.axis, self.other, self.tag)


def columns(term: Regressor, motion: Motion) -> Float64:
    """(n, M, k) torque per unit coefficient; of a cause as its effect says (``Effect.regressors``)."""
    n, axes = motion.position.shape
    i = term.axis
    out = np.zeros((n, axes, len(term.names)))
    match term.cause:
        case "inertia":
            out[:, i, 0] = motion.acceleration[:, i]
        case "coupling":
            j = _other_axis(term)
            out[:, i, 0] = motion.acceleration[:, j]
            out[:, j, 0] = motion.acceleration[:, i]
        case "configuration":
            _fill_configuration(out, motion, i, _other_axis(term))
        case "ground_spring":
            out[:, i, 0] = motion.position[:, i]
        case "time_offset":
            out[:, i, 0] = motion.torque_rate[:, i]
        case _:
            effect = term.law or effect_of(term.cause)
            if effect is None:
                raise ValueError(f"no columns for {term.cause!r}")
            own = effect.regressors(_place_motion(term, motion), _shape_of(term))
            for axis in (i,) if term.other is None else (i, term.other):
                out[:, axis] = own
    for name in term.held:
        out[:, :, term.names.index(name)] = 0.0
    return out


def _place_motion(term: Regressor, motion: Motion) -> PlaceMotion:
    """The motion that a law uses: of its axis, or of an axis that another carries."""
    i = term.axis
    position = motion.position[:, i]
    if term.other is not None:
        position = position + motion.position[:, term.other]
    return PlaceMotion(
        position,
        motion.velocity[:, i],
        np.arange(position.size, dtype=np.float64) * motion.step,
        rest=float(motion.rest[i]),
        load=load_on(term, motion) if term.load else None,
        torque_rate=motion.torque_rate[:, i],
    )


def _shape_of(term: Regressor) -> tuple[float, ...]:
    """The shape parameters of a term, in their units."""
    if term.shape is None:
        return ()
    return (term.shape, float(term.exponent)) if term.exponent else (term.shape,)


def load_on(term: Regressor, motion: Motion) -> Float64:
    """(n,) torque that the terms of ``term.load`` ask of its axis."""
    total = np.zeros(motion.position.shape[0])
    for part, value in term.load:
        total += columns(part, motion)[:, term.axis] @ np.array(value)
    return total


def _other_axis(term: Regressor) -> int:
    if term.other is None:
        raise ValueError(f"{term.cause}: needs a second axis")
    return term.other


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
    """Range and speed of each axis' motion, which decide which terms are meaningful."""

    travel: Float64
    """(M,) peak-to-peak position."""
    speed: Float64
    """(M,) largest speed."""
    slow: Float64
    """(M,) slowest 2 % of the speeds while moving."""
    rest: Float64
    """(M,) speed below which the direction is blurred."""
    both_ways: tuple[bool, ...]
    rotary: bool
    steady: bool


def extent(motions: list[Motion], rotary: bool) -> Extent:
    """Extent of all motions."""
    q = np.concatenate([m.position for m in motions])
    v = np.concatenate([m.velocity for m in motions])
    rest = np.max([m.rest for m in motions], axis=0)
    slow = []
    for axis in range(v.shape[1]):
        speeds = np.abs(v[:, axis])
        moving = speeds[speeds > rest[axis]]
        slow.append(float(np.quantile(moving, 0.02)) if moving.size else 0.0)
    ways = tuple(
        bool((v[:, i] > rest[i]).mean() > 0.05 < (v[:, i] < -rest[i]).mean()) for i in range(v.shape[1])
    )
    return Extent(
        travel=np.ptp(q, axis=0),
        speed=np.abs(v).max(axis=0),
        slow=np.array(slow),
        rest=rest,
        both_ways=ways,
        rotary=rotary,
        steady=all(m.steady for m in motions),
    )


def base_terms(axes: int, steady: bool) -> list[Regressor]:
    """Rigid inertia of every axis, its constant couplings, and the sampling instant of its torque.

    The torque that acts may lag the record by part of a sample (it is held over the sample, and read at
    some instant of it): τ(t − δ) ≈ τ − δ τ̇. That much is convention, not a fault.
    """
    if steady:
        return []
    terms = [Regressor("inertia", i, ("mass",), ("mass",), base=True) for i in range(axes)]
    terms += [Regressor("time_offset", i, ("delay",), base=True) for i in range(axes)]
    terms += [
        Regressor("coupling", i, ("coupling",), base=True, other=j)
        for i in range(axes)
        for j in range(i + 1, axes)
    ]
    return terms


def candidate_terms(axes: int, reach: Extent, springs: set[int]) -> list[Regressor]:
    """Every cause that the record could show."""
    found: list[Regressor] = []
    for i in range(axes):
        found.append(Regressor("viscous_friction", i, ("coefficient",), ("coefficient",)))
        found.append(Regressor("coulomb_friction", i, ("torque",), ("torque",)))
        found.append(Regressor("torque_offset", i, ("torque",)))
        # Nearer to standstill than twice the blur of the direction nobody sees how friction bends.
        slowest = max(reach.slow[i], 1e-3 * reach.speed[i], 2.0 * reach.rest[i])
        fastest = max(0.5 * reach.speed[i], 1.01 * slowest)
        speeds = [float(s) for s in np.geomspace(slowest, fastest, 12)] if slowest > 0 else []
        for exponent in (1, 2):
            for speed in speeds:
                found.append(
                    Regressor(
                        "stribeck_friction",
                        i,
                        ("coulomb", "excess"),
                        ("coulomb", "excess"),
                        shape=speed,
                        exponent=exponent,
                        replaces=("coulomb_friction",),
                        needs=("coulomb_friction",),
                    )
                )
        if reach.both_ways[i]:
            covered = ("coulomb_friction", "viscous_friction", "torque_offset", "stribeck_friction")
            dry = ("coulomb_friction", "stribeck_friction")
            found.append(
                Regressor("asymmetric_friction", i, ASYMMETRIC, ASYMMETRIC, replaces=covered, needs=dry)
            )
            for exponent in (1, 2):
                for speed in speeds:
                    found.append(
                        Regressor(
                            "asymmetric_friction",
                            i,
                            (*ASYMMETRIC, "low_speed_positive", "low_speed_negative"),
                            ASYMMETRIC,
                            shape=speed,
                            exponent=exponent,
                            replaces=(*covered, "asymmetric_friction"),
                            needs=(*dry, "asymmetric_friction"),
                            tag="low speed",
                        )
                    )
        # Below a fifth of a radian a sine and a cosine of the angle are an offset and a spring.
        # Beside a spring to ground, a sine over less than half a turn is a spring that is not linear.
        amplitude = reach.travel[i] > (np.pi if i in springs else 0.2)
        if reach.rotary and amplitude and not reach.steady:
            # Over less than half a turn a weight and the constant within friction by direction may cancel.
            besides = ("asymmetric_friction",) if reach.travel[i] < np.pi else ()
            found.append(
                Regressor("gravity", i, ("sine", "cosine"), replaces=("torque_offset",), excludes=besides)
            )
        if i in springs:
            found.append(Regressor("quadratic_stiffness", i, ("coefficient",)))
            found.append(Regressor("cubic_stiffness", i, ("coefficient",)))
        found += _further_terms(i, reach)
    if axes == 2 and reach.rotary and not reach.steady and reach.travel.min() > 0.2:
        found.append(
            Regressor(
                "gravity", 1, ("sine", "cosine"), other=0, replaces=("torque_offset",), tag="second link"
            )
        )
        found.append(Regressor("configuration", 0, ("cosine", "sine"), other=1, base=True))
    return found


def _further_terms(axis: int, reach: Extent) -> list[Regressor]:
    """Effects beside the catalogue's on one axis: laws of motion of one mass, with one shape at most."""
    found = []
    place = ChainStructure((1,), ("axis",), viscous=False, grounded=())
    for effect in further_effects():
        sits = any(p.kind == "mass" for p in effect.places(place))
        if not isinstance(effect, MotionEffect) or not sits or len(effect.shapes) > 1:
            continue
        if effect.rotary and not reach.rotary:
            continue
        names = effect.coefficients
        positive = tuple(n for n, low in zip(names, effect.lower, strict=True) if low >= 0.0)
        # Of a sine of this travel and speed the rms.
        sizes = float(reach.travel[axis]) / 2.8, float(reach.speed[axis]) / 1.4
        for shape in effect.starts(*(max(s, 1e-300) for s in sizes)):
            found.append(Regressor(effect.cause, axis, names, positive, shape=shape[0] if shape else None))
    return found
