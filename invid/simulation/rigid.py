"""Simulation of a rigid (or grounded) model: in closed loop where the controller is known, else by its
torque.

A controller that the recording describes (``controller``, ``position_reference``) is simulated as the digital
law it is. The record itself says what the law's velocity is: the difference over so many of its own samples
as reproduces the recorded torque best from the recorded positions.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.interpolate import CubicSpline

from invid.effects.elements import (
    AddedDamper,
    CarriedWeight,
    ForceLaw,
    GroundSpring,
    Law,
    LoadFriction,
    StaticLaw,
    TorqueChannel,
)
from invid.errors import InputError
from invid.model.document import Model
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.model import Experiment, Recording
from invid.signals.motion_record import derivative
from invid.signals.timebase import resample_uniformly
from invid.simulation.laws import elements_of, static_table
from invid.simulation.rigid_kernel import march

SUBSTEPS = 10
"""Sub-steps between samples; leapfrog at a tenth of a sample is right to 1e-4 of a period up to a fifth of
the sample rate."""
_LONGEST_SPAN = 8
"""Samples that a controller's velocity may span: longer ones would not damp its own loop."""
_START_SAMPLES = 300
_MOST_LAW_ERROR = 0.2
"""Error of the torque, over the recorded one, above which a law is not the one that ran (empirical: measured
closed-loop benches reproduce theirs within 3 %)."""


@dataclass(frozen=True, eq=False)
class Loop:
    """The controllers of one experiment: rows of ``march``'s ``law`` and what they follow."""

    law: Float64
    reference: Float64
    feedforward: Float64


def closed_loop(experiment: Experiment) -> Loop | None:
    """The experiment's own controllers, where every axis has a known one; ``None`` otherwise."""
    text = experiment.attributes.get("controller")
    if not isinstance(text, str) or experiment.position_reference is None:
        return None
    try:
        laws = json.loads(text)
    except ValueError:
        return None
    axes = experiment.position.shape[1]
    if not isinstance(laws, list) or len(laws) != axes or not all(isinstance(x, dict) for x in laws):
        return None
    step = float(np.median(np.diff(experiment.time)))
    reference = np.asarray(experiment.position_reference, dtype=float)
    extra = experiment.torque_feedforward
    feedforward = np.zeros_like(reference) if extra is None else np.asarray(extra, dtype=float)
    law = np.zeros((axes, 6))
    for i, one in enumerate(laws):
        try:
            stiffness, damping = float(one["stiffness"]), float(one["damping"])
            limit = float(one["limit"]) if one.get("limit") is not None else np.inf
        except (KeyError, TypeError, ValueError):
            return None
        q, commands = experiment.position[:, i], experiment.torque[:, i]
        errors = []
        for span in range(1, _LONGEST_SPAN + 1):
            rate = (q[span:] - q[:-span]) / (span * step)
            command = stiffness * (reference[span:, i] - q[span:]) - damping * rate + feedforward[span:, i]
            errors.append(_rms(np.clip(command, -limit, limit) - commands[span:]))
        best = int(np.argmin(errors))
        if errors[best] > _MOST_LAW_ERROR * _rms(commands):
            return None
        law[i] = 1.0, stiffness, damping, limit, best + 1, 0.0
    return Loop(law, reference, feedforward)


def simulate_motion(model: Model, recording: Recording) -> Recording:
    """The model's motion (and the torque of closed loops) beside the recorded one, experiment by experiment.

    ``position`` is the model's answer to the recorded torque, or in closed loop to the reference, and then
    ``torque`` is what the controller asked for. A free axis without a known controller is tied to the
    measured motion by a spring as slow as the motion itself, because the recorded torque alone does not hold
    it in place; ``torque`` contains the tie.

    Raises
    ------
    InputError
        Axes that do not match, an effect that a rigid model cannot have, motion that diverges.
    """
    if model.axes != recording.axes:
        raise InputError(
            f"{recording.source}: its axes are {list(recording.axes)}, the model's are {list(model.axes)}; "
            f"they must be the same"
        )
    simulated = [_simulate_experiment(model, e) for e in recording.experiments]
    attributes = {**recording.attributes, "simulated_by": "invid simulate", "model_robot": model.robot}
    return replace(recording, experiments=tuple(simulated), attributes=attributes)


def _simulate_experiment(model: Model, experiment: Experiment) -> Experiment:
    even = resample_uniformly(experiment)
    axes, count = even.position.shape[1], even.samples
    laws = _rigid_laws(model)
    # (M,) by which the torque acts later than recorded [s]
    offsets = time_offsets(model)
    delay = np.array(
        [offsets.get(i, 0.0) + sum(c.delay for c in laws.channels if c.axis == i) for i in range(axes)]
    )
    loop = closed_loop(experiment) if even.samples == experiment.samples else None
    fine_grid = np.arange(count * SUBSTEPS) / SUBSTEPS * even.step
    instants = np.arange(count) * even.step
    if loop is not None:
        law, reference = loop.law.copy(), loop.reference
        # A command held over the sample lags by half of it on the mean: what is more comes before it acts.
        more = np.clip(np.rint((delay / even.step - 0.5) * SUBSTEPS), 0, SUBSTEPS)
        law[:, 5] = more
        applied = np.repeat(loop.feedforward, SUBSTEPS, axis=0)
    else:
        law, reference = np.zeros((axes, 6)), np.asarray(even.position)
        torque = CubicSpline(instants, even.torque)
        applied = np.stack(
            [torque(np.clip(fine_grid - d, 0.0, instants[-1]))[:, i] for i, d in enumerate(delay)], axis=1
        )
        if not np.all(model.chains.ground_springs > 0):
            law, applied = _tie_to_measurement(model, even.position, even.step, applied[::SUBSTEPS])
    law[:, 4] = np.maximum(law[:, 4], 1.0)
    rate = derivative(np.asarray(even.position), even.step, 0.1 / even.step, 1)
    state = np.stack([even.position[0], rate[0]])
    static, tables = laws.tables(np.asarray(even.position), rate)
    mass = np.array(model.chains.mass_matrix)
    applied, reference = np.ascontiguousarray(applied), np.ascontiguousarray(reference)

    def run(start: Float64, samples: int) -> tuple[Float64, Float64]:
        out, acted_torque = np.zeros((samples, axes)), np.zeros((samples, axes))
        with np.errstate(over="ignore", invalid="ignore"):
            march(
                start.copy(), applied, reference, law, mass, laws.carried, laws.smooth, laws.dry, static,
                tables, even.step / SUBSTEPS, SUBSTEPS, out, acted_torque,
            )  # fmt: skip
        return out, acted_torque

    out, acted_torque = run(_fit_start(state, np.asarray(even.position), even.step, run), count)
    if not np.isfinite(out).all() or np.abs(out).max() > 1e6 * max(np.abs(even.position).max(), 1e-300):
        raise InputError(
            f"experiment {experiment.key}: the simulated motion runs away; a mass is far too small or an "
            f"effect feeds energy in (check the model's values and signs)"
        )
    if count != experiment.samples or not np.allclose(instants, experiment.time - experiment.time[0]):
        at = experiment.time - experiment.time[0]
        out = np.stack([np.interp(at, instants, column) for column in out.T], axis=1)
        acted_torque = np.stack([np.interp(at, instants, column) for column in acted_torque.T], axis=1)
    torque_out = experiment.torque if not law[:, 0].any() else frozen_float(acted_torque)
    return replace(experiment, position=frozen_float(out), torque=torque_out)


def _fit_start(
    state: Float64, measured: Float64, step: float, run: Callable[[Float64, int], tuple[Float64, Float64]]
) -> Float64:
    """Position and velocity at the first sample, fitted to the first samples that follow.

    A derivative at the end of a record is poor, and a start that is off rings for as long as the damping lets
    it. Gauss–Newton with differences; a step that does not help is not taken.
    """
    samples = min(_START_SAMPLES, measured.shape[0])
    informative = measured[:samples]
    spread = np.maximum(informative.std(axis=0), 1e-12 * np.abs(informative).max() + 1e-300)
    small = 1e-3 * np.stack([spread, spread / (samples * step)])
    miss = informative - run(state, samples)[0]
    for _ in range(3):
        columns = []
        for place in np.ndindex(state.shape):
            shifted = state.copy()
            shifted[place] += small[place]
            columns.append(((run(shifted, samples)[0] - informative + miss) / small[place]).ravel())
        basis = np.stack(columns, axis=1)
        if not (np.isfinite(basis).all() and np.isfinite(miss).all()):
            return state
        scale = np.maximum(np.linalg.norm(basis, axis=0), 1e-300)
        change = np.linalg.lstsq(basis / scale, miss.ravel(), rcond=1e-6)[0] / scale
        trial = state + change.reshape(state.shape)
        new_residual = informative - run(trial, samples)[0]
        if not _rms(new_residual) < 0.999 * _rms(miss):
            return state
        state, miss = trial, new_residual
    return state


def _tie_to_measurement(
    model: Model, position: Float64, step: float, torque: Float64
) -> tuple[Float64, Float64]:
    """A slow spring and damper to the measured motion: controller rows and the torque that goes with them."""
    axes = position.shape[1]
    law = np.zeros((axes, 6))
    velocity = derivative(np.asarray(position), step, 0.1 / step, 1)
    mass = np.diag(model.chains.mass_matrix)
    for i in range(axes):
        spread = float(position[:, i].std())
        # The frequency of a sine of this size and speed: the motion's own.
        natural = float(velocity[:, i].std()) / spread if spread > 0 else 0.1 / (position.shape[0] * step)
        stiffness = float(mass[i]) * natural**2
        law[i] = 1.0, stiffness, 1.4 * float(mass[i]) * natural, np.inf, 1.0, 0.0
    applied = torque + law[:, 2] * velocity
    return law, np.repeat(applied, SUBSTEPS, axis=0)


def time_offsets(model: Model) -> dict[int, float]:
    """Sampling offsets of the torque that the identification reports [s]: acts later where positive."""
    reported = model.fit.get("time_offset_s")
    if not isinstance(reported, Mapping):
        return {}
    found = {}
    for i, axis in enumerate(model.axes):
        entry = reported.get(f"{axis}.time_offset")
        value = entry.get("value") if isinstance(entry, Mapping) else entry
        if isinstance(value, int | float) and np.isfinite(value):
            found[i] = float(value)
    return found


@dataclass(frozen=True, eq=False)
class RigidLaws:
    """Parameters of ``march``; static laws and torque channels of the axes."""

    smooth: Float64
    dry: Float64
    carried: Float64
    static: tuple[StaticLaw, ...]
    channels: tuple[TorqueChannel, ...]

    def tables(self, position: Float64, velocity: Float64) -> tuple[Float64, Float64]:
        """(S, 4) and (S, P) of ``march``, over twice the range of the motion (n, M)."""
        most = [np.maximum(2.0 * np.abs(x).max(axis=0), 1e-300) for x in (position, velocity)]
        reach = [(float(most[0][x.a]), float(most[1][x.a])) for x in self.static]
        made, tables = static_table(self.static, reach)
        rows = np.array([[f.a, *f.parameters[:3]] for f in made]).reshape(-1, 4)
        return rows, tables


def _rigid_laws(model: Model) -> RigidLaws:
    axes = len(model.axes)
    smooth, dry, carried = np.zeros((axes, 6)), np.zeros((axes, 10)), _carried_inertia(model)
    smooth[:, 0] = model.chains.ground_springs
    dry[:, 7] = 2.0
    static: list[StaticLaw] = []
    channels: list[TorqueChannel] = []
    for term in model.effects:
        for element in elements_of(model.chains, term, rigid=True):
            match element:
                case GroundSpring(axis, power, coefficient) if power in (2, 3):
                    smooth[axis, power - 1] += coefficient
                case ForceLaw(Law.CONSTANT, axis, _, parameters):
                    smooth[axis, 3] += parameters[0]
                case ForceLaw(Law.SINE, axis, _, (size, 1.0, angle)):
                    smooth[axis, 4:] += size * np.cos(angle), size * np.sin(angle)
                case ForceLaw(Law.SINE, axis, _, ripple):
                    static.append(StaticLaw("position", partial(_sinusoid, ripple), axis))
                case CarriedWeight(sine, cosine):
                    carried[2:4] += sine, cosine
                    carried[4] = 1.0
                case ForceLaw(Law.DRY, axis, _, (up, down, excess_up, velocity, excess_down, exponent)):
                    dry[axis, :2] += up, down
                    if excess_up or excess_down:
                        dry[axis, 4:7] += excess_up, excess_down, velocity
                        dry[axis, 7] += exponent - 2.0
                case ForceLaw(Law.ONE_SIDED_VISCOUS, axis, _, parameters):
                    dry[axis, 2:4] += parameters
                case AddedDamper(axis, -1, coefficient):
                    dry[axis, 2:4] += coefficient
                case LoadFriction(axis, coefficient, with_inertia):
                    dry[axis, 8:] += coefficient, with_inertia
                case StaticLaw(b=-1):
                    static.append(element)
                case TorqueChannel(gain=1.0, lag=None, limit=None):
                    channels.append(element)
                case _:
                    raise InputError(f"effect {term.cause} on {term.axis}: a rigid model has no place for it")
    return RigidLaws(smooth, dry, carried, tuple(static), tuple(channels))


def _carried_inertia(model: Model) -> Float64:
    """(5,) of ``march``, with the inertia that varies with the second angle, where the model has one."""
    carried, inertia = np.zeros(5), model.fit.get("inertia_with_angle")
    if isinstance(inertia, Mapping) and len(model.axes) == 2:
        carried[:2] = [float(inertia[k]["value"]) for k in ("cosine", "sine")]
        carried[4] = 1.0
    return carried


def _sinusoid(ripple: tuple[float, ...], position: Float64) -> Float64:
    """(n,) torque of a ripple's size, cycles a revolution and phase."""
    size, cycles, phase = ripple
    out: Float64 = size * np.sin(cycles * position + phase)
    return out


def _rms(values: Float64) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else 0.0
