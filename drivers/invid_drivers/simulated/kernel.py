"""The simulated drives' own loops around the plant's sub-step, compiled, and what they measure."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from invid.numerics.arrays import Float64, Int64
from invid.numerics.compiled import compiled
from invid.simulation.kernel import advance

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
    return command, np.zeros((motors, STATE_COLUMNS))
