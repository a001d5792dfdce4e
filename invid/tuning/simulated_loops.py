"""A model with all its effects under the loops of its drives: a move there and back, and how well it is made.

The plant is that of ``invid simulate`` (exact linear steps, force laws once a sub-step), the loops are
those of ``servo_loop``; nothing here is linear that the model says is not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import control
import numpy as np

from invid.exchange.linear_plant import LinearPlant, linear_plant
from invid.model.document import Model
from invid.numerics.arrays import Float64
from invid.simulation.kernel import march
from invid.simulation.laws import compiled_laws, laws_of, static_table
from invid.simulation.plant import discretise, matrices
from invid.tuning.axis_loop import AxisLoop
from invid.tuning.closed_loop import speed_controller
from invid.tuning.margins import held_modes
from invid.tuning.servo_loop import DriveTiming

FINENESS = 0.25
"""Largest angle [rad] of the fastest mode in a sub-step."""
DISTANCE = {False: 0.1, True: 0.01}
"""Length of the move of a rotary [rad] and of a linear axis [m]."""
PERIODS = 3.0
"""Duration of the move, and of the rest after it, in periods of the lowest mode of a load."""
RIGID_S = 1.0
"""Duration of the move where nothing swings [s]."""
LEAST_CYCLES = 200
"""Of the drive in the move: a faster one shows its sampling."""
BAND = 0.01
"""An axis has settled where it stays within this share of the move."""


@dataclass(frozen=True, eq=False)
class Command:
    """A commanded motion: ``position``, ``velocity``, ``acceleration`` (n, M); the first move is over
    at the sample ``arrived``, the next begins at ``leaves``."""

    position: Float64
    velocity: Float64
    acceleration: Float64
    arrived: int
    leaves: int


@dataclass(frozen=True, eq=False)
class LoopRun:
    """A simulated move: ``time`` (n,) [s]; command as shaped, motor and load (n, M)."""

    time: Float64
    command: Float64
    motor: Float64
    load: Float64
    torque: Float64


@dataclass(frozen=True)
class MoveFigures:
    """How well one axis moved: ``following`` rms of command minus motor and ``at_load`` rms of
    command minus load [rad or m], command as shaped; ``settling`` [s] of the load after the command stands,
    NaN where it does not settle in the rest; ``overshoot`` of the load as a share of the move."""

    following: float
    at_load: float
    settling: float
    overshoot: float


def reference_move(
    plant: LinearPlant, timing: DriveTiming, hardest: Mapping[int, float] | None = None
) -> Command:
    """All axes there and back at minimum jerk (Flash and Hogan 1985), each followed by a rest as long.

    ``hardest`` [rad/s² or m/s²] bounds the acceleration of an axis: it then moves less far.
    """
    loads = held_modes(plant, range(len(plant.motors)))
    duration = PERIODS * 2 * np.pi / float(loads[0]) if loads.size else RIGID_S
    duration = max(duration, LEAST_CYCLES * timing.cycle)
    n = int(np.ceil(duration / timing.cycle))
    x = np.arange(n) / n
    step = np.array(
        [x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2, 60 * x * (1 - x) * (1 - 2 * x)]
    )
    step /= np.array([1.0, n * timing.cycle, (n * timing.cycle) ** 2])[:, None]
    rest = np.zeros((3, n))
    there = rest.copy()
    there[0] = 1.0
    whole = np.hstack([step, there, -step, rest])
    whole[0, 2 * n : 3 * n] += 1.0
    distance = np.full(len(plant.motors), DISTANCE[plant.linear_axes])
    for i, most in (hardest or {}).items():
        distance[i] = min(distance[i], most / float(np.abs(step[2]).max()))
    p, v, a = (row[:, None] * distance for row in whole)
    return Command(p, v, a, n, 2 * n)


def run_loops(
    model: Model,
    loops: Sequence[AxisLoop],
    command: Command,
    timing: DriveTiming,
    counts: Float64 | None = None,
    added: Float64 | None = None,
) -> LoopRun:
    """Simulate ``command`` on ``model``; values that have run away are NaN from then on.

    ``counts`` (M,) are those of the encoders [rad or m], NaN: ideal; ``added`` (n, M) torque that the drives
    are told to add to that of their loops.
    """
    count_of = np.zeros(len(loops)) if counts is None else np.nan_to_num(counts)
    coarse = np.where(count_of > 0, count_of, 1.0)
    laws = laws_of(model.chains, model.effects)
    made = matrices(model.chains, laws)
    motors = model.chains.motor_dofs.astype(np.int64)
    ends = model.chains.end_dofs
    substeps = max(4, int(np.ceil(timing.cycle * made.natural[-1] / FINENESS)))
    step = discretise(made, timing.cycle / substeps).compiled
    n, count = command.position.shape
    reach = (4.0 * float(np.abs(command.position).max()), 4.0 * float(np.abs(command.velocity).max()))
    if added is not None:
        free = np.cumsum(added, axis=0) * timing.cycle / made.mass[motors, motors]
        speed = 4.0 * float(np.ptp(free, axis=0).max())
        reach = (max(reach[0], speed), max(reach[1], speed))
    static, tables = static_table(laws.static, [reach] * len(laws.static))
    forces = compiled_laws([*laws.forces, *static], tables)
    plant = linear_plant(model)
    drives = _Drives(loops, command, timing, plant, added)
    decay = np.exp(-timing.cycle / substeps / np.maximum(plant.lag, 1e-12))
    limit = np.array([laws.limit.get(i, np.inf) for i in range(count)])
    state = np.zeros(2 * made.mass.shape[0])
    acting = np.zeros(count)
    out = np.zeros((2, count, 2))
    motor, load, torque = (np.full((n, count), np.nan) for _ in range(3))
    applied = np.zeros((substeps + 1, count))
    for k in range(n):
        motor[k], load[k] = state[motors], state[ends]
        if not np.abs(motor[k]).max() < 1e3 * reach[0]:
            break
        shown = np.where(count_of > 0, np.round(motor[k] / coarse) * coarse, motor[k])
        torque[k] = drives.torque(k, shown)
        goal = np.clip(plant.gain * torque[k], -limit, limit)
        for j in range(substeps + 1):
            applied[j] = goal + (acting - goal) * decay**j
        acting = applied[-1].copy()
        march(state, step, forces, applied, motors, substeps, out)
    return LoopRun(np.arange(n, dtype=float) * timing.cycle, drives.shaped[0], motor, load, torque)


class _Drives:
    """The sampled loops of all axes at once, with what they remember."""

    def __init__(
        self,
        loops: Sequence[AxisLoop],
        command: Command,
        timing: DriveTiming,
        plant: LinearPlant,
        added: Float64 | None,
    ) -> None:
        t = timing.cycle
        given = np.stack([command.position, command.velocity, command.acceleration])
        self.shaped = given.copy()
        for i, loop in enumerate(loops):
            if loop.shaper is not None:
                for row in self.shaped:
                    row[:, i] = loop.shaper.shape(row[:, i], t)
        self._forward = np.stack(
            [loop.feedforward.torque(*self.shaped[:, :, i]) for i, loop in enumerate(loops)], axis=1
        )
        if added is not None:
            self._forward = self._forward + added
        late = [timing.cycles(d) for d in plant.delay]
        for row, cycles in zip(self._forward.T, late, strict=True):
            row[:] = np.concatenate([np.zeros(cycles), row[: row.size - cycles]])
        self._position = np.array([loop.gains.position_gain for loop in loops])
        self._law = control.append(
            *(speed_controller(loop.gains, timing, c) for loop, c in zip(loops, late, strict=True))
        )
        self._state, self._last = np.zeros(self._law.nstates), np.zeros(len(loops))
        self._cycle = timing.cycle

    def torque(self, k: int, position: Float64) -> Float64:
        """(M,) torque that acts from this cycle on."""
        velocity = (position - self._last) / self._cycle
        self._last = position
        missed = self._position * (self.shaped[0, k] - position) + self.shaped[1, k] - velocity
        torque = self._law.C @ self._state + self._law.D @ missed + self._forward[k]
        self._state = self._law.A @ self._state + self._law.B @ missed
        return np.asarray(torque, dtype=float)


def settling_times(error: Float64, command: Command, axis: int, cycle: float) -> Float64:
    """(D,) [s] after the first move until command less motion (D, n) stays within ``BAND`` of the move; NaN
    where it does not in the rest."""
    most = BAND * abs(float(command.position[command.arrived, axis]))
    away = ~(np.abs(error[:, command.arrived : command.leaves]) <= most)
    late = away.shape[1] - np.argmax(away[:, ::-1], axis=1)
    settled = np.where(away.any(axis=1), late * cycle, 0.0)
    return np.where(away[:, -1], np.nan, settled)


def move_figures(run: LoopRun, command: Command) -> tuple[MoveFigures, ...]:
    """How well each axis made ``reference_move``."""
    rest, cycle = slice(command.arrived, command.leaves), float(run.time[1] - run.time[0])
    goal = command.position[command.arrived]
    following, at_load = (np.sqrt(((run.command - x) ** 2).mean(axis=0)) for x in (run.motor, run.load))
    overshoot = ((run.load[rest] - goal) / goal).max(axis=0)
    return tuple(
        MoveFigures(
            float(following[i]),
            float(at_load[i]),
            float(settling_times((command.position - run.load)[None, :, i], command, i, cycle)[0]),
            max(0.0, float(overshoot[i])),
        )
        for i in range(goal.size)
    )
