"""Effects at their places, and their joint contribution to the missing torque."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from invid.effects.effect import Effect, ForceEffect, ImpedanceEffect
from invid.effects.laws.sign import DryLaw
from invid.effects.motion import Equivalent, View, along
from invid.likelihood.inner_motion import Forces, solve_inner_motion
from invid.model.place import Pattern, Place
from invid.numerics.anderson import Secants
from invid.numerics.arrays import Complex128, Float64

PASSES = 12
"""Most iterations of inner motion and forces; weak effects agree after two or three."""


@dataclass(frozen=True)
class PlacedEffect:
    """An effect at a place."""

    effect: Effect
    place: Place

    @property
    def size(self) -> int:
        """Length of its parameter vector."""
        return len(self.effect.coefficients) + len(self.effect.shapes)

    @property
    def inner(self) -> bool:
        """Whether it depends on inner motion, which forces change."""
        return self.place.kind in ("spring", "pair", "base") or (
            self.place.kind == "mass" and self.place.number > 1
        )

    def depends_on_inner_motion(self, view: View) -> bool:
        """Whether it depends on inner motion in this record; friction does while its motor stands."""
        return self.inner or self.effect.stands(view, self.place)


@dataclass(frozen=True, eq=False)
class Candidate:
    """Effects with their parameter vectors."""

    terms: tuple[PlacedEffect, ...] = ()
    x: tuple[Float64, ...] = ()

    def only(self, numbers: Iterable[int]) -> Candidate:
        """The effects of these numbers, in this order."""
        chosen = list(numbers)
        return Candidate(tuple(self.terms[k] for k in chosen), tuple(self.x[k] for k in chosen))

    def without(self, number: int) -> Candidate:
        """All effects but one."""
        return self.only(k for k in range(len(self.terms)) if k != number)

    def plus(self, term: PlacedEffect, x: Float64) -> Candidate:
        """One effect more."""
        return Candidate((*self.terms, term), (*self.x, np.asarray(x, dtype=float)))


def contributions(
    view: View, candidate: Candidate, *, passes: int = PASSES, early: bool = True
) -> Complex128:
    """(F, M) of all effects, with inner motion in agreement with the forces.

    ``early``: stop at agreement; otherwise a fixed number of steps along known directions, for differences.
    """
    if not candidate.terms:
        return np.zeros_like(view.acting)
    forces = forces_of(view, candidate)
    if is_linear_in_motion(candidate):
        total, back = forces()
        view.set_inner_motion(back, view.closing_jumps(total))
        return total
    if not any(
        t.depends_on_inner_motion(view) for t in candidate.terms
    ):  # no force depends on the inner motion
        total, back = forces()
        view.set_inner_motion(back)
        return total
    if early:
        _keep_equivalents(view, candidate)
    total = solve_inner_motion(view, forces, passes, early=early)
    if not early or not any(t.effect.stands(view, t.place) for t in candidate.terms):
        return total
    view.clear_cache()  # resistance of a standing motor depends on the inner motion just found
    return solve_inner_motion(view, forces, passes)


def _keep_equivalents(view: View, candidate: Candidate) -> None:
    """Gives the view a spring and a damper for each law on inner motion, as near to it as at the present
    motion; keeps those that it has of the same laws."""
    laws = [
        (t, x)
        for t, x in zip(candidate.terms, candidate.x, strict=True)
        if t.inner and t.effect.along_pattern and not isinstance(t.effect, ImpedanceEffect)
    ]
    places = [t.place.pattern(view.structure) for t, _ in laws]
    kinds = [(t.effect.cause, t.place, *np.round(np.log2(np.abs(x) + 1e-300))) for t, x in laws]
    if [e.law for e in view.equivalents] == kinds:
        return
    view.secants = Secants()  # they are of other springs
    out = []
    for (term, x), pattern, kind in zip(laws, places, kinds, strict=True):
        contribution, _ = term.effect.contribution(view, term.place, x.tolist())
        reach = view.condensed_force(pattern).conj()
        reached = np.maximum(np.sum(np.abs(reach) ** 2, axis=1), 1e-300)
        force = np.einsum("fm,fm->f", reach, contribution) / reached
        moved = view.spectrum(pattern)
        stiffness, damping = (
            float(np.vdot(m[1:], force[1:]).real) / max(float(np.vdot(m[1:], m[1:]).real), 1e-300)
            for m in (moved, 1j * view.omega * moved)
        )
        out.append(Equivalent(pattern, kind, stiffness, damping))
    view.set_equivalents(tuple(out))


def is_linear_in_motion(candidate: Candidate) -> bool:
    """Whether all forces follow linearly from the motors' spectra, so that no iteration is needed."""
    return all(isinstance(t.effect, ImpedanceEffect) and t.effect.steady for t in candidate.terms)


_Impedances = Sequence[tuple[ImpedanceEffect, Place, Float64]]


def linear_effects(candidate: Candidate) -> _Impedances:
    """The effects that are linear in motion, with their places and parameters."""
    pairs = zip(candidate.terms, candidate.x, strict=True)
    return [(t.effect, t.place, x) for t, x in pairs if isinstance(t.effect, ImpedanceEffect)]


def force_patterns(view: View, candidate: Candidate) -> tuple[Pattern, ...]:
    """The patterns of coordinates along which effects may lack force."""
    return tuple(
        t.place.pattern(view.structure)
        for t in candidate.terms
        if t.place.kind != "axis" and t.effect.along_pattern
    )


def impedances(view: View, effects: _Impedances, back: Complex128) -> tuple[Complex128, Complex128]:
    """(F, M) contributions of effects linear in motion and (F, ΣN) the inner motion that they cause.

    Exact, each in the motion that the others and the laws (``back``, (F, ΣN)) cause: friction at a mass moves
    what a mode on it or a damper beside it feels.
    """
    own = coupled_impedances(view, effects)
    motion = view.unfiltered + back
    alone = [
        z * along(pattern, motion) + effect.within(view, place, x.tolist())
        for z, pattern, (effect, place, x) in zip(own.size, own.patterns, effects, strict=True)
    ]
    forces = (own.coupling @ np.stack(alone, axis=-1)[..., None])[..., 0]
    return (own.condensed_force @ forces[..., None])[..., 0], -(own.inner_receptance @ forces[..., None])[
        ..., 0
    ]


def coupled_impedances(view: View, effects: _Impedances) -> CoupledImpedances:
    """The effects at their places, each in the motion of the others; cached."""
    key = ("impedances", tuple((effect, place, tuple(x)) for effect, place, x in effects))
    return view.cached(key, lambda: CoupledImpedances.of(view, effects))


@dataclass(frozen=True, eq=False)
class CoupledImpedances:
    """Effects linear in motion at their places, as far as inner motion does not change them."""

    patterns: list[Pattern]
    condensed_force: Complex128
    """(F, M, k) motor torques of unit forces; ``inner_receptance`` (F, ΣN, k) their inner motion."""
    inner_receptance: Complex128
    size: list[Complex128]
    coupling: Complex128
    """(F, k, k) coupled forces over what each would be alone."""

    @classmethod
    def of(cls, view: View, effects: _Impedances) -> CoupledImpedances:
        patterns = [effect.pattern(view.structure, place, x.tolist()) for effect, place, x in effects]
        push, yields = view.cached(
            ("unit forces", tuple(patterns)),  # the same for all sizes of the effects
            lambda: tuple(
                np.stack([f(p) for p in patterns], axis=-1)
                for f in (view.condensed_force, view.inner_receptance)
            ),
        )
        size = [effect.impedance(view, place, x.tolist()) for effect, place, x in effects]
        rows = [z[:, None] * along(p, yields) for z, p in zip(size, patterns, strict=True)]
        return cls(
            patterns,
            push,
            yields,
            size,
            np.linalg.inv(np.eye(len(patterns)) + np.stack(rows, axis=1)).astype(np.complex128),
        )


Part = tuple[Complex128, Complex128 | None]
"""Contribution (F, M) of one law, and (F, ΣN) the inner motion that it causes."""


@dataclass(frozen=True)
class SizedMotorLaw:
    """What a law of motion, or a damper, takes at a motor beside its dry friction."""

    effect: ForceEffect | ImpedanceEffect
    place: Place
    x: tuple[float, ...]

    @property
    def axis(self) -> int:
        """Of the motor."""
        return self.place.axis

    def over_time(self, view: View) -> Float64:
        """(n,) resistance [N·m or N]."""
        if isinstance(self.effect, ImpedanceEffect):
            _, damper = self.effect.carries(view, self.x)
            return damper * view.velocity(self.place.pattern(view.structure))
        count = len(self.effect.coefficients)
        out: Float64 = self.effect.law(view, self.place, self.x[count:]) @ np.asarray(self.x[:count])
        return out


def laws_beside_dry_friction(candidate: Candidate) -> tuple[SizedMotorLaw, ...]:
    """The laws at motors that dry friction of the candidate feels; none where it has none."""
    if not any(isinstance(t.effect, DryLaw) for t in candidate.terms):
        return ()
    return tuple(
        SizedMotorLaw(t.effect, t.place, tuple(x))
        for t, x in zip(candidate.terms, candidate.x, strict=True)
        if t.place.kind == "mass"
        and t.place.number == 1
        and not isinstance(t.effect, DryLaw)
        and (isinstance(t.effect, ImpedanceEffect) or (isinstance(t.effect, ForceEffect) and t.effect.local))
    )


def law_parts(view: View, candidate: Candidate) -> list[Part | None]:
    """Contribution of each law at the view's present inner motion; ``None`` for effects linear in motion."""
    view.beside = laws_beside_dry_friction(candidate)
    return [law_part(view, t, x) for t, x in zip(candidate.terms, candidate.x, strict=True)]


def law_part(view: View, term: PlacedEffect, x: Float64) -> Part | None:
    """Contribution of one law at the view's present inner motion; ``None`` for an effect linear in motion."""
    if isinstance(term.effect, ImpedanceEffect):
        return None
    if term.inner:
        key = (term, x.tobytes())
        return view.at_motion(key, lambda: term.effect.contribution(view, term.place, x.tolist()))
    return term.effect.contribution(view, term.place, x.tolist())


def forces_of(view: View, candidate: Candidate) -> Forces:
    """Function that returns the contributions at the view's present inner motion, and the inner motion that
    follows."""
    return lambda: sum_contributions(view, candidate, law_parts(view, candidate))


def sum_contributions(
    view: View, candidate: Candidate, parts: Sequence[Part | None]
) -> tuple[Complex128, Complex128]:
    """(F, M) contributions and (F, ΣN) inner motion that follows, from the contributions of single laws."""
    inner = any(t.depends_on_inner_motion(view) for t in candidate.terms)
    patterns = force_patterns(view, candidate)
    total: Complex128 = np.zeros_like(view.acting)
    outside_torque: Complex128 = np.zeros_like(view.acting)
    back: Complex128 = np.zeros_like(view.base)
    for term, part in zip(candidate.terms, parts, strict=True):
        if part is None:
            continue
        own, yields = part
        total = total + own
        if term.place.kind == "axis":  # a drive's or a sensor's: no force at any mass
            outside_torque = outside_torque + own
        if yields is not None:
            back = back + yields
    if linear := linear_effects(candidate):
        own, moved = impedances(view, linear, back)
        total, back = total + own, back + moved
    rest = view.missing_with(total) if inner and patterns else None
    if rest is not None:
        back = back + view.correction(patterns, rest, outside_torque)
    return total, back
