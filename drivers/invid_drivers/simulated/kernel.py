"""The simulated drives' own loops around the plant's sub-step, compiled, and what they measure."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from invid.numerics.arrays import Float64, Int64
from invid.numerics.compiled import compiled
from invid.simulation.kernel import advance

# columns of the command table, one row per motor
MODE, TORQUE, POSITION, VELOCITY, DECELERATION, INTERPOLATE, POSITION_GAIN, VELOCITY_GAIN, LIMIT, BRAKE = (
    range(10)
)
# what acts differently from what the drive believes
TORQUE_GAIN, SATURATION, LAG, HIDDEN_LAG, DELAY = range(10, 15)
ENCODER_SIGN, ENCODER_OFFSET, STUCK, STUCK_AT, COUNTS_PER_UNIT, ECCENTRICITY, ECCENTRICITY_PHASE = range(
    15, 22
)
RATED, TORQUE_STEPS, DIRECTION = range(22, 25)
# the rest of the position and velocity loops: 1/T_i, cycle [s], feedforward of speed and acceleration
RESET, CYCLE, FEED_VISCOUS, FEED_INERTIA, NOTCHES = range(25, 30)
NOTCH_COUNT, NOTCH_SIZE = 2, 5
"""Each notch b0, b1, b2, a1, a2 in 1/z."""
COMMAND_COLUMNS = NOTCHES + NOTCH_COUNT * NOTCH_SIZE

MODE_OFF, MODE_TORQUE, MODE_POSITION = 0.0, 1.0, 2.0

# columns of the motor state
RECORDED, LAGGED, ACTING, PREVIOUS, ACCELERATION = range(5)
# what the loops remember: whether they ran, the integral [rad/s], the last reading and commanded speed, time
# since they last ran [s], torque that acts and that waits for its cycle, two numbers a notch
LOOPING, INTEGRAL, SEEN, LED, CLOCK, HELD, WAITING, KEPT = range(5, 13)
STATE_COLUMNS = KEPT + 2 * NOTCH_COUNT


@compiled
def _loops(row: Float64, kept: Float64, seen: float, speed: float, h: float) -> float:  # pragma: no cover
    """Torque of the position and velocity loops, K_v (1 + 1/(T_i s)) (K_p (r − q) + ṙ − v).

    Where they have a cycle, v is the difference of two readings, and the torque, through the notches, acts
    one cycle later and for one; else they run in each sub-step on ``speed``, without notches.
    """
    cycle = row[CYCLE]
    if kept[LOOPING] == 0.0:  # they go on with the torque that acts
        kept[SEEN], kept[LED], kept[CLOCK] = seen, row[VELOCITY], cycle
        kept[HELD] = kept[WAITING] = kept[RECORDED] - row[TORQUE]
        kept[INTEGRAL] = kept[HELD] / row[VELOCITY_GAIN] if row[RESET] > 0.0 else 0.0
        for k in range(NOTCH_COUNT):  # at rest at this torque
            b1, b2 = row[NOTCHES + NOTCH_SIZE * k + 1], row[NOTCHES + NOTCH_SIZE * k + 2]
            a1, a2 = row[NOTCHES + NOTCH_SIZE * k + 3], row[NOTCHES + NOTCH_SIZE * k + 4]
            kept[KEPT + 2 * k] = (b1 + b2 - a1 - a2) * kept[HELD]
            kept[KEPT + 2 * k + 1] = (b2 - a2) * kept[HELD]
    if cycle > 0.0:
        kept[CLOCK] += h
        if kept[CLOCK] < cycle - 1e-9:
            return float(kept[HELD])
        kept[CLOCK] = 0.0
        speed, h = (seen - kept[SEEN]) / cycle, cycle
        kept[SEEN] = seen
    error = row[POSITION_GAIN] * (row[POSITION] - seen) + row[VELOCITY] - speed
    change = h * row[RESET] * error
    torque = row[VELOCITY_GAIN] * (error + kept[INTEGRAL] + change)
    if abs(torque) < row[LIMIT] or torque * change < 0.0:  # at the limit nothing is summed up
        kept[INTEGRAL] += change
    if cycle > 0.0:
        for k in range(NOTCH_COUNT):
            b = NOTCHES + NOTCH_SIZE * k
            out = row[b] * torque + kept[KEPT + 2 * k]
            kept[KEPT + 2 * k] = row[b + 1] * torque - row[b + 3] * out + kept[KEPT + 2 * k + 1]
            kept[KEPT + 2 * k + 1] = row[b + 2] * torque - row[b + 4] * out
            torque = out
    torque += row[FEED_VISCOUS] * row[VELOCITY] + row[FEED_INERTIA] * (row[VELOCITY] - kept[LED]) / h
    kept[LED] = row[VELOCITY]
    if cycle > 0.0:
        kept[HELD], kept[WAITING] = kept[WAITING], torque
        return float(kept[HELD])
    return float(torque)


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
            wanted = _loops(row, state[i], seen, speed, h)
            wanted += row[TORQUE]
            row[POSITION] += row[VELOCITY] * h
            if row[DECELERATION] > 0.0:
                change = row[DECELERATION] * h
                if abs(row[VELOCITY]) <= change:
                    row[VELOCITY] = 0.0
                else:
                    row[VELOCITY] -= math.copysign(change, row[VELOCITY])
            elif row[INTERPOLATE] > 0.0:
                row[INTERPOLATE] -= h
                if row[INTERPOLATE] <= 1e-9:
                    row[INTERPOLATE] = row[VELOCITY] = 0.0
            state[i, PREVIOUS] = wanted
        else:
            state[i, PREVIOUS] = 0.0
        state[i, LOOPING] = 1.0 if mode == MODE_POSITION else 0.0
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
def march(
    q: Float64,
    steps: int,
    h: float,
    step: Any,
    laws: Any,
    motors: Int64,
    command: Float64,
    state: Float64,
    ring: Float64,
    slot: int,
    external: Float64,
    work: Float64,
    blend: float,
) -> int:  # pragma: no cover - compiled
    """Advance ``q`` in place by ``steps`` sub-steps; returns the new slot of the delay ring.

    ``blend`` is the share of the first sub-step that had passed when the commands were last set. ``step``,
    ``laws`` and ``work``: see ``invid.simulation.kernel``; the first laws are the motors' brakes.
    """
    n = external.shape[0]
    count = motors.shape[0]
    for i in range(count):
        laws[1][i, 0] = laws[1][i, 1] = command[i, BRAKE]
    for _ in range(steps):
        slot = (slot + 1) % ring.shape[1]
        _motors(q, n, motors, command, state, ring, slot, h, blend)
        blend = 0.0
        for k in range(n):
            work[1, k] = external[k]
        for i in range(count):
            work[1, motors[i]] += state[i, ACTING]
            state[i, ACCELERATION] = -q[n + motors[i]] / h
        for k in range(n):
            work[2, k] = work[1, k]
        advance(q, work, step, laws)
        for i in range(count):
            state[i, ACCELERATION] += q[n + motors[i]] / h
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
def march_and_sample(
    rest: float, noise: Float64, out: Int64, *given: Any
) -> int:  # pragma: no cover - compiled
    """``march`` and ``sample`` in one call: the crossing into compiled code costs as much as a step."""
    slot = march(*given)
    sample(given[0], rest, given[5], given[6], given[7], noise, out)
    return slot


def empty_tables(motors: int) -> tuple[Float64, Float64]:
    """Command and state tables of ``motors`` drives that do nothing and distort nothing."""
    command = np.zeros((motors, COMMAND_COLUMNS))
    command[
        :, [TORQUE_GAIN, LAG, HIDDEN_LAG, ENCODER_SIGN, COUNTS_PER_UNIT, RATED, TORQUE_STEPS, DIRECTION]
    ] = 1.0
    command[:, [LIMIT, SATURATION]] = np.inf
    command[:, NOTCHES::NOTCH_SIZE] = 1.0
    return command, np.zeros((motors, STATE_COLUMNS))
