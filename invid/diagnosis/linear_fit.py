"""The linear model, with the effects it came with, fitted to the training records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.diagnosis.known_effects import known_effects_candidate
from invid.diagnosis.rules.tones import find_common_tones
from invid.diagnosis.tone import Tone
from invid.diagnosis.validation import PLAIN, ValidationRequest
from invid.identification.ground_springs import SIGNIFICANT
from invid.likelihood.hypothesis import Layout
from invid.likelihood.joint_fit import JointFit, evaluate_held_out, fit
from invid.likelihood.nuisance.hold_share import InsideHold, find_inside_holds
from invid.likelihood.null_test import add_scatter
from invid.likelihood.placed_effect import Candidate
from invid.likelihood.prepare_records import split_into_periods
from invid.model.chains import CoupledChains
from invid.model.document import Model
from invid.model.parameters import ChainStructure
from invid.numerics.arrays import Float64
from invid.recording.model import Recording
from invid.signals.spectra import LineSpectra
from invid.signals.spectral_record import SpectralRecord

LIGHTEST = 1e-8
"""Least share of its branch that a mass has where a fit starts (numerical: rounding of the matrices is
1e-16)."""


def fit_linear_model(
    model: Model,
    recording: Recording,
    spectra: Sequence[LineSpectra],
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    request: ValidationRequest = PLAIN,
) -> tuple[JointFit, Float64, list[SpectralRecord], list[SpectralRecord]]:
    """Fit of the model with its effects, parameters (n,) before the final fit, training and held-out records.

    The parameters are those of a first fit whose time offsets are not bounded; the records carry the scatter
    between their periods. Where ``request`` takes all records period by period, nothing is taken for a tone.
    """
    chains = model.chains
    grounded = tuple(int(i) for i in np.flatnonzero(chains.ground_springs > 0))
    structure = ChainStructure(chains.masses_per_branch, chains.axes, viscous=False, grounded=grounded)
    origin = min(float(e.time[0]) for e in recording.experiments)
    logged = train[0].command is not None
    holds = find_inside_holds(spectra, model, recording, with_command=logged)
    smoothed = tuple(range(structure.motors)) if request.beside_friction else axes_with_smoothed_torque(model)
    layout = layout_of(
        structure, train, origin, holds, () if logged and not request.beside_friction else smoothed
    )
    known_effects = known_effects_candidate(model, structure)
    delayed_axes = [t.place.axis for t in known_effects.terms if t.effect.cause == "torque_delay"]
    layout, _ = layout.without_delay(delayed_axes)
    start = start_vector(model, layout)
    first = fit(
        layout, add_scatter(train, spectra, layout, start), start, known_effects, iterations=25, strict=False
    )
    train = add_scatter(train, spectra, layout, first.p)
    held = add_scatter(held, spectra, layout, first.p)
    keys = [
        r.key
        for r in (*train, *held)
        if request.by_period or r.trend or (request.by_period_if_differing and r.differs)
    ]
    # A tone that repeats with no period looks like a change from one to the next.
    if keys and (request.by_period or request.by_period_if_differing or not find_tones(first, held, spectra)):
        train, held = split_into_periods(recording, train, keys), split_into_periods(recording, held, keys)
        if not request.beside_friction:
            train, held = ([r.without_fine_grid() for r in records] for records in (train, held))
        if request.by_period and len(held) > 1 and held[0].alone:
            train, held = [*train, held[0]], held[1:]
    return fit(layout, train, first.p, first.candidate, iterations=25), first.p, train, held


def refit_without_effects(base: JointFit, train: Sequence[SpectralRecord]) -> JointFit:
    """The linear model alone fitted to the same records; the same fit where the model came without
    effects."""
    if not base.candidate.terms:
        return base
    layout = replace(base.layout, free_delays=tuple(range(base.layout.structure.motors)))
    linear, rest = base.p[: layout.structure.count], base.p[base.layout.zoh_slice.start :]
    p = np.concatenate((linear, base.layout.delays(base.p), rest))
    return fit(layout, train, p, Candidate(), iterations=25)


def idle_ground_springs(fitted: JointFit) -> tuple[int, ...]:
    """Axes whose spring to ground, in a joint fit, is within three standard deviations of none."""
    structure, part = fitted.layout.structure, fitted.layout.structure.slices["ground_spring"]
    values = structure.physical(fitted.p[: structure.count])[part]
    scale = np.where(structure.logarithmic[part], values, 1.0)
    std = np.sqrt(np.maximum(np.diag(fitted.covariance)[part], 0.0)) * scale
    return tuple(
        i for i, v, s in zip(structure.grounded, values, std, strict=True) if not v > SIGNIFICANT * s
    )


def layout_of(
    structure: ChainStructure,
    records: Sequence[SpectralRecord],
    origin: float,
    holds: tuple[InsideHold, ...] = (),
    smoothed: tuple[int, ...] = (),
) -> Layout:
    """The parameter vector that the records leave open: time offsets, shares held over the sample, holds'
    shares, and time constants of the axes ``smoothed``."""
    motors = structure.motors
    stairs = np.array([r.staircase for r in records])
    unknown = tuple(i for i in range(motors) if np.isnan(stairs[:, i]).any())
    known = np.nan_to_num(stairs[0], nan=0.5)
    free = tuple(range(motors))
    return Layout(structure, records[0].step, unknown, known, free, origin, holds=holds, smoothed=smoothed)


def axes_with_smoothed_torque(model: Model) -> tuple[int, ...]:
    """Axes whose drive smooths the torque that it reports (time constant above three standard deviations)."""
    smoothed = []
    for i, axis in enumerate(model.axes):
        lag = model.fit.get("torque_lag_s", {}).get(axis, {})
        value, std = lag.get("value"), lag.get("std")
        if value is not None and std is not None and value > 3.0 * std:
            smoothed.append(i)
    return tuple(smoothed)


def chain_vector(structure: ChainStructure, chains: CoupledChains) -> Float64:
    """(n,) parameters of a chain; a mass that vanished would make its matrices singular and is made a little
    of one."""
    masses = tuple(np.maximum(m, LIGHTEST * m.sum()) for m in chains.masses)
    return structure.vector(replace(chains, masses=masses))


def start_vector(model: Model, layout: Layout) -> Float64:
    """(n,) parameters of the model as it was given."""
    structure, start = layout.structure, np.zeros(layout.count)
    start[: structure.count] = chain_vector(structure, model.chains)
    offsets = model.fit.get("time_offset_s", {}) if isinstance(model.fit, dict) else {}
    for k, i in enumerate(layout.free_delays):
        found = offsets.get(f"{structure.axes[i]}.time_offset", {})
        value = found.get("value") if isinstance(found, dict) else None
        start[structure.count + k] = 0.5 * layout.step if value is None else float(value)
    for k, i in enumerate(layout.smoothed):
        lag = model.fit.get("torque_lag_s", {}).get(structure.axes[i], {})
        time_constant = max(float(lag.get("value") or 0.0), 0.0)
        start[layout.lag_slice.start + k] = time_constant
        start[structure.count + layout.free_delays.index(i)] += time_constant  # it contained the lag's delay
    start[layout.zoh_slice] = 0.5
    start[layout.hold_slice] = [h.expected for h in layout.holds]
    return start


def find_tones(
    fitted: JointFit, held: Sequence[SpectralRecord], spectra: Sequence[LineSpectra]
) -> list[Tone]:
    """Tones that the training and the held-out records have in common."""
    both = (fitted.evaluation, evaluate_held_out(fitted, held))
    return find_common_tones(both, fitted.layout, fitted.p, spectra)
