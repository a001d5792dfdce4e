"""The linear model, with the effects it came with, fitted to the training records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.diagnosis.context import apply_rule
from invid.diagnosis.known_effects import known_effects_candidate
from invid.diagnosis.tone import Tone
from invid.diagnosis.validation import PLAIN, ValidationRequest
from invid.likelihood.hypothesis import Layout
from invid.likelihood.joint_fit import JointFit, evaluate_held_out, fit
from invid.likelihood.nuisance.hold_share import InsideHold, find_inside_holds
from invid.likelihood.null_test import add_scatter
from invid.likelihood.placed_effect import Candidate
from invid.likelihood.prepare_records import split_into_periods
from invid.model.document import Model
from invid.model.parameters import ChainStructure
from invid.numerics.arrays import Float64
from invid.recording.model import Recording
from invid.signals.spectra import LineSpectra
from invid.signals.spectral_record import SpectralRecord

LIGHTEST = 1e-8
"""Share of its branch that a mass has at least where a fit starts: rounding is 1e-16 of the matrices."""


def fit_linear_model(
    model: Model,
    recording: Recording,
    spectra: Sequence[LineSpectra],
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    asked: ValidationRequest = PLAIN,
) -> tuple[JointFit, Float64, list[SpectralRecord], list[SpectralRecord]]:
    """The model, with the effects it came with, fitted to the training records, its parameters with unbounded
    time offsets, and the records with their scatter.

    Where records are asked for ``apart`` nothing is a tone.
    """
    chains = model.chains
    grounded = tuple(int(i) for i in np.flatnonzero(chains.ground_springs > 0))
    structure = ChainStructure(chains.masses_per_branch, chains.axes, viscous=False, grounded=grounded)
    origin = min(float(e.time[0]) for e in recording.experiments)
    logged = train[0].command is not None
    holds = find_inside_holds(spectra, model, recording, with_command=logged)
    smoothed = tuple(range(structure.motors)) if asked.whole else axes_with_smoothed_torque(model)
    layout = layout_of(structure, train, origin, holds, () if logged and not asked.whole else smoothed)
    given = known_effects_candidate(model, structure)
    late = [t.place.axis for t in given.terms if t.effect.cause == "torque_delay"]
    layout, _ = layout.without_delay(late)
    start = start_vector(model, layout)
    first = fit(layout, add_scatter(train, spectra, layout, start), start, given, iterations=25, strict=False)
    train = add_scatter(train, spectra, layout, first.p)
    held = add_scatter(held, spectra, layout, first.p)
    keys = [r.key for r in (*train, *held) if asked.apart or r.trend or (asked.each and r.differs)]
    # A tone that repeats with no period looks like a change from one to the next.
    if keys and (asked.apart or asked.each or not find_tones(first, held, spectra)):
        train, held = split_into_periods(recording, train, keys), split_into_periods(recording, held, keys)
        if asked.apart and len(held) > 1 and held[0].alone:
            train, held = [*train, held[0]], held[1:]
    return fit(layout, train, first.p, first.candidate, iterations=25), first.p, train, held


def refit_without_effects(base: JointFit, train: Sequence[SpectralRecord]) -> JointFit:
    """The linear model alone fitted to the same records, where the model came with effects."""
    if not base.candidate.terms:
        return base
    layout = replace(base.layout, free_delays=tuple(range(base.layout.structure.motors)))
    linear, rest = base.p[: layout.structure.count], base.p[base.layout.stairs_at.start :]
    p = np.concatenate((linear, base.layout.delays(base.p), rest))
    return fit(layout, train, p, Candidate(), iterations=25)


def layout_of(
    structure: ChainStructure,
    records: Sequence[SpectralRecord],
    origin: float,
    holds: tuple[InsideHold, ...] = (),
    smoothed: tuple[int, ...] = (),
) -> Layout:
    """Delay and hold-over-the-sample parameters that the records leave open, the holds' shares, and the time
    constants of the axes whose reported torque is ``smoothed``."""
    motors = structure.motors
    stairs = np.array([r.staircase for r in records])
    unknown = tuple(i for i in range(motors) if np.isnan(stairs[:, i]).any())
    known = np.nan_to_num(stairs[0], nan=0.5)
    free = tuple(range(motors))
    return Layout(structure, records[0].step, unknown, known, free, origin, holds=holds, smoothed=smoothed)


def axes_with_smoothed_torque(model: Model) -> tuple[int, ...]:
    """Axes whose drive smooths the torque that it reports, by three standard deviations in ``fit``."""
    found = []
    for i, axis in enumerate(model.axes):
        lag = model.fit.get("torque_lag_s", {}).get(axis, {})
        value, std = lag.get("value"), lag.get("std")
        if value is not None and std is not None and value > 3.0 * std:
            found.append(i)
    return tuple(found)


def start_vector(model: Model, layout: Layout) -> Float64:
    """(n,) parameters of the model as it came."""
    structure, start = layout.structure, np.zeros(layout.count)
    # A mass that vanished in the identification makes the chain's matrices singular.
    masses = [np.maximum(m, LIGHTEST * m.sum()) for m in model.chains.masses]
    start[: structure.count] = structure.vector(replace(model.chains, masses=tuple(masses)))
    offsets = model.fit.get("time_offset_s", {}) if isinstance(model.fit, dict) else {}
    for k, i in enumerate(layout.free_delays):
        found = offsets.get(f"{structure.axes[i]}.time_offset", {})
        value = found.get("value") if isinstance(found, dict) else None
        start[structure.count + k] = 0.5 * layout.step if value is None else float(value)
    for k, i in enumerate(layout.smoothed):
        lag = model.fit.get("torque_lag_s", {}).get(structure.axes[i], {})
        time_constant = max(float(lag.get("value") or 0.0), 0.0)
        start[layout.smoothed_at.start + k] = time_constant
        start[structure.count + layout.free_delays.index(i)] += time_constant  # which held the lag's delay
    start[layout.stairs_at] = 0.5
    start[layout.holds_at] = [h.expected for h in layout.holds]
    return start


def find_tones(
    fitted: JointFit, held: Sequence[SpectralRecord], spectra: Sequence[LineSpectra]
) -> list[Tone]:
    """Tones of the training and the held-out records."""
    both = (fitted.evaluation, evaluate_held_out(fitted, held))
    return list(apply_rule("tones", both, fitted.layout, fitted.p, spectra))
