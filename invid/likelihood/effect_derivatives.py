"""Derivatives of what effects contribute, by differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.effects.effect import ImpedanceEffect
from invid.effects.motion import View
from invid.likelihood.inner_motion import learn_inner_directions
from invid.likelihood.law_response import direct_effect_changes, effect_response
from invid.likelihood.law_slopes import ForceChange, slopes_of
from invid.likelihood.nuisance.transients import jump_response
from invid.likelihood.placed_effect import Candidate, PlacedEffect, contributions, forces_of
from invid.numerics.arrays import Complex128, Float64


def response_columns(
    view: View,
    candidate: Candidate,
    sp: Float64,
    q: Complex128,
    columns: Complex128,
    linear: int,
    *,
    strong: bool,
) -> bool:
    """Fills in the columns of the effects, and with ``strong`` adds to those of the linear parameters what
    the laws change by with the inner motion; False where a law has no slope by itself (``law_slopes``).

    The first ``linear`` of ``columns`` (F, M, n) hold the derivatives at fixed forces.
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
    moved = np.ones(count, dtype=bool)
    if view.record.transient:
        # A force on a motor whose motion is measured moves no inner mass but by the ends of the record.
        moved[known:] = [candidate.terms[number].feels(view) for number, *_ in steps]
        moved[structure.count : known] = False
    response = total
    response[..., moved] = effect_response(view, candidate, slopes, change.only(moved))
    columns[..., :known] += response[..., :known]
    columns[..., linear:] = response[..., known:]
    return True


def effect_columns(view: View, candidate: Candidate, columns: Complex128, at: int) -> None:
    """Derivatives of the contributions by differences.

    Both sides take the same steps from the same inner motion: what the steps have not brought into agreement
    yet would be divided by the difference.
    """
    feedback, jumps = view.feedback, view.jumps
    view.forget_measured()  # both sides from the same inner motion
    inner = any(t.feels(view) for t in candidate.terms)
    steps = difference_steps(view, candidate)
    if not steps:
        return
    if not inner:
        columns[..., at : at + len(steps)] = direct_effect_changes(view, candidate, steps)[0]
        return

    def at_(trial: Candidate) -> Complex128:
        out = contributions(view, trial, passes=3, early=False)
        view.respond(feedback, jumps)
        return out

    reference = at_(candidate)
    for number, (term, x) in enumerate(zip(candidate.terms, candidate.x, strict=True)):
        for k in range(x.size):
            h = _step_of(view, term, x, k)
            moved = x.copy()
            moved[k] += h
            changed = Candidate(candidate.terms, (*candidate.x[:number], moved, *candidate.x[number + 1 :]))
            columns[..., at] = (at_(changed) - reference) / h
            at += 1


def learn_inner_response(view: View, candidate: Candidate) -> None:
    """What the inner motion of a record that does not close answers to a change of its effects.

    Beside a gap the differences were two to five times off without (chirps of the second generator).
    """
    x = []
    for term, own in zip(candidate.terms, candidate.x, strict=True):
        more = own.copy()
        for k in range(own.size):
            more[k] += _step_of(view, term, own, k)
        x.append(more)
    learn_inner_directions(
        view, forces_of(view, candidate), forces_of(view, Candidate(candidate.terms, tuple(x)))
    )


def jump_columns(
    view: View, candidate: Candidate, moved: Complex128, jumps: Float64, columns: Complex128, at: int
) -> None:
    """Adds to the effects' columns what they do at the ``jumps`` (2ΣN,) of a record that does not close."""
    for term, x in zip(candidate.terms, candidate.x, strict=True):
        for k in range(x.size):
            if isinstance(term.effect, ImpedanceEffect):
                h = _step_of(view, term, x, k)
                more = x.copy()
                more[k] += h
                one, two = (
                    jump_response(view, Candidate((term,), (own,)), moved)[0] @ jumps for own in (x, more)
                )
                columns[..., at] += (two - one) / h
            at += 1


def impedance_columns(
    view: View, candidate: Candidate, sp: Float64, q: Complex128, columns: Complex128
) -> None:
    """Adds to the linear parameters' columns what effects linear in motion change by with the inner motion.

    ``columns`` (F, M, n) hold the derivatives at fixed forces, ∂q/∂p = −Z_ii⁻¹ (∂Z/∂p) q. Without this a mode
    on an inner mass was still a hundred of χ² from its minimum after a hundred steps, and its double on
    another axis, which took ten, was named.
    """
    for term, x in zip(candidate.terms, candidate.x, strict=True):
        if term.inner and isinstance(term.effect, ImpedanceEffect):
            pattern = term.place.pattern(view.structure)
            # Along one pattern only: its rows of Z_ii⁻¹ through ∂Z of every coordinate.
            rows = view.yields(pattern)[:, :, None]
            every = view.structure.torque_derivative(sp, view.omega, rows, q[None])[0]
            force = -term.effect.force_per_motion(view, term.place, x.tolist())[:, None] * every[:, 0]
            columns[..., : view.structure.count] += view.push(pattern)[:, :, None] * force[:, None, :]


def difference_steps(view: View, candidate: Candidate) -> list[tuple[int, int, float]]:
    """Effect, number of the parameter and difference, for every parameter of the effects."""
    return [
        (number, k, _step_of(view, term, x, k))
        for number, (term, x) in enumerate(zip(candidate.terms, candidate.x, strict=True))
        for k in range(x.size)
    ]


def _step_of(view: View, term: PlacedEffect, x: Float64, k: int) -> float:
    """Step of a parameter for differences."""
    count = len(term.effect.coefficients)
    if k < count:
        size = float(np.abs(x[:count]).max())
        return 1e-4 * size if size > 0 else 1e-9
    return term.effect.difference(view, k - count, float(x[k]))


def moves_inner_masses(view: View, candidate: Candidate) -> bool:
    """Whether effects move inner masses by more than a hundredth of what moves along one of their patterns:
    below, what the laws gain by a change of that is a hundredth of a column.

    Along the pattern and not beside the motors: a gap that is most of a spring's deflection moves the load by
    a hundredth of what the axis moves, and a fit without the term stands still far from its minimum. What
    holds a motor that stands is the spring beside it, whatever that moves.
    """
    if any(t.effect.stands(view, t.place) for t in candidate.terms):
        return True
    for pattern in {t.place.pattern(view.structure) for t in candidate.terms if t.inner}:
        at, signs = [q for q, _ in pattern], np.array([sign for _, sign in pattern])
        base, moved = view.base[:, at] @ signs, view.feedback[:, at] @ signs
        if np.linalg.norm(moved) > 0.01 * np.linalg.norm(base):
            return True
    return False


def law_columns(
    view: View, candidate: Candidate, sp: Float64, q: Complex128, columns: Complex128, linear: int
) -> None:
    """Adds to the linear parameters' columns what the laws change by with the inner motion.

    The first ``linear`` of ``columns`` (F, M, n) hold the derivatives at fixed forces,
    ∂q/∂p = −Z_ii⁻¹ (∂Z/∂p) q. What moves no inner mass, a motor's mass or the time the torque acts at, moves
    the missing torque that forces are read from.
    """
    structure, base, missing, closing = view.structure, view.base, view.missing, view.closing
    feedback, jumps = view.feedback, view.jumps
    springs, dampers = view.springs, view.dampers
    every = np.broadcast_to(np.eye(base.shape[1], dtype=complex), view.inner.shape)
    moves = -(view.inner @ structure.torque_derivative(sp, view.omega, every, q[None])[0])
    reference = contributions(view, candidate, passes=2, early=False)
    view.respond(feedback, jumps)
    for k in range(linear):
        largest = float(np.abs(moves[..., k]).max()) if k < structure.count else 0.0
        own = float(np.abs(columns[..., k]).max())
        if largest > 0.0:
            h = 1e-4 * float(np.abs(base).max()) / largest
            at = sp.copy()
            at[k] += h
            values = structure.physical(at)
            view.base = base + h * moves[..., k]
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
        view.respond(feedback, jumps)
        columns[..., k] += (contributions(view, candidate, passes=2, early=False) - reference) / h
    view.base, view.missing, view.springs, view.dampers = base, missing, springs, dampers
    view.closing = closing
    view.respond(feedback, jumps)
