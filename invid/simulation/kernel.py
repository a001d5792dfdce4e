"""The compiled step: exact linear propagation, force laws once per sub-step.

x⁺ = Ad x + B0 u_k + B1 u_{k+1} + Bf f(x), with [q; v] = x: exact for inputs that are linear within a
sub-step and for forces that are constant in it. Dry friction is set-valued: it takes the value within
its level that would stop the mass at the end of the sub-step, so that sticking is exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from invid.numerics.compiled import compiled, inlined


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


@inlined
def _law(
    e: int,
    law: int,
    qa: float,
    va: float,
    qb: float,
    vb: float,
    parameters: Any,
    tables: Any,
    memory: Any,
) -> float:
    """Force of law ``e`` on its end a; q, v: position and velocity of its ends a and b (0: ground)."""
    f = 0.0
    if law == 1:
        f = -(parameters[e, 0] if va > 0 else parameters[e, 1]) * va
    elif law == 2 or law == 7:
        place = qa - qb if law == 7 else qa
        most = parameters[e, 1] / parameters[e, 0]
        z = memory[e, 0] + place - memory[e, 1]
        z = min(max(z, -most), most)
        memory[e, 0] = z
        memory[e, 1] = place
        f = -parameters[e, 0] * z
    elif law == 3:
        f = -parameters[e, 0] * np.sin(parameters[e, 1] * qa + parameters[e, 2])
    elif law == 4:
        f = -parameters[e, 0]
    elif law == 5:
        d = qa - qb
        f = -parameters[e, 0] * d * d * d
    elif law == 6:
        # the linear spring and damper are in the matrices: give back what the gap takes
        d, half = qa - qb, parameters[e, 0]
        if d > half:
            f = parameters[e, 1] * half
        elif d < -half:
            f = -parameters[e, 1] * half
        else:
            f = parameters[e, 1] * d + parameters[e, 2] * (va - vb)
    elif law == 9:
        # The velocity half a sub-step on, as the positions are.
        rate = 1.5 * (va - vb) - 0.5 * memory[e, 1]
        memory[e, 1] = va - vb
        memory[e, 0] = max(memory[e, 0], abs(qa - qb))
        memory[e, 2] = max(memory[e, 2], abs(rate))
        kind, most, fastest = parameters[e, 0], parameters[e, 1], parameters[e, 2]
        f = -on_table(tables, int(parameters[e, 3]), kind, most, fastest, qa - qb, rate)
    return f


@inlined
def _forces(
    force: Any, state: Any, kinds: Any, parameters: Any, tables: Any, memory: Any, step: float
) -> None:
    """Write into ``force`` (n,) what all laws but dry friction give in the middle of a sub-step."""
    dofs = force.size
    for d in range(dofs):
        force[d] = 0.0
    for e in range(kinds.shape[0]):
        law, a, b = int(kinds[e, 0]), int(kinds[e, 1]), int(kinds[e, 2])
        if law == 0:
            continue
        va = state[dofs + a]
        qa = state[a] + 0.5 * step * va
        vb = 0.0
        qb = 0.0
        if b >= 0:
            vb = state[dofs + b]
            qb = state[b] + 0.5 * step * vb
        if law == 8:
            angle = parameters[e, 1] * qa + parameters[e, 2]
            error = parameters[e, 0] * np.sin(angle)
            slope = parameters[e, 0] * parameters[e, 1] * np.cos(angle)
            stretch = qa - qb
            force[a] += parameters[e, 3] * (stretch - (stretch - error) * (1.0 - slope))
            force[b] -= parameters[e, 3] * error
            continue
        f = _law(e, law, qa, va, qb, vb, parameters, tables, memory)
        force[a] += f
        if b >= 0:
            force[b] -= f


@inlined
def _add_dry_friction(
    fresh: Any, impulse: Any, state: Any, kinds: Any, parameters: Any, force_input: Any, sweeps: int
) -> None:
    """Dry friction that stops its masses at the end of the sub-step, as far as its levels reach."""
    dofs, laws = state.size // 2, kinds.shape[0]
    for e in range(laws):
        impulse[e] = 0.0
    for _ in range(sweeps):
        for e in range(laws):
            if kinds[e, 0] != 0:
                continue
            a = int(kinds[e, 1])
            near = 0.0
            if parameters[e, 2] != 0.0 or parameters[e, 4] != 0.0:
                ratio = abs(state[dofs + a]) / parameters[e, 3]
                near = np.exp(-(ratio ** parameters[e, 5]))
            up = max(parameters[e, 0] + near * parameters[e, 2], 0.0)
            down = max(parameters[e, 1] + near * parameters[e, 4], 0.0)
            stop = impulse[e] - fresh[dofs + a] / force_input[dofs + a, a]
            wanted = min(max(stop, -up), down)
            change = wanted - impulse[e]
            impulse[e] = wanted
            if change != 0.0:
                for r in range(state.size):
                    fresh[r] += force_input[r, a] * change


@inlined
def _keep(place: Any, state: Any, motors: Any) -> None:
    """Write position and velocity of every motor into ``place`` (M, 2)."""
    dofs = state.size // 2
    for i in range(motors.size):
        place[i, 0] = state[motors[i]]
        place[i, 1] = state[dofs + motors[i]]


@compiled
def march(
    state: Any,
    transition: Any,
    input_now: Any,
    input_next: Any,
    force_input: Any,
    torque: Any,
    kinds: Any,
    parameters: Any,
    tables: Any,
    memory: Any,
    step: float,
    every: int,
    positions: Any,
    motors: Any,
) -> None:
    """March ``torque.shape[0] − 1`` sub-steps; motor [θ, θ̇] every ``every`` sub-steps into ``positions``.

    ``state`` (2n,) and ``memory`` (E, 3) are changed in place: where sliders stand, how far a table was read.
    ``tables`` (S, P): resistance over even steps from minus to plus the largest value of its quantity, or √P
    by √P of two.
    """
    size, dofs, count = state.size, state.size // 2, motors.size
    laws = kinds.shape[0]
    force = np.zeros(dofs)
    fresh = np.zeros(size)
    impulse = np.zeros(laws)
    steps = torque.shape[0] - 1
    dry = 0
    for e in range(laws):
        if kinds[e, 0] == 0:
            dry += 1
    for k in range(steps):
        if k % every == 0:
            _keep(positions[k // every], state, motors)
        for r in range(size):
            total = 0.0
            for c in range(size):
                total += transition[r, c] * state[c]
            for c in range(count):
                total += input_now[r, c] * torque[k, c] + input_next[r, c] * torque[k + 1, c]
            fresh[r] = total
        if laws > 0:
            _forces(force, state, kinds, parameters, tables, memory, step)
            for d in range(dofs):
                if force[d] != 0.0:
                    for r in range(size):
                        fresh[r] += force_input[r, d] * force[d]
            if dry > 0:
                _add_dry_friction(
                    fresh, impulse, state, kinds, parameters, force_input, 1 if dry == 1 else 10
                )
        for r in range(size):
            state[r] = fresh[r]
    if steps % every == 0:
        _keep(positions[steps // every], state, motors)
