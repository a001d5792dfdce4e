"""The compiled sub-step: the linear part exactly, force laws as in its middle, dry friction as a set.

x⁺ = Φx + Γ(f + g) + R(f⁺ − f) with x = [q; v], f what is applied to every coordinate as the sub-step begins
and f⁺ as it ends, exact where it is linear in between, and g what laws give in the middle of the sub-step.
Dry friction takes the value within its level that stops the mass at the end of the sub-step (Moreau's time
stepping), so that sticking is exact; several are solved by projected Gauss–Seidel.

Tuples go in: ``step`` is Φ, Γ and R, transposed, so that row c is what coordinate or force c adds, and half
the sub-step's length; ``laws`` kinds (E, 3), parameters (E, PARAMETERS), tables (S, P), memory (E, 3) and
friction's force (E,).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from invid.numerics.compiled import compiled, inlined

SWEEPS = 60
"""Of projected Gauss–Seidel at most; two or three are used."""


@inlined
def on_line(tables: Any, row: int, begin: int, points: int, largest: float, x: float) -> float:
    """Return what ``points`` entries of a row from ``begin``, even from −largest to largest, give at ``x``,
    straight on beyond their ends."""
    at = (x / largest + 1.0) * 0.5 * (points - 1)
    cell = min(max(int(np.floor(at)), 0), points - 2)
    low, high = tables[row, begin + cell], tables[row, begin + cell + 1]
    found: float = low + (at - cell) * (high - low)
    return found


@inlined
def on_surface(tables: Any, row: int, most: float, fastest: float, q: float, v: float) -> float:
    """Return what a row that is a square, positions by velocities, gives at ``q`` and ``v``."""
    points = int(np.sqrt(tables.shape[1]) + 0.5)
    at = (q / most + 1.0) * 0.5 * (points - 1)
    cell = min(max(int(np.floor(at)), 0), points - 2)
    low = on_line(tables, row, cell * points, points, fastest, v)
    high = on_line(tables, row, (cell + 1) * points, points, fastest, v)
    found: float = low + (at - cell) * (high - low)
    return found


@inlined
def on_table(tables: Any, row: int, kind: float, most: float, fastest: float, q: float, v: float) -> float:
    """Return what a row gives at ``q`` and ``v``; ``kind``: 0 over position, 1 over velocity, 2 over both."""
    if kind == 2.0:
        found = on_surface(tables, row, most, fastest, q, v)
    elif kind == 1.0:
        found = on_line(tables, row, 0, tables.shape[1], fastest, v)
    else:
        found = on_line(tables, row, 0, tables.shape[1], most, q)
    return found


@compiled
def _add_laws(force: Any, x: Any, laws: Any, half: float) -> None:
    """Add to ``force`` (n,) what all laws but dry friction give half a sub-step on."""
    kinds, parameters, tables, memory = laws[0], laws[1], laws[2], laws[3]
    n = x.size // 2
    for e in range(kinds.shape[0]):
        law, a, b = int(kinds[e, 0]), int(kinds[e, 1]), int(kinds[e, 2])
        if law == 0:
            continue
        p = parameters[e]
        q, v = x[a], x[n + a]
        if b >= 0:
            q -= x[b]
            v -= x[n + b]
        q += half * v
        if law == 1:
            f = -(p[0] if v > 0 else p[1]) * v
        elif law == 2 or law == 7:
            # the far end of the spring slides where it would bear more than its level
            f = min(max(-p[0] * (q - memory[e, 0]), -p[1]), p[1])
            memory[e, 0] = q + f / p[0]
        elif law == 3:
            f = -p[0] * np.sin(p[1] * q + p[2])
        elif law == 4:
            f = -p[0]
        elif law == 5:
            f = -p[0] * q * q * q
        elif law == 6:
            # the linear spring and damper are in the matrices: give back what the gap takes
            if abs(q) > p[0]:
                f = p[1] * p[0] if q > 0 else -p[1] * p[0]
            else:
                f = p[1] * q + p[2] * v
        elif law == 8:
            # the spring stretches q less the error; what the motor side feels makes no energy
            angle = p[1] * (x[a] + half * x[n + a]) + p[2]
            error = p[0] * np.sin(angle)
            f = p[3] * error
            force[a] += p[3] * (q - error) * p[0] * p[1] * np.cos(angle)
        else:
            # the velocity half a sub-step on, as the position is
            v, memory[e, 2] = 1.5 * v - 0.5 * memory[e, 2], v
            f = -on_table(tables, int(p[3]), p[0], p[1], p[2], q, v)
            memory[e, 0] = max(memory[e, 0], abs(q))
            memory[e, 1] = max(memory[e, 1], abs(v))
        force[a] += f
        if b >= 0:
            force[b] -= f


@compiled
def _add_dry_friction(x: Any, fresh: Any, held: Any, laws: Any) -> None:
    """Dry friction that stops its masses at the end of the sub-step, as far as its levels reach."""
    kinds, parameters, impulse = laws[0], laws[1], laws[4]
    n, count = x.size // 2, kinds.shape[0]
    for e in range(count):
        impulse[e] = 0.0
    for _ in range(SWEEPS):
        worst = 0.0
        for e in range(count):
            p = parameters[e]
            if kinds[e, 0] != 0 or p[0] + p[1] + abs(p[2]) + abs(p[4]) == 0.0:
                continue
            a = int(kinds[e, 1])
            near = 0.0
            if p[2] != 0.0 or p[4] != 0.0:
                near = np.exp(-((abs(x[n + a]) / p[3]) ** p[5]))
            up = max(p[0] + near * p[2], 0.0)
            down = max(p[1] + near * p[4], 0.0)
            stop = impulse[e] - fresh[n + a] / held[a, n + a]
            change = min(max(stop, -up), down) - impulse[e]
            if change != 0.0:
                impulse[e] += change
                worst = max(worst, abs(change) / (up + down))
                for r in range(2 * n):
                    fresh[r] += held[a, r] * change
        if worst < 1e-13:
            break


@inlined
def advance(x: Any, work: Any, step: Any, laws: Any) -> None:
    """One sub-step of the state ``x`` (2n,), in place.

    ``work`` (3, 2n): what is applied to the coordinates as the sub-step begins in the second row, as it ends
    in the third; all three are used up.
    """
    transition, held, ramp = step[0], step[1], step[2]
    fresh, force, later = work[0], work[1], work[2]
    n, size = x.size // 2, x.size
    acts = laws[0].shape[0] > 0
    # Column by column: the inner loops are then vectorised without reordering any sum.
    for r in range(size):
        fresh[r] = 0.0
    for c in range(size):
        value = x[c]
        for r in range(size):
            fresh[r] += transition[c, r] * value
    for c in range(n):
        value = later[c] - force[c]
        if value != 0.0:
            for r in range(size):
                fresh[r] += ramp[c, r] * value
    if acts:
        _add_laws(force, x, laws, step[3])
    for c in range(n):
        value = force[c]
        if value != 0.0:
            for r in range(size):
                fresh[r] += held[c, r] * value
    if acts:
        _add_dry_friction(x, fresh, held, laws)
    for r in range(size):
        x[r] = fresh[r]


@inlined
def _keep(place: Any, x: Any, motors: Any) -> None:
    """Write position and velocity of every motor into ``place`` (M, 2)."""
    for i in range(motors.size):
        place[i, 0] = x[motors[i]]
        place[i, 1] = x[x.size // 2 + motors[i]]


@compiled
def march(x: Any, step: Any, laws: Any, torque: Any, motors: Any, every: int, out: Any) -> None:
    """March ``torque.shape[0] − 1`` sub-steps with ``torque`` (·, M) linear in each; motor [θ, θ̇] every
    ``every`` sub-steps into ``out``.

    ``x`` and what laws remember are changed in place: where sliders stand, how far a table was read.
    """
    work = np.zeros((3, x.size))
    steps = torque.shape[0] - 1
    for k in range(steps):
        if k % every == 0:
            _keep(out[k // every], x, motors)
        for c in range(x.size // 2):
            work[1, c] = work[2, c] = 0.0
        for i in range(motors.size):
            work[1, motors[i]] = torque[k, i]
            work[2, motors[i]] = torque[k + 1, i]
        advance(x, work, step, laws)
    if steps % every == 0:
        _keep(out[steps // every], x, motors)


@compiled
def march_held(
    x: Any, step: Any, laws: Any, drive: Any, hold: Any, motors: Any, substeps: int, out: Any, acted: Any
) -> None:
    """March over the cycles of ``drive`` (n, M), a torque held over each, less what a master's hold asks.

    ``hold`` (2, M): torque per position, and per change of it in a cycle; it answers a cycle late. Motor
    [θ, θ̇] as each cycle begins into ``out`` (n, M, 2), the torque of the cycle into ``acted`` (n, M).
    """
    work, seen = np.zeros((3, x.size)), np.zeros((2, motors.size))
    for k in range(drive.shape[0]):
        _keep(out[k], x, motors)
        for i in range(motors.size):
            acted[k, i] = drive[k, i] - hold[0, i] * seen[0, i] - hold[1, i] * (seen[0, i] - seen[1, i])
            seen[1, i], seen[0, i] = seen[0, i], out[k, i, 0]
        for _ in range(substeps):
            for c in range(x.size // 2):
                work[1, c] = work[2, c] = 0.0
            for i in range(motors.size):
                work[1, motors[i]] = work[2, motors[i]] = acted[k, i]
            advance(x, work, step, laws)
