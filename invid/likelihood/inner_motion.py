"""Inner motion in agreement with the forces that depend on it: a fixed point, mixed so that it is reached.

Plain substitution diverges wherever a force changes by more than the chain resists, which every strong
effect does near a resonance of the inner masses with the motors held. Anderson's mixing (type II) learns
the few directions in which it does from the substitutions themselves.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from invid.effects.motion import View
from invid.numerics.anderson import Secants
from invid.numerics.arrays import Complex128, Float64

CLOSE = 1e-4
"""Disagreement, over the largest line of what the forces do, at which there is agreement: the strongest
effects stand 40 dB above the noise on a line, so what is left is a hundredth of it."""
NEGLIGIBLE = 1e-8
"""The same over the largest line of motion: below what 24 bits resolve of a revolution."""
WORSE = 10.0
"""Growth of the disagreement at which the search goes back to the best: far out nothing is linear."""
NEWTON, DIRECTIONS, CLOSER = 16, 80, 0.05
"""Newton's steps at most where substitutions found no agreement, directions looked along for each (a gap as
wide as the deflection takes one or two for every line below the clamped resonance), and the share of the
disagreement that they may leave."""
PROBE = 1e-5
"""Length of a look along a direction, over the motion: laws bend, and rounding is 1e-16 of it."""


Forces = Callable[[], tuple[Complex128, Complex128]]
"""Contributions (F, M), and the inner motion (F, dofs) that follows from the view's present one."""


@np.errstate(over="ignore", invalid="ignore")  # a step too far is told by its size, and taken back
def solve_inner_motion(view: View, forces: Forces, passes: int, *, early: bool = True) -> Complex128:
    """(F, M) contributions at the inner motion that ``forces`` and the plant agree on.

    The ends of a record that does not close follow from the forces as well and move what they depend on. The
    view is left at the best inner motion seen. ``early``: stop as soon as there is agreement and remember the
    directions; otherwise go all ``passes`` along those known.
    """
    secants = view.secants
    scale = max(float(np.abs(view.base).max()), 1e-300)
    best: _State | None = None
    before: tuple[Float64, Float64] | None = None
    total: Complex128 = np.zeros_like(view.acting)
    enough = 0.0
    for number in range(passes):
        total, gap, moved = _gap(view, forces)
        here = _state(view)
        size = _largest(view, gap)
        enough = max(CLOSE * moved, NEGLIGIBLE * scale)
        if best is None or size < best[0]:
            best = (size, here, gap, total)
        if (early and size < enough) or number == passes - 1:
            break
        rest = gap
        if before is not None and early and np.isfinite(size):
            view.secants = secants = secants.plus(here - before[0], rest - before[1])
        if not np.isfinite(size):
            view.secants = secants = Secants()
        if not size < WORSE * best[0]:  # back, with what was learned on the way
            here, rest = best[1], best[2]
        before = (here, rest)
        _take(view, here + secants.step(rest))
    if early and best is not None and best[0] < np.inf:
        if best[0] > enough:
            best = _by_newton(view, forces, best)
        _take(view, best[1])
        total = best[3]
    return total


_State = tuple[float, Float64, Float64, Complex128]
"""Size of the disagreement, inner motion and ends, disagreement, contributions."""


def _by_newton(view: View, forces: Forces, best: _State) -> _State:
    """Where Newton's steps from the ``best`` so far lead; the best one's directions stay the view's secants.

    Whole steps: of laws with corners (a gap) a step that makes it worse goes on to the solution, where
    shorter ones that never do stop at a corner.
    """
    scale = max(float(np.abs(view.base).max()), 1e-300)
    _, here, gap, _ = best
    for _ in range(NEWTON):
        secants = _krylov(view, forces, here, gap)
        here = here + secants.step(gap)
        _take(view, here)
        total, gap, moved = _gap(view, forces)
        size = _largest(view, gap)
        if not np.isfinite(size):
            break
        if size < best[0]:
            best, view.secants = (size, here, gap, total), secants
        if size < max(CLOSE * moved, NEGLIGIBLE * scale):
            break
    return best


def learn_inner_directions(view: View, forces: Forces, changed: Forces) -> None:
    """Leaves the view the directions in which its inner motion answers where ``forces`` become ``changed``.

    Agreement that was there from the start has taught none, and differences need them.
    """
    here, gap = _state(view), _gap(view, forces)[1]
    toward = _gap(view, changed)[1] - gap
    if np.linalg.norm(toward) > 0.0:
        view.secants = _krylov(view, forces, here, gap, toward)
        _take(view, here)


def _krylov(
    view: View, forces: Forces, here: Float64, gap: Float64, toward: Float64 | None = None
) -> Secants:
    """Moves and what they change of the disagreement ``gap`` around ``here``: GMRES's directions.

    They take that disagreement, or ``toward``, away.
    """
    toward = gap if toward is None else toward
    length = PROBE * max(float(np.linalg.norm(view.base)), 1e-300)
    moves: list[Float64] = [toward / np.linalg.norm(toward)]
    changes: list[Float64] = []
    frame: list[Float64] = []
    left = toward
    for _ in range(DIRECTIONS):
        _take(view, here + length * moves[-1])
        change = (_gap(view, forces)[1] - gap) / length
        if not np.isfinite(change).all():
            break
        changes.append(change)
        own = _orthogonal(change, frame)
        if np.linalg.norm(own) > 0.0:
            frame.append(own / np.linalg.norm(own))
            left = left - frame[-1] * (frame[-1] @ left)
        fresh = _orthogonal(change, moves)
        size = float(np.linalg.norm(fresh))
        if np.linalg.norm(left) < CLOSER * np.linalg.norm(toward) or size < 1e-9 * np.linalg.norm(change):
            break
        moves.append(fresh / size)
    return Secants.of(moves[: len(changes)], changes)


def _orthogonal(vector: Float64, frame: list[Float64]) -> Float64:
    """What no vector of an orthonormal frame has of it, twice over for rounding's sake."""
    if not frame:
        return vector
    basis = np.array(frame)
    for _ in range(2):
        vector = vector - basis.T @ (basis @ vector)
    return vector


def _gap(view: View, forces: Forces) -> tuple[Complex128, Float64, float]:
    """Contributions, disagreement in the units of ``_state``, and the largest line of what the forces do."""
    total, back = forces()
    jumps = view.closed(total)
    gap = np.concatenate((_flat(back - view.feedback), (jumps - view.jumps) * _size(view)))
    return total, gap, float(np.abs(back).max())


def _state(view: View) -> Float64:
    """(n,) inner motion, and jumps as the motion that they stand for."""
    return np.concatenate((_flat(view.feedback), view.jumps * _size(view)))


def _take(view: View, state: Float64) -> None:
    """Sets the view to what ``_state`` put together."""
    lines = 2 * view.feedback.size
    feedback: Complex128 = state[:lines].view(np.complex128).reshape(view.feedback.shape)
    view.respond(feedback, state[lines:] / _size(view) if state.size > lines else None)


def _size(view: View) -> Float64 | float:
    """(2ΣN,) largest line of motion for a unit jump."""
    if view.closing is None:
        return 1.0
    return view.closing.unit


def _largest(view: View, gap: Float64) -> float:
    """Largest line of a disagreement, or jump as the motion that it stands for."""
    lines = 2 * view.feedback.size
    both = (np.abs(gap[:lines].view(np.complex128)), np.abs(gap[lines:]))
    return max(float(part.max(initial=0.0)) for part in both)


def _flat(values: Complex128) -> Float64:
    return np.ascontiguousarray(values).view(np.float64).ravel()
