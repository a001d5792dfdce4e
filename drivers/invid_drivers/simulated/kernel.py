"""Compiled integration of the coupled chains over whole sub-steps.

The linear part is stepped exactly (matrix exponential, torques held over a sub-step), so that the
stiffest mode needs no smaller step than the slowest. Smooth nonlinear forces enter by a second-order
exponential predictor-corrector (ETD2RK: Cox and Matthews 2002, eq. 22). Dry friction is a complementarity
problem in the velocity at the end of the sub-step, solved by projected Gauss-Seidel (Moreau's
time stepping): either the mass sticks with a force below the level or it slides at the level,
with no regularisation velocity and no event search.

Written independently of ``invid.simulate`` and of the estimators.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from invid.numerics.arrays import Float64, Int64
from invid.numerics.compiled import compiled, inlined

# columns of the command table, one row per motor
MODE, TORQUE, POSITION, VELOCITY, DECELERATION, INTERPOLATE, GAIN_P, GAIN_D, LIMIT, BRAKE = range(10)
# what acts differently from what the drive believes
TORQUE_GAIN, SATURATION, LAG, HIDDEN_LAG, DELAY = range(10, 15)
ENCODER_SIGN, ENCODER_OFFSET, STUCK, STUCK_AT, COUNTS_PER_UNIT, ECCENTRICITY, ECCENTRICITY_PHASE = range(
    15, 22
)
RATED, TORQUE_STEPS, DIRECTION = range(22, 25)
COMMAND_COLUMNS = 25

MODE_OFF, MODE_TORQUE, MODE_POSITION = 0.0, 1.0, 2.0

# columns of the motor state
RECORDED, LAGGED, ACTING, PREVIOUS, ACCELERATION = range(5)
STATE_COLUMNS = 5

# columns of a nonlinear element: kind, coordinates a and b (−1: ground), parameters
KIND, END_A, END_B, P0, P1, P2, P3 = range(7)
ELEMENT_COLUMNS = 7
OFFSET, SINE, CUBIC, BACKLASH, JENKINS, TRANSMISSION, ABSOLUTE = range(7)

# columns of a dry friction row: coordinate, levels, Stribeck excess and velocity, motor of its brake
DOF, LEVEL_POSITIVE, LEVEL_NEGATIVE, EXCESS, STRIBECK_VELOCITY, BRAKE_OF = range(6)
FRICTION_COLUMNS = 6

_SWEEPS = 60  # of projected Gauss-Seidel; two or three are used, the cap only bounds the time


@inlined
def _slider(
    x: float, stiffness: float, level: float, memory: Float64, e: int, update: bool
) -> float:  # pragma: no cover - compiled
    """Force of a spring whose far end slides at ``level``; ``memory`` is where that end stands."""
    f: float = stiffness * (x - memory[e])
    if f > level:
        f = level
        if update:
            memory[e] = x - level / stiffness
    elif f < -level:
        f = -level
        if update:
            memory[e] = x + level / stiffness
    return f


@compiled
def _nonlinear(
    q: Float64, n: int, elements: Float64, memory: Float64, force: Float64, update: bool
) -> None:  # pragma: no cover - compiled
    """Add the force of every nonlinear element at state ``q`` (positions, then velocities)."""
    for e in range(elements.shape[0]):
        kind = int(elements[e, KIND])
        a = int(elements[e, END_A])
        b = int(elements[e, END_B])
        x = q[a] - (q[b] if b >= 0 else 0.0)
        v = q[n + a] - (q[n + b] if b >= 0 else 0.0)
        p0, p1, p2 = elements[e, P0], elements[e, P1], elements[e, P2]
        f = 0.0
        if kind == OFFSET:
            f = p0
        elif kind == SINE:  # torque, cycles, phase
            f = p0 * math.sin(p1 * x + p2)
        elif kind == CUBIC:
            f = p0 * x * x * x
        elif kind == BACKLASH:  # stiffness, damper, gap: replaces the linear spring
            half = 0.5 * p2
            f = -(p0 * x + p1 * v)
            if x > half:
                f += max(p0 * (x - half) + p1 * v, 0.0)
            elif x < -half:
                f += min(p0 * (x + half) + p1 * v, 0.0)
        elif kind == JENKINS:  # stiffness, torque: a spring in series with a dry slider
            f = _slider(x, p0, p1, memory, e, update)
        elif kind == TRANSMISSION:  # stiffness, amplitude, cycles, phase of the angle at a
            # the spring stretches x − error; what the motor side feels makes no energy
            error = p1 * math.sin(p2 * q[a] + elements[e, P3])
            slope = p1 * p2 * math.cos(p2 * q[a] + elements[e, P3])
            f = -p0 * error
            force[a] += p0 * (x - error) * slope
        elif kind == ABSOLUTE:  # viscous friction that differs between the two directions
            f = p0 * abs(v)
        force[a] -= f
        if b >= 0:
            force[b] += f


@compiled
def _motors(
    q: Float64,
    n: int,
    motors: Int64,
    command: Float64,
    state: Float64,
    ring: Float64,
    slot: int,
    h: float,
    blend: float,
) -> None:  # pragma: no cover - compiled
    """The drives' inner loops for one sub-step: from command to the torque that acts."""
    length = ring.shape[1]
    for i in range(motors.shape[0]):
        row = command[i]
        mode = row[MODE]
        wanted = 0.0
        if mode == MODE_TORQUE:
            # a command that changed inside this sub-step: keep its impulse
            wanted = blend * state[i, PREVIOUS] + (1.0 - blend) * row[TORQUE]
            state[i, PREVIOUS] = row[TORQUE]
        elif mode == MODE_POSITION:
            seen, speed = row[STUCK_AT], 0.0
            if row[STUCK] == 0.0:
                angle = q[motors[i]]
                seen = row[ENCODER_SIGN] * (
                    angle + row[ECCENTRICITY] * math.sin(angle + row[ECCENTRICITY_PHASE])
                )
                speed = row[ENCODER_SIGN] * q[n + motors[i]]
            seen = (
                math.floor((seen + row[ENCODER_OFFSET]) * row[COUNTS_PER_UNIT] + 0.5) / row[COUNTS_PER_UNIT]
            )
            wanted = row[GAIN_P] * (row[POSITION] - seen) + row[GAIN_D] * (row[VELOCITY] - speed)
            wanted += row[TORQUE]
            row[POSITION] += row[VELOCITY] * h
            if row[DECELERATION] > 0.0:
                change = row[DECELERATION] * h
                if abs(row[VELOCITY]) <= change:
                    row[VELOCITY] = 0.0
                else:
                    row[VELOCITY] -= math.copysign(change, row[VELOCITY])
            elif row[INTERPOLATE] > 0.0:
                row[INTERPOLATE] -= 1.0
                if row[INTERPOLATE] <= 0.0:
                    row[VELOCITY] = 0.0
            state[i, PREVIOUS] = wanted
        else:
            state[i, PREVIOUS] = 0.0
        wanted = min(max(wanted, -row[LIMIT]), row[LIMIT])
        state[i, RECORDED] += (wanted - state[i, RECORDED]) * row[LAG]
        ring[i, slot] = state[i, RECORDED]
        whole = int(row[DELAY])
        part = row[DELAY] - whole
        late = ring[i, (slot - whole) % length] * (1.0 - part) + ring[i, (slot - whole - 1) % length] * part
        state[i, LAGGED] += (late - state[i, LAGGED]) * row[HIDDEN_LAG]
        acting = row[TORQUE_GAIN] * state[i, LAGGED]
        state[i, ACTING] = min(max(acting, -row[SATURATION]), row[SATURATION])


@compiled
def _friction(
    q: Float64, free: Float64, n: int, gamma: Float64, friction: Float64, level: Float64, command: Float64
) -> None:  # pragma: no cover - compiled
    """Solve for the dry friction forces ``level`` and add their effect to ``free``."""
    rows = friction.shape[0]
    active = False
    for i in range(rows):
        brake = int(friction[i, BRAKE_OF])
        extra = command[brake, BRAKE] if brake >= 0 else 0.0
        if friction[i, LEVEL_POSITIVE] + friction[i, LEVEL_NEGATIVE] + extra > 0.0:
            active = True
        else:
            level[i] = 0.0
    if not active:
        return
    for _ in range(_SWEEPS):
        worst = 0.0
        for i in range(rows):
            a = int(friction[i, DOF])
            brake = int(friction[i, BRAKE_OF])
            extra = command[brake, BRAKE] if brake >= 0 else 0.0
            if friction[i, EXCESS] > 0.0:
                ratio = q[n + a] / friction[i, STRIBECK_VELOCITY]
                extra += friction[i, EXCESS] * math.exp(-ratio * ratio)
            upper = friction[i, LEVEL_NEGATIVE] + extra  # pushes up while it slides down
            lower = -friction[i, LEVEL_POSITIVE] - extra
            if upper - lower <= 0.0:
                continue
            v = free[n + a]
            for j in range(rows):
                v += gamma[int(friction[j, DOF]), n + a] * level[j]
            new = min(max(level[i] - v / gamma[a, n + a], lower), upper)
            change = abs(new - level[i]) / (upper - lower)
            worst = max(worst, change)
            level[i] = new
        if worst < 1e-13:
            break
    for i in range(rows):
        if level[i] != 0.0:
            a = int(friction[i, DOF])
            for k in range(2 * n):
                free[k] += gamma[a, k] * level[i]


@inlined
def _propagate(
    free: Float64, q: Float64, force: Float64, phi: Float64, gamma: Float64
) -> None:  # pragma: no cover - compiled
    """Put into ``free`` what the linear part makes of ``q`` under the forces held over the sub-step."""
    # column by column: the inner loops are then vectorised without reordering any sum
    for k in range(q.size):
        free[k] = 0.0
    for c in range(q.size):
        value = q[c]
        for k in range(q.size):
            free[k] += phi[c, k] * value
    for c in range(q.size // 2):
        value = force[c]
        if value != 0.0:
            for k in range(q.size):
                free[k] += gamma[c, k] * value


@compiled
def advance(
    q: Float64,
    steps: int,
    h: float,
    phi: Float64,
    gamma: Float64,
    ramp: Float64,
    motors: Int64,
    command: Float64,
    state: Float64,
    ring: Float64,
    slot: int,
    external: Float64,
    elements: Float64,
    memory: Float64,
    friction: Float64,
    level: Float64,
    work: Float64,
    blend: float,
) -> int:  # pragma: no cover - compiled
    """Advance ``q`` in place by ``steps`` sub-steps; returns the new slot of the delay ring.

    ``blend`` is the share of the first sub-step that had passed when the commands were last set.
    ``phi``, ``gamma`` and ``ramp`` are transposed: row c is what coordinate or force c adds.
    """
    n = external.shape[0]
    count = motors.shape[0]
    free, force, later = work[0], work[1], work[2]
    for _ in range(steps):
        slot = (slot + 1) % ring.shape[1]
        _motors(q, n, motors, command, state, ring, slot, h, blend)
        blend = 0.0
        for k in range(n):
            force[k] = external[k]
        for i in range(count):
            force[motors[i]] += state[i, ACTING]
        for k in range(n):
            later[k] = force[k]
        if elements.shape[0]:
            _nonlinear(q, n, elements, memory, force, False)
        _propagate(free, q, force, phi, gamma)
        if elements.shape[0]:
            _nonlinear(free, n, elements, memory, later, True)
            for c in range(n):
                difference = later[c] - force[c]
                if difference != 0.0:
                    for k in range(2 * n):
                        free[k] += ramp[c, k] * difference
        _friction(q, free, n, gamma, friction, level, command)
        for i in range(count):
            state[i, ACCELERATION] = (free[n + motors[i]] - q[n + motors[i]]) / h
        for k in range(2 * n):
            q[k] = free[k]
    return slot


@compiled
def sample(
    q: Float64, rest: float, motors: Int64, command: Float64, state: Float64, noise: Float64, out: Int64
) -> None:  # pragma: no cover - compiled
    """What the drives report ``rest`` seconds after the last sub-step.

    Columns of ``out``: counts (32 bits, wrapped), counts per second, torque in thousandths of rated,
    all with the drive's own sign; then counts in the plant's sign, not wrapped. ``noise`` holds
    position noise in counts and torque noise in thousandths.
    """
    n = q.shape[0] // 2
    for i in range(motors.shape[0]):
        row = command[i]
        a = motors[i]
        sign = row[DIRECTION]
        velocity = q[n + a] + state[i, ACCELERATION] * rest
        angle = q[a] + (q[n + a] + 0.5 * state[i, ACCELERATION] * rest) * rest
        if row[STUCK] == 0.0:
            seen = row[ENCODER_SIGN] * (angle + row[ECCENTRICITY] * math.sin(angle + row[ECCENTRICITY_PHASE]))
            velocity *= row[ENCODER_SIGN]
        else:
            seen, velocity = row[STUCK_AT], 0.0
        counts = math.floor((seen + row[ENCODER_OFFSET]) * row[COUNTS_PER_UNIT] + noise[i, 0] + 0.5)
        counts = min(max(counts, -9e18), 9e18)
        out[i, 3] = int(counts)
        wrapped = (int(sign) * int(counts)) & 0xFFFFFFFF
        out[i, 0] = wrapped - 0x100000000 if wrapped >= 0x80000000 else wrapped
        speed = math.floor(sign * velocity * row[COUNTS_PER_UNIT] + 0.5)
        out[i, 1] = int(min(max(speed, -2147483648.0), 2147483647.0))
        permille = sign * state[i, RECORDED] / row[RATED] * 1000.0 + noise[i, 1]
        permille = math.floor(permille / row[TORQUE_STEPS] + 0.5) * row[TORQUE_STEPS]
        out[i, 2] = int(min(max(permille, -32768.0), 32767.0))


@compiled
def advance_and_sample(
    rest: float, noise: Float64, out: Int64, *march: Any
) -> int:  # pragma: no cover - compiled
    """``advance`` and ``sample`` in one call: the crossing into compiled code costs as much as a step."""
    slot = advance(*march)
    sample(march[0], rest, march[6], march[7], march[8], noise, out)
    return slot


def empty_tables(motors: int) -> tuple[Float64, Float64]:
    """Command and state tables of ``motors`` drives that do nothing and distort nothing."""
    command = np.zeros((motors, COMMAND_COLUMNS))
    command[
        :, [TORQUE_GAIN, LAG, HIDDEN_LAG, ENCODER_SIGN, COUNTS_PER_UNIT, RATED, TORQUE_STEPS, DIRECTION]
    ] = 1.0
    command[:, [LIMIT, SATURATION]] = np.inf
    return command, np.zeros((motors, STATE_COLUMNS))
