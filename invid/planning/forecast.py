"""Travel, velocity and power to expect, from the last model or a rigid guess."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.config import CellConfig
from invid.model.chains import CoupledChains
from invid.model.forward import frf
from invid.numerics.arrays import Float64
from invid.planning.belief import Belief
from invid.planning.model import AxisForecast, PlannedExperiment
from invid.planning.response import foretold_motion
from invid.recording.model import Kind

NEVER_BACK = 2.5
"""Creep in rms velocities of the shaking above which a motor hardly turns back (once in a hundred, normal).
``bench_identify.py --case creep``, peak twice the friction: there every seed is good to 1 %; with three
fifths of it two seeds were, with three tenths none."""


def forecast(
    config: CellConfig, experiments: Sequence[PlannedExperiment], *, model: CoupledChains | None = None
) -> tuple[AxisForecast, ...]:
    """Peak torque, travel, velocity and power of every axis over all experiments.

    With a model the response at every line is G(ω)·T(ω), resonances and couplings included, summed in
    magnitude. With an inertia alone it is Σ|T|/(S·ω²): rigid, so flexible modes may exceed it. With
    neither nothing is foretold and the trial at low amplitude must tell.
    """
    count = len(config.axes)
    peak = np.zeros(count)
    travel, velocity = np.zeros(count), np.zeros(count)
    for e in experiments:
        peak = np.maximum(peak, np.abs(e.torque).max(axis=0, initial=0.0))
        x, v = _motion(config, e, model)
        travel, velocity = np.maximum(travel, x), np.maximum(velocity, v)
    known = "model" if model is not None else "inertia"
    result = []
    for i, axis in enumerate(config.axes):
        has = model is not None or axis.inertia is not None
        result.append(
            AxisForecast(
                axis=axis.name,
                unit="N" if config.linear else "N·m",
                peak_torque=float(peak[i]),
                travel=float(travel[i]) if has else None,
                velocity=float(velocity[i]) if has else None,
                power=float(peak[i] * velocity[i]) if has else None,
                travel_limit=axis.limits.position,
                basis=known if has else "unknown",
            )
        )
    return tuple(result)


def forecast_motion(
    config: CellConfig, experiments: Sequence[PlannedExperiment], belief: Belief
) -> tuple[AxisForecast, ...]:
    """The same from the motion in time, transients, holds and friction included."""
    count = len(config.axes)
    peak, travel, velocity = np.zeros(count), np.zeros(count), np.zeros(count)
    for e in experiments:
        motion = foretold_motion(config, e, belief)
        peak = np.maximum(peak, np.abs(e.torque).max(axis=0, initial=0.0))
        travel = np.maximum(travel, np.abs(motion.position).max(axis=0))
        velocity = np.maximum(velocity, np.abs(motion.velocity).max(axis=0))
    return tuple(
        AxisForecast(
            axis=axis.name,
            unit="N" if config.linear else "N·m",
            peak_torque=float(peak[i]),
            travel=float(travel[i]),
            velocity=float(velocity[i]),
            power=float(peak[i] * velocity[i]),
            travel_limit=axis.limits.position,
            basis="guess" if belief.guessed else "model",
        )
        for i, axis in enumerate(config.axes)
    )


def turning_back(config: CellConfig, experiment: PlannedExperiment, belief: Belief) -> list[str]:
    """Axes whose creep is too slow to keep them from turning back while they are shaken, in words."""
    if experiment.reference is None:
        return []
    free = replace(belief, coulomb=np.zeros(len(config.axes)))
    motion = foretold_motion(config, replace(experiment, reference=None), free)
    swing = np.sqrt(np.mean(motion.velocity**2, axis=0))
    creep = np.abs(np.diff(experiment.reference, axis=0)).max(axis=0, initial=0.0) / config.bus.cycle_s
    unit = "m/s" if config.linear else "rad/s"
    return [
        f"axis {axis.name}: it creeps at {creep[i]:.3g} {unit} and is shaken with {swing[i]:.3g} {unit} rms: "
        f"it will turn back and stand; a creep_velocity of {NEVER_BACK * swing[i]:.2g} keeps it going"
        for i, axis in enumerate(config.axes)
        if 0 < creep[i] < NEVER_BACK * swing[i]
    ]


def _motion(config: CellConfig, e: PlannedExperiment, model: CoupledChains | None) -> tuple[Float64, Float64]:
    count = len(config.axes)
    if e.kind is Kind.CONSTANT_VELOCITY and e.reference is not None:
        rate = 1.0 / config.bus.cycle_s
        return np.abs(e.reference).max(axis=0), np.abs(np.diff(e.reference, axis=0)).max(axis=0) * rate
    rows = e.torque[e.record_from : e.record_from + e.period_samples] if e.period_samples else e.torque
    spectrum = np.fft.rfft(rows, axis=0) * (2.0 / len(rows))
    omega = 2 * np.pi * np.fft.rfftfreq(len(rows), config.bus.cycle_s)
    keep = np.abs(spectrum).max(axis=1) > 1e-6 * max(float(np.abs(spectrum).max()), 1e-300)
    # Below the band is leakage of the ramps, which division by ω² would blow up.
    low, _ = e.attributes.get("band_hz", (0.0, 0.0))
    keep &= omega > np.pi * low
    keep[0] = False
    omega, spectrum = omega[keep], spectrum[keep]
    if not omega.size:
        return np.zeros(count), np.zeros(count)
    if model is not None:
        response = np.abs(np.einsum("fij,fj->fi", frf(model, omega), spectrum))
    else:
        inertia = np.array([a.inertia if a.inertia is not None else np.inf for a in config.axes])
        response = np.abs(spectrum) / (omega[:, None] ** 2 * inertia)
    offset = np.abs(e.reference).max(axis=0) if e.reference is not None else np.zeros(count)
    if e.period_samples:
        return response.sum(axis=0) + offset, (omega[:, None] * response).sum(axis=0)
    # A sweep is at one frequency at a time: its spectrum adds up to its peak only in rms.
    scale = np.sqrt(2.0)
    return (
        np.sqrt((response**2).sum(axis=0)) * scale + offset,
        np.sqrt(((omega[:, None] * response) ** 2).sum(axis=0)) * scale,
    )
