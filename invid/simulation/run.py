"""The model's response to a recorded excitation, as a recording."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from invid.effects.elements import Law
from invid.errors import InputError
from invid.model.document import Model
from invid.model.matrices import Matrices, damper, mass, spring
from invid.numerics.arrays import Float64
from invid.recording.model import Experiment, Recording
from invid.recording.still_axes import moving_part
from invid.signals.plausibility import check_units
from invid.simulation.kernel import march
from invid.simulation.laws import CompiledLaws, Laws, compiled_laws, laws_of, static_table
from invid.simulation.plant import Step, discretise, matrices
from invid.simulation.replay import Drive, drift_torque, drive
from invid.simulation.rigid import simulate_motion, time_offsets

_DRIFT_PIECES = 200  # a drifting parameter is constant within 1/200 of the record
_START_ROUNDS = 3
_DRIFT_ROUNDS = 3
_TABLE_ROUNDS = 4
"""Tables of static laws made again with twice the range that the motion reached; one round is usual."""
_DIVERGED = 1e6  # times the measured motion: no wrong parameter does that, only a growing oscillation
_START_SAMPLES = 2000
_START_PRIOR = 1e-3
"""Weight of the guessed initial state against the measured motion: it decides only states that no motor
shows."""


def simulate(
    model: Model,
    recording: Recording,
    *,
    rng: np.random.Generator | None = None,
    only: Collection[str] | None = None,
) -> Recording:
    """Time-domain answer of ``model``, effects included, to the torques of ``recording``.

    The linear part is exact; force laws act once per sub-step (see ``laws``). How the loop is closed
    and the rigid drift kept out is in ``replay``. The initial state is fitted to the measured motion,
    so that records from rest and in steady state both start without a transient of the simulation's own.
    ``model.fit["time_offset_s"]``, the sampling offset of the torque found by identification, is applied.

    Parameters, result and errors are those of ``invid.simulate``. The order of the axes may differ, and
    axes that stand still throughout and that the model does not have are left out; the clock
    of effects that change with time is the whole recording's, also with ``only`` some of its experiments.
    """
    recording, _ = moving_part(recording, model.axes)
    order = _axis_order(model, recording)
    if model.method == "trajectory":
        moved = simulate_motion(model, recording)
        return replace(
            moved, experiments=tuple(e for e in moved.experiments if only is None or e.key in only)
        )
    laws = laws_of(model.chains, model.effects)
    for i, offset in time_offsets(model).items():
        laws.delay[i] = laws.delay.get(i, 0.0) + offset
    plant = matrices(model.chains, laws)
    rng_of_drops = np.random.default_rng(0) if rng is None else rng
    origin = min(float(e.time[0]) for e in recording.experiments) if recording.experiments else 0.0
    simulated = []
    for experiment in recording.experiments:
        if only is not None and experiment.key not in only:
            continue
        answer = _simulate_experiment(_reorder_axes(experiment, order), model, laws, plant, origin)
        answer = _drop_rows(answer, laws.dropped, rng_of_drops)
        simulated.append(_reorder_axes(answer, np.argsort(order)))
    attributes = {**recording.attributes, "simulated_by": "invid simulate", "model_robot": model.robot}
    return replace(recording, experiments=tuple(simulated), attributes=attributes)


def _axis_order(model: Model, recording: Recording) -> np.ndarray:
    if sorted(model.axes) != sorted(recording.axes):
        raise InputError(
            f"{recording.source}: its axes are {list(recording.axes)}, the model's are {list(model.axes)}; "
            "they must have the same names"
        )
    check_units(model, recording)
    return np.array([recording.axes.index(a) for a in model.axes])


def _reorder_axes(experiment: Experiment, order: np.ndarray) -> Experiment:
    if np.array_equal(order, np.arange(order.size)):
        return experiment
    demand, status = experiment.torque_demand, experiment.status
    return replace(
        experiment,
        position=experiment.position[:, order],
        torque=experiment.torque[:, order],
        hold_gain=experiment.hold_gain[order],
        torque_demand=None if demand is None else demand[:, order],
        status=None if status is None else status[:, order],
    )


@dataclass(frozen=True, eq=False)
class _Stretch:
    begin: int  # sub-steps
    end: int
    step: Step


def _simulate_experiment(
    experiment: Experiment, model: Model, laws: Laws, plant: Matrices, origin: float
) -> Experiment:
    chains = model.chains
    fastest = _fastest_motion(plant, laws)
    given = drive(experiment, chains, laws, fastest)
    motors = chains.motor_dofs.astype(np.int64)
    pieces = _stretches(plant, laws, given, motors, origin)
    tables = _Tables(laws, given)

    def answer(start: Float64, added: Float64 | None = None) -> Float64:
        drive_ = given if added is None else replace(given, applied=given.applied + given.refined(added))
        for _ in range(_TABLE_ROUNDS):
            motion, memory = _march_stretches(start, pieces, drive_, tables.made, motors)
            if tables.cover(memory):
                break
        return motion

    state = _rigid_start(given, plant.mass.shape[0], chains.masses_per_branch, motors)
    motion = answer(state)
    with np.errstate(over="ignore", invalid="ignore"):
        free = _free_response(pieces[0].step, given, motors)
    error = _position_error(motion, given)
    for _ in range(_START_ROUNDS):
        trial = state + _start_correction(free, motion, given)
        new_start = answer(trial)
        new_error = _position_error(new_start, given)
        if not new_error < 0.999 * error:
            break
        state, motion, error = trial, new_start, new_error
    drift = np.zeros_like(given.measured)
    for _ in range(_DRIFT_ROUNDS if experiment.frequencies_hz.size else 0):
        added = drift + drift_torque(given.measured - motion[:, :, 0], given, chains, experiment)
        if not np.isfinite(added).all():  # it has run away; said below
            break
        new_start = answer(state, added)
        new_error = _position_error(new_start, given)
        if not new_error < 0.99 * error:
            break
        drift, motion, error = added, new_start, new_error
    size = float(np.sum(given.measured**2))
    if not np.isfinite(error) or 0 < _DIVERGED**2 * size < error:
        raise InputError(
            f"experiment {experiment.key}: the simulated motion leaves the measured one a million times "
            "behind; a mass is far too small or an effect feeds energy in (check the model's values and "
            "signs)"
        )
    extra = drift + state[2 * plant.mass.shape[0] :]
    return _to_experiment(experiment, motion, given, laws, extra)


class _Tables:
    """Laws and tables for the kernel, those of static laws over twice the range that the motion reaches."""

    def __init__(self, laws: Laws, given: Drive) -> None:
        self._laws = laws
        speed, size = (float(np.abs(x).max()) for x in (given.rate, given.measured))
        self._reach = [(2.0 * max(size, 1e-300), 2.0 * max(speed, 1e-300))] * len(laws.static)
        self.made = self._build()

    def _build(self) -> CompiledLaws:
        static, tables = static_table(self._laws.static, self._reach)
        return compiled_laws([*self._laws.forces, *static], tables)

    def cover(self, memory: Float64) -> bool:
        """Return whether the motion stayed within the tables and used most of them; else they are
        computed anew.
        """
        reached = memory[len(self._laws.forces) :, :2]
        if not np.isfinite(reached).all():
            return True
        most = np.array(self._reach).reshape(-1, 2)
        good = ((0.1 * most <= reached) & (reached <= most)) | (reached == 0.0)
        unread = [(x.over == "velocity", x.over == "position") for x in self._laws.static]
        if (good | np.array(unread, dtype=bool).reshape(-1, 2)).all():
            return True
        self._reach = [(float(q), float(v)) for q, v in np.where(good, most, 2.0 * reached)]
        self.made = self._build()
        return False


def _march_stretches(
    start: Float64,
    pieces: list[_Stretch],
    given: Drive,
    laws: CompiledLaws,
    motors: np.ndarray,
) -> tuple[Float64, Float64]:
    """(n, M, 2) motion of the motors and what the laws remember (E, 3)."""
    every, states = given.substeps, start.size - motors.size
    state, applied = start[:states].copy(), given.applied + start[states:]
    memory = laws[3]
    for e, (law, a, b) in enumerate(laws[0].astype(int)):
        place, rate = (x[a] - (x[b] if b >= 0 else 0.0) for x in np.split(state, 2))
        memory[e] = place if law in (Law.SLIDER, Law.PAIR_SLIDER) else 0.0, 0.0, rate
    motion = np.zeros((given.time.size, motors.size, 2))
    for piece in pieces:
        part = np.zeros(((piece.end - piece.begin) // every + 1, motors.size, 2))
        torque = np.ascontiguousarray(applied[piece.begin : piece.end + 1])
        march(state, piece.step.compiled, laws, torque, motors, every, part)
        motion[piece.begin // every : piece.end // every + 1] = part
    return motion, memory


def _stretches(
    plant: Matrices, laws: Laws, given: Drive, motors: np.ndarray, origin: float
) -> list[_Stretch]:
    """Stretches of constant parameters; borders lie on samples."""
    samples = given.time.size
    borders = {0, samples - 1}
    for load in laws.payloads:
        borders.add(int(np.clip(np.searchsorted(given.time, load.time), 0, samples - 1)))
    if laws.drifts:
        borders |= {int(b) for b in np.linspace(0, samples - 1, min(_DRIFT_PIECES, samples - 1) + 1)}
    pieces = []
    edges = sorted(borders)
    for begin, end in pairwise(edges):
        middle = 0.5 * (given.time[begin] + given.time[end]) - origin
        parts = [mass(load.mass, load.at) for load in laws.payloads if given.time[begin] >= load.time]
        for d in laws.drifts:
            parts.append(mass(d.rate * middle, d.a) if d.b < 0 else spring(d.rate * middle, d.a, d.b))
        for at, k, c in zip(motors.tolist(), given.stiffness, given.damping, strict=True):
            parts += [spring(k, at), damper(c, at)]
        now = plant.plus(parts)
        if np.linalg.eigvalsh(now.mass)[0] <= 0:
            raise InputError("simulation: payload or drift makes the mass matrix not positive definite")
        step = discretise(now, given.step)
        pieces.append(_Stretch(begin * given.substeps, end * given.substeps, step))
    return pieces


def _fastest_motion(plant: Matrices, laws: Laws) -> float:
    """Fastest angular frequency of force laws [rad/s]."""
    stiff = max((f.parameters[0] / plant.mass[f.a, f.a] for f in laws.forces if f.law in (2, 7)), default=0.0)
    return float(np.hypot(plant.natural[-1], np.sqrt(stiff)))


def _rigid_start(given: Drive, size: int, masses: tuple[int, ...], motors: np.ndarray) -> Float64:
    """All masses of a branch where its motor is, moving as it does; behind them constant torques, 0."""
    state = np.zeros(2 * size + motors.size)
    for i, count in enumerate(masses):
        at = slice(int(motors[i]), int(motors[i]) + count)
        state[at] = given.measured[0, i]
        state[size + at.start : size + at.stop] = given.rate[0, i]
    return state


def _free_response(step: Step, given: Drive, motors: np.ndarray) -> tuple[np.ndarray, Float64]:
    """Samples and motor motion (K, M, 2n + M) there for a unit of each initial state and constant torque."""
    samples = given.time.size
    stride = max(1, samples // _START_SAMPLES)
    states, count = step.transition.shape[0], motors.size
    whole = np.eye(states + count)
    whole[:states, :states] = step.transition
    whole[:states, states:] = step.held[:, motors]
    jump = np.linalg.matrix_power(whole, given.substeps * stride)
    points = (samples - 1) // stride + 1
    response = np.zeros((points, count, jump.shape[0]))
    power = np.eye(jump.shape[0])
    for k in range(points):
        response[k] = power[motors]
        power = jump @ power
    return np.arange(points) * stride, response


def _start_correction(free: tuple[np.ndarray, Float64], motion: Float64, given: Drive) -> Float64:
    """Change of initial state and constant torques that brings the simulated motion closest to the
    measured one."""
    at, response = free
    missing = (given.measured - motion[:, :, 0])[at].ravel()
    basis = response.reshape(missing.size, -1)
    if not (np.isfinite(basis).all() and np.abs(basis).max() < 1e100):
        return np.zeros(basis.shape[1])  # an unstable plant: no start is better than another
    scale = np.linalg.norm(basis, axis=0)
    scale[scale == 0] = 1.0
    normal = (basis / scale).T @ (basis / scale) + _START_PRIOR**2 * np.eye(scale.size)
    change: Float64 = np.linalg.solve(normal, (basis / scale).T @ missing) / scale
    return change


def _position_error(motion: Float64, given: Drive) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        value = float(np.sum((motion[:, :, 0] - given.measured) ** 2))
    return value if np.isfinite(value) else np.inf


def _to_experiment(
    experiment: Experiment, motion: Float64, given: Drive, laws: Laws, extra: Float64
) -> Experiment:
    theta, rate = motion[:, :, 0], motion[:, :, 1]
    tie = extra - given.stiffness * (theta - given.measured) - given.damping * (rate - given.rate)
    for i, gain in laws.gain.items():
        tie[:, i] /= gain if gain != 0 else 1.0
    if experiment.samples == given.time.size and np.allclose(
        experiment.time, given.time, rtol=0, atol=1e-3 * given.step
    ):
        position, torque = theta.copy(), experiment.torque + tie
    else:
        position = CubicHermiteSpline(given.time, theta, rate)(experiment.time)
        torque = experiment.torque + np.stack(
            [np.interp(experiment.time, given.time, column) for column in tie.T], axis=1
        )
    for i, errors in laws.eccentricity.items():
        true = position[:, i].copy()
        for amplitude, phase in errors:
            position[:, i] += amplitude * np.sin(true + phase)
    return replace(experiment, position=position, torque=torque)


def _drop_rows(experiment: Experiment, fraction: float, rng: np.random.Generator) -> Experiment:
    if fraction == 0:
        return experiment
    kept = rng.uniform(size=experiment.samples) >= fraction
    kept[0] = True
    source = np.maximum.accumulate(np.where(kept, np.arange(experiment.samples), 0))
    return replace(experiment, position=experiment.position[source], torque=experiment.torque[source])
