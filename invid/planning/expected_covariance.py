"""The expected covariance of every parameter of a plan, before anything moves.

The planned torques, the hold and the believed plant give the motion (``invid.planning.response``); with the
sensors' noise added it goes through the same likelihood as a recording, with the same nuisances (timing,
friction, unknown forces, ends), and its curvature at the believed parameters is the Fisher information.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from invid.config import CellConfig
from invid.identification.fitted_model import chains_covariance
from invid.identification.open_holds import open_masses
from invid.identification.search_start import settled_about
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.model.chains import CoupledChains
from invid.model.document import finite_or_none, parameter_vector
from invid.numerics.arrays import Bool, Float64, frozen_float
from invid.planning.belief import Belief
from invid.planning.model import Plan, PlannedExperiment
from invid.planning.response import foretold_motion, hold_gains
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.signals.holds import read_holds
from invid.signals.record import Record, make_record

COUPLING_SHARE = 0.1
"""A coupling's uncertainty is taken relative to its value, or to this share of √(m_i·m_j) of the masses it
joins where that is more: one per cent of a coupling of zero cannot be reached by anybody."""
UNSEEN = 3.0
"""Relative deviation from which a plan shows nothing of a parameter: the prior speaks (numerical)."""
ASSUMED_TORQUE_NOISE = 0.005
"""Noise of 0x6077 as a share of rated torque where nothing is known (the case of the notes)."""
ASSUMED_COUNTS = 2**17
"""Encoder counts per turn where nothing is known; per metre on a linear axis, 1e6."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Sensors of every axis: (M,) white noise and lattice steps of position and torque."""

    position: Float64
    position_step: Float64
    torque: Float64
    torque_step: Float64
    source: str


@dataclass(frozen=True, eq=False)
class Expected:
    """Expected uncertainty of the structure's parameters.

    Attributes
    ----------
    names, values, std, scale
        (n,) in physical units; ``scale`` is what a relative uncertainty is relative to.
    goal
        (n,) True for the parameters that a goal is about: masses, springs, couplings.
    covariance
        (n, n); infinite where the plan shows nothing.
    """

    names: tuple[str, ...]
    values: Float64
    std: Float64
    scale: Float64
    goal: Bool
    covariance: Float64
    belief: str
    noise: str
    guessed: bool
    facts: dict[str, Any] = field(default_factory=dict)

    @property
    def relative(self) -> Float64:
        """(n,) std over scale."""
        result: Float64 = self.std / self.scale
        return result

    @property
    def worst(self) -> tuple[str, float]:
        """Name and relative standard deviation of the worst parameter of the goal."""
        relative = np.where(self.goal, self.relative, 0.0)
        at = int(np.argmax(np.where(np.isnan(relative), np.inf, relative)))
        return self.names[at], float(relative[at])

    def to_json(self) -> dict[str, Any]:
        """Plain values; ``null`` where the plan shows nothing of a parameter."""
        return {
            "belief": self.belief,
            "guessed": self.guessed,
            "noise": self.noise,
            "worst": {"name": self.worst[0], "relative_std": finite_or_none(self.worst[1])},
            "parameters": [
                {
                    "name": n,
                    "value": float(v),
                    "std": finite_or_none(s),
                    "relative_std": finite_or_none(s / c),
                    "in_goal": bool(g),
                }
                for n, v, s, c, g in zip(
                    self.names, self.values, self.std, self.scale, self.goal, strict=True
                )
            ],
            **self.facts,
        }


def assumed_noise(config: CellConfig) -> Noise:
    """Noise from what the config says of encoders and rated torques; the rest is assumed, and said."""
    count = len(config.axes)
    turn = 1.0 if config.linear else 2 * np.pi
    counts = 1e6 if config.linear else ASSUMED_COUNTS
    step = np.array([a.position_per_count or turn / counts for a in config.axes])
    rated = np.array([a.rated_torque or a.limits.torque for a in config.axes])
    sentences = []
    if any(a.position_per_count is None for a in config.axes):
        sentences.append(f"encoders of {counts:g} counts per {'m' if config.linear else 'turn'}")
    if any(a.rated_torque is None for a in config.axes):
        sentences.append("rated torque as the torque limit")
    sentences.append(f"torque noise {ASSUMED_TORQUE_NOISE:.1%} of rated")
    return Noise(
        np.zeros(count),
        frozen_float(step),
        frozen_float(ASSUMED_TORQUE_NOISE * rated),
        frozen_float(1e-3 * rated),
        "assumed: " + ", ".join(sentences),
    )


def expected(
    config: CellConfig, plan: Plan | Sequence[PlannedExperiment], belief: Belief, noise: Noise
) -> Expected:
    """Expected covariance of a plan's identification: the spectra of noisy motion at the believed parameters.

    The sensors' noise is drawn once: it stands for the noise floor and the lattice that the spectra find in a
    real record, not for an outcome.
    """
    experiments = plan.recorded if isinstance(plan, Plan) else tuple(plan)
    now, _ = fit_about(config, [e for e in experiments if e.role is Role.IDENTIFY], belief, noise)
    names, values = parameter_vector(belief.chains)
    covariance = chains_covariance(now, belief.chains.axes, open_masses(now))[1]
    scale = parameter_scale(belief.chains)
    unseen = ~(np.sqrt(np.maximum(np.diag(covariance), 0.0)) < UNSEEN * scale)
    covariance[unseen] = covariance[:, unseen] = np.inf
    return Expected(
        names=names,
        values=frozen_float(values),
        std=frozen_float(np.sqrt(np.maximum(np.diag(covariance), 0.0))),
        scale=frozen_float(scale),
        goal=is_in_goal(names),
        covariance=frozen_float(covariance),
        belief=belief.source,
        noise=noise.source,
        guessed=belief.guessed,
    )


def fit_about(
    config: CellConfig, experiments: Sequence[PlannedExperiment], belief: Belief, noise: Noise
) -> tuple[FittedHypothesis, Recording]:
    """The fit about the believed plant of what planned experiments would record, and that recording.

    Slow moves are left out: they show no elasticity.
    """
    rng = np.random.default_rng(0)
    recorded = tuple(
        _synthetic_experiment(config, e, belief, noise, rng)
        for e in experiments
        if e.kind is not Kind.CONSTANT_VELOCITY
    )
    records = read_holds([_with_least_noise(make_record(e, None), noise) for e in recorded])
    recording = Recording(
        robot=config.robot,
        axes=tuple(a.name for a in config.axes),
        position_unit="m" if config.linear else "rad",
        torque_unit="N" if config.linear else "N·m",
        created="",
        experiments=recorded,
        encoder_resolution=noise.position_step,
    )
    return settled_about(belief.chains, records), recording


def _with_least_noise(record: Record, noise: Noise) -> Record:
    """A record with the noise of its lattices, which an axis that stands still does not show."""
    share = 4.0 * record.step / record.span / 12.0
    position = np.maximum(record.position_noise, share * noise.position_step**2)
    torque = np.maximum(record.torque_noise, share * noise.torque_step**2)
    return replace(record, position_noise=position, torque_noise=torque)


def is_in_goal(names: Sequence[str]) -> Bool:
    """(n,) masses, springs and couplings; dampers and friction are reported, not aimed at."""
    result: Bool = np.array([".damper." not in n and not n.endswith(".ground_spring") for n in names])
    return result


def parameter_scale(chains: CoupledChains) -> Float64:
    """(n,) what each parameter's uncertainty is relative to."""
    names, values = parameter_vector(chains)
    scale = np.maximum(np.abs(values), 1e-300)
    pairs = {
        f"{a}-{b}.coupling": COUPLING_SHARE * float(np.sqrt(chains.masses[i][-1] * chains.masses[j][-1]))
        for i, a in enumerate(chains.axes)
        for j, b in enumerate(chains.axes)
    }
    return np.array([max(v, pairs.get(n, 0.0)) for n, v in zip(names, scale, strict=True)])


def _synthetic_experiment(
    config: CellConfig, planned: PlannedExperiment, belief: Belief, noise: Noise, rng: np.random.Generator
) -> Experiment:
    """The record of a planned experiment as its sensors would show it."""
    motion = foretold_motion(config, planned, belief)
    rows = slice(planned.record_from, planned.record_to)
    position, torque = motion.position[rows], motion.torque[rows]
    seen = position + noise.position * rng.standard_normal(position.shape)
    felt = torque + noise.torque * rng.standard_normal(torque.shape)
    gains, _ = hold_gains(config, planned, belief)
    demand = torque.copy()
    for i, axis in enumerate(config.axes):
        if i not in planned.excited and axis.hold.mode == "drive":
            gains[i], demand[:, i] = np.nan, 0.0
    cycle = config.bus.cycle_s
    return Experiment(
        key=planned.key,
        kind=planned.kind,
        role=planned.role,
        excited_axis=planned.excited_axis,
        hold_gain=frozen_float(gains),
        period_samples=planned.period_samples,
        frequencies_hz=planned.frequencies_hz,
        sample_rate_hz=1.0 / cycle,
        time=frozen_float(np.arange(position.shape[0]) * cycle),
        position=frozen_float(_quantise(seen, noise.position_step)),
        torque=frozen_float(_quantise(felt, noise.torque_step)),
        torque_demand=frozen_float(demand),
        attributes={"hold_by": "master"},
    )


def _quantise(values: Float64, step: Float64) -> Float64:
    safe = np.where(step > 0, step, 1.0)
    result: Float64 = np.where(step > 0, np.round(values / safe) * safe, values)
    return result
