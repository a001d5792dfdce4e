"""Derivatives of what effects contribute, by finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.effects.effect import ImpedanceEffect
from invid.effects.motion import View
from invid.likelihood.inner_motion import learn_inner_directions
from invid.likelihood.law_response import direct_effect_changes, effect_response
from invid.likelihood.law_slopes import ForceChange, slopes_of
from invid.likelihood.nuisance.transients import jump_response
from invid.likelihood.placed_effect import Candidate, PlacedEffect, contributions, forces_of, linear_effects
from invid.numerics.arrays import Complex128, Float64


def response_columns(  # noqa: PLR0913 - the terms of the derivative
    view: View,
    candidate: Candidate,
    sp: Float64,
    q: Complex128,
    columns: Complex128,
    linear: int,
    *,
    strong: bool,
) -> bool:
    """Fills in the Jacobian columns of the effects; False where a law has no slope by itself
    (``law_slopes``).

    The first ``linear`` of ``columns`` (F, M, n) hold the derivatives of the linear parameters at fixed
    forces. ``strong``: adds to them the change of the laws with the inner motion.
    """
    slopes = slopes_of(view, candidate)
    if not slopes:
        return False
    structure = view.structure
    lines, coordinates = view.base.shape
    steps = difference_steps(view, candidate)
    known = linear if strong else 0
    count, springs = known + len(steps), view.springs.size
    base = np.zeros((lines, coordinates, count), dtype=complex)
    missing = np.zeros((*view.acting.shape, count), dtype=complex)
    total, back = np.zeros_like(missing), np.zeros_like(base)
    stiffness, damping = np.zeros((springs, count)), np.zeros((springs, count))
    total[..., known:], back[..., known:] = direct_effect_changes(view, candidate, steps)
    if strong:
        every = np.broadcast_to(np.eye(coordinates, dtype=complex), view.inner.shape)
        base[..., : structure.count] = -(
            view.inner @ structure.torque_derivative(sp, view.omega, every, q[None])[0]
        )
        missing[..., :known] = columns[..., :known]
        stiffness[:, structure.slices["spring"]] = np.diag(view.springs)  # they move as logarithms
        damping[:, structure.slices["damper"]] = np.eye(springs)
    change = ForceChange(base, missing, stiffness, damping, total, back)
    is_felt = np.ones(count, dtype=bool)
    if view.record.transient:
        # A force on a motor whose motion is measured moves inner masses only through the record's ends.
        is_felt[known:] = [candidate.terms[number].depends_on_inner_motion(view) for number, *_ in steps]
        is_felt[structure.count : known] = False
    response = total
    response[..., is_felt] = effect_response(view, candidate, slopes, change.only(is_felt))
    columns[..., :known] += response[..., :known]
    columns[..., linear:] = response[..., known:]
    return True


def effect_columns(view: View, candidate: Candidate, columns: Complex128, at: int) -> None:
    """Fills in the derivatives of the contributions by finite differences, from column ``at`` on.

    Both sides take the same steps from the same inner motion; a remaining disagreement would else be divided
    by the difference.
    """
    view.clear_cache()  # both sides from the same inner motion
    inner = any(t.depends_on_inner_motion(view) for t in candidate.terms)
    steps = difference_steps(view, candidate)
    if not steps:
        return
    if not inner:
        columns[..., at : at + len(steps)] = direct_effect_changes(view, candidate, steps)[0]
        return

    here = view.inner_motion

    def contributions_at(trial: Candidate) -> Complex128:
        out = contributions(view, trial, passes=3, early=False)
        view.return_to(here)
        return out

    reference = contributions_at(candidate)
    for number, (term, x) in enumerate(zip(candidate.terms, candidate.x, strict=True)):
        for k in range(x.size):
            h = _difference_step(view, term, x, k)
            shifted = x.copy()
            shifted[k] += h
            changed = Candidate(candidate.terms, (*candidate.x[:number], shifted, *candidate.x[number + 1 :]))
            columns[..., at] = (contributions_at(changed) - reference) / h
            at += 1


def learn_inner_response(view: View, candidate: Candidate) -> None:
    """Teaches the view how the inner motion of a record that does not close responds to a change of its
    effects.

    Empirical: beside a gap the differences were two to five times off without it (chirps of the second
    generator).
    """
    x = []
    for term, own in zip(candidate.terms, candidate.x, strict=True):
        more = own.copy()
        for k in range(own.size):
            more[k] += _difference_step(view, term, own, k)
        x.append(more)
    learn_inner_directions(
        view, forces_of(view, candidate), forces_of(view, Candidate(candidate.terms, tuple(x)))
    )


def jump_columns(
    view: View, candidate: Candidate, motion: Complex128, jumps: Float64, columns: Complex128, at: int
) -> None:
    """Adds to the effects' columns their change at the ``jumps`` (2ΣN,) of a record that does not close."""

    def at_jumps(trial: Candidate) -> Complex128:
        torque: Complex128 = jump_response(view, trial, motion)[0] @ jumps
        return torque

    if not linear_effects(candidate):
        return
    here = at_jumps(candidate)
    for number, (term, x) in enumerate(zip(candidate.terms, candidate.x, strict=True)):
        if not isinstance(term.effect, ImpedanceEffect):
            at += x.size
            continue
        for k in range(x.size):
            h = _difference_step(view, term, x, k)
            more = x.copy()
            more[k] += h
            changed = Candidate(candidate.terms, (*candidate.x[:number], more, *candidate.x[number + 1 :]))
            columns[..., at] += (at_jumps(changed) - here) / h
            at += 1


def impedance_columns(
    view: View, candidate: Candidate, sp: Float64, q: Complex128, columns: Complex128
) -> None:
    """Adds to the linear parameters' columns the change of effects that are linear in motion.

    ``columns`` (F, M, n) hold the derivatives at fixed forces, ∂q/∂p = −Z_ii⁻¹ (∂Z/∂p) q. Without this a mode
    on an inner mass was still a hundred of χ² from its minimum after a hundred steps, and its double on
    another axis, which took ten, was named.
    """
    for term, x in zip(candidate.terms, candidate.x, strict=True):
        if term.inner and isinstance(term.effect, ImpedanceEffect):
            pattern = term.effect.pattern(view.structure, term.place, x.tolist())
            # Along one pattern only: its rows of Z_ii⁻¹ through ∂Z of every coordinate.
            rows = view.inner_receptance(pattern)[:, :, None]
            every = view.structure.torque_derivative(sp, view.omega, rows, q[None])[0]
            force = -term.effect.force_per_motion(view, term.place, x.tolist())[:, None] * every[:, 0]
            columns[..., : view.structure.count] += (
                view.condensed_force(pattern)[:, :, None] * force[:, None, :]
            )


def difference_steps(view: View, candidate: Candidate) -> list[tuple[int, int, float]]:
    """Number of the effect, number of the parameter and step, for every parameter of the effects."""
    return [
        (number, k, _difference_step(view, term, x, k))
        for number, (term, x) in enumerate(zip(candidate.terms, candidate.x, strict=True))
        for k in range(x.size)
    ]


def _difference_step(view: View, term: PlacedEffect, x: Float64, k: int) -> float:
    """Step of a parameter for finite differences."""
    count = len(term.effect.coefficients)
    if k < count:
        size = float(np.abs(x[:count]).max())
        return 1e-4 * size if size > 0 else 1e-9
    return term.effect.difference(view, k - count, float(x[k]))


def moves_inner_masses(view: View, candidate: Candidate) -> bool:
    """Whether effects move inner masses by more than a hundredth of the motion along one of their patterns.

    Below, the change of the laws with that is a hundredth of a column. Along the pattern and not at the
    motors: a gap that is most of a spring's deflection moves the load by a hundredth of the axis' motion, and
    a fit without the term stops far from its minimum. A motor that stands is held by the spring beside it,
    whatever that moves.
    """
    if any(t.effect.stands(view, t.place) for t in candidate.terms):
        return True
    pairs = zip(candidate.terms, candidate.x, strict=True)
    for pattern in {t.effect.pattern(view.structure, t.place, x.tolist()) for t, x in pairs if t.inner}:
        at, signs = [q for q, _ in pattern], np.array([sign for _, sign in pattern])
        base, caused = view.base[:, at] @ signs, view.feedback[:, at] @ signs
        if np.linalg.norm(caused) > 0.01 * np.linalg.norm(base):
            return True
    return False


def law_columns(
    view: View, candidate: Candidate, sp: Float64, q: Complex128, columns: Complex128, linear: int
) -> None:
    """Adds to the linear parameters' columns the change of the laws with the inner motion.

    The first ``linear`` of ``columns`` (F, M, n) hold the derivatives at fixed forces, ∂q/∂p = −Z_ii⁻¹
    (∂Z/∂p) q. A parameter that moves no inner mass (a motor's mass, a time offset) changes the missing torque
    from which forces are estimated.
    """
    structure, base, missing, closing = view.structure, view.base, view.missing, view.closing
    feedback, jumps = view.feedback, view.jumps
    springs, dampers = view.springs, view.dampers
    every = np.broadcast_to(np.eye(base.shape[1], dtype=complex), view.inner.shape)
    motion_slopes = -(view.inner @ structure.torque_derivative(sp, view.omega, every, q[None])[0])
    reference = contributions(view, candidate, passes=2, early=False)
    view.set_inner_motion(feedback, jumps)
    for k in range(linear):
        largest_motion = float(np.abs(motion_slopes[..., k]).max()) if k < structure.count else 0.0
        own = float(np.abs(columns[..., k]).max())
        if largest_motion > 0.0:
            h = 1e-4 * float(np.abs(base).max()) / largest_motion
            at = sp.copy()
            at[k] += h
            values = structure.physical(at)
            view.base = base + h * motion_slopes[..., k]
            view.springs = values[structure.slices["spring"]]
            view.dampers = values[structure.slices["damper"]]
        elif own > 0.0:
            h = 1e-4 * float(np.abs(view.acting).max()) / own
            view.base, view.springs, view.dampers = base, springs, dampers
        else:
            continue
        view.missing = None if missing is None else missing + h * columns[..., k]
        view.closing = (
            None if closing is None else replace(closing, linear=closing.linear + h * columns[..., k])
        )
        view.set_inner_motion(feedback, jumps)
        columns[..., k] += (contributions(view, candidate, passes=2, early=False) - reference) / h
    view.base, view.missing, view.springs, view.dampers = base, missing, springs, dampers
    view.closing = closing
    view.set_inner_motion(feedback, jumps)
