"""Inner motion in agreement with the forces that depend on it: an accelerated fixed-point iteration.

Plain substitution diverges where a force changes by more than the chain resists, which every strong effect
does near a resonance of the inner masses with the motors held. Anderson mixing (type II) learns the few
directions in which it does from the substitutions themselves.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from invid.effects.motion import View
from invid.numerics.anderson import Secants
from invid.numerics.arrays import Complex128, Float64

TOLERANCE = 1e-4
"""Tolerance of the disagreement, over the largest line of the forces' effect. Empirical: the strongest
effects stand 40 dB above the noise on a line, so a hundredth of the noise is left."""
NEGLIGIBLE = 1e-8
"""Tolerance over the largest line of motion: below the resolution of 24 bits a revolution (physical)."""
MOST_GROWTH = 10.0
"""Growth of the disagreement at which the iteration returns to the best state: far out nothing is linear."""
NEWTON_STEPS, MOST_DIRECTIONS, DIRECTION_TOLERANCE = 16, 80, 0.05
"""Most Newton steps where substitutions found no agreement, directions for each (a gap as wide as the
deflection takes one or two for every line below the clamped resonance), and the share of the disagreement
that the directions may leave."""
MOST_WORSE = 4
"""Newton steps in a row that bring nothing, after which there is no solution near (empirical: past a corner
of a gap one or two do)."""
PROBE_LENGTH = 1e-5
"""Length of a finite difference along a direction, over the motion."""


Forces = Callable[[], tuple[Complex128, Complex128]]
"""Function that returns contributions (F, M), and the inner motion (F, dofs) that follows from the present
one."""


@np.errstate(over="ignore", invalid="ignore")  # a step too far is told by its size, and taken back
def solve_inner_motion(view: View, forces: Forces, passes: int, *, early: bool = True) -> Complex128:
    """(F, M) contributions at the inner motion on which ``forces`` and the plant agree.

    The ends of a record that does not close depend on the forces and change them as well. The view keeps the
    best inner motion found. ``early``: stop at agreement and keep the directions; otherwise take all
    ``passes`` along the known ones.
    """
    secants = view.secants
    scale = max(float(np.abs(view.base).max()), 1e-300)
    best: _State | None = None
    here = _pack_state(view)
    before: tuple[Float64, Float64] | None = None
    total: Complex128 = np.zeros_like(view.acting)
    tolerance = 0.0
    for number in range(passes):
        total, gap, size, largest_effect = _disagreement(view, forces)
        tolerance = max(TOLERANCE * largest_effect, NEGLIGIBLE * scale)
        if best is None or size < best[0]:
            best = (size, here, gap, total)
        if (early and size < tolerance) or number == passes - 1:
            break
        rest = gap
        if before is not None and early and np.isfinite(size):
            view.secants = secants = secants.plus(here - before[0], rest - before[1])
        if not np.isfinite(size):
            view.secants = secants = Secants()
        if not size < MOST_GROWTH * best[0]:  # back, with what was learned on the way
            here, rest = best[1], best[2]
        before = (here, rest)
        here = here + secants.step(rest)
        _set_state(view, here)
    if early and best is not None and best[0] < np.inf:
        if best[0] > tolerance and view.may_agree:
            best = _solve_by_newton(view, forces, best)
            # Where there is no agreement the next initial state of a slider has none either, as a rule.
            view.may_agree = best[0] <= tolerance
            _set_state(view, best[1])
        elif best[1] is not here:
            _set_state(view, best[1])
        total = best[3]
    return total


_State = tuple[float, Float64, Float64, Complex128]
"""Size of the disagreement, inner motion and ends, disagreement, contributions."""


def _solve_by_newton(view: View, forces: Forces, best: _State) -> _State:
    """The state after Newton steps from ``best``; the best one's directions stay in the view.

    Whole steps: for laws with corners (a gap) a step that makes it worse goes on to the solution, where
    shorter monotonic ones stop at a corner.
    """
    scale = max(float(np.abs(view.base).max()), 1e-300)
    _, here, gap, _ = best
    worse = 0
    for _ in range(NEWTON_STEPS):
        secants = _krylov_secants(view, forces, here, gap)
        here = here + secants.step(gap)
        _set_state(view, here)
        total, gap, size, largest_effect = _disagreement(view, forces)
        if not size < MOST_GROWTH * best[0]:
            break
        worse = 0 if size < best[0] else worse + 1
        if not worse:
            best, view.secants = (size, here, gap, total), secants
        if worse == MOST_WORSE or size < max(TOLERANCE * largest_effect, NEGLIGIBLE * scale):
            break
    return best


def learn_inner_directions(view: View, forces: Forces, changed: Forces) -> None:
    """Gives the view the directions in which its inner motion changes where ``forces`` become ``changed``.

    A state that agreed from the start has learned none, and differences need them.
    """
    here, gap = _pack_state(view), _disagreement(view, forces)[1]
    toward = _disagreement(view, changed)[1] - gap
    if np.linalg.norm(toward) > 0.0:
        view.secants = _krylov_secants(view, forces, here, gap, toward)
        _set_state(view, here)


def _krylov_secants(
    view: View, forces: Forces, here: Float64, gap: Float64, target: Float64 | None = None
) -> Secants:
    """Secants of the disagreement ``gap`` around ``here`` in the directions of GMRES that reduce it, or
    ``target``."""
    target = gap if target is None else target
    length = PROBE_LENGTH * max(float(np.linalg.norm(view.base)), 1e-300)
    moves, frame = (np.empty((here.size, MOST_DIRECTIONS), order="F") for _ in range(2))
    moves[:, 0] = target / np.linalg.norm(target)
    changes: list[Float64] = []
    left, seen = target, 0
    for number in range(MOST_DIRECTIONS):
        _set_state(view, here + length * moves[:, number])
        change = (_disagreement(view, forces)[1] - gap) / length
        if not np.isfinite(change).all():
            break
        changes.append(change)
        own = _orthogonal(change, frame[:, :seen])
        if np.linalg.norm(own) > 0.0:
            frame[:, seen] = own / np.linalg.norm(own)
            left = left - frame[:, seen] * (frame[:, seen] @ left)
            seen += 1
        fresh = _orthogonal(change, moves[:, : number + 1])
        size = float(np.linalg.norm(fresh))
        is_enough = np.linalg.norm(left) < DIRECTION_TOLERANCE * np.linalg.norm(target)
        if is_enough or size < 1e-9 * np.linalg.norm(change) or number + 1 == MOST_DIRECTIONS:
            break
        moves[:, number + 1] = fresh / size
    return Secants.of(list(moves.T[: len(changes)]), changes, frame[:, :seen])


def _orthogonal(vector: Float64, frame: Float64) -> Float64:
    """The component of a vector (n,) orthogonal to the columns of an orthonormal frame (n, k), computed twice
    against rounding."""
    if not frame.shape[1]:
        return vector
    for _ in range(2):
        vector = vector - frame @ (frame.T @ vector)
    return vector


def _disagreement(view: View, forces: Forces) -> tuple[Complex128, Float64, float, float]:
    """Contributions, disagreement in the units of ``_pack_state`` less what the laws answer to it, and the
    largest lines of the disagreement and of the forces' effect."""
    total, back = forces()
    jumps = view.closing_jumps(total)
    apart, ends = back - view.feedback, (jumps - view.jumps) * _jump_unit(view)
    size = max(float(np.abs(apart).max(initial=0.0)), float(np.abs(ends).max(initial=0.0)))
    gap = np.concatenate((_flatten(view.without_response(apart)), ends))
    return total, gap, size, float(np.abs(back).max())


def _pack_state(view: View) -> Float64:
    """(n,) inner motion, and jumps in units of motion."""
    return np.concatenate((_flatten(view.feedback), view.jumps * _jump_unit(view)))


def _set_state(view: View, state: Float64) -> None:
    """Sets the view to a state of ``_pack_state``."""
    lines = 2 * view.feedback.size
    feedback: Complex128 = state[:lines].view(np.complex128).reshape(view.feedback.shape)
    view.set_inner_motion(feedback, state[lines:] / _jump_unit(view) if state.size > lines else None)


def _jump_unit(view: View) -> Float64 | float:
    """(2ΣN,) largest line of motion for a unit jump."""
    if view.closing is None:
        return 1.0
    return view.closing.unit


def _flatten(values: Complex128) -> Float64:
    return np.ascontiguousarray(values).view(np.float64).ravel()
