"""Missing torque over all it may depend on, and the motion simulated against the measured, as plain lists.

``figure_data`` draws a cause over the quantity that it depends on; a person who doubts it wants to see the
same torque over the others too, where a wrong cause would leave a shape (``cause_views``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from invid.effects import curve as laws
from invid.effects.registry import effects_of_plant
from invid.errors import InvidError
from invid.model.chains import CoupledChains
from invid.model.diagnosis_document import Diagnosis
from invid.model.document import EffectTerm, Model, model_from_json
from invid.numerics.arrays import Bool, Complex128, Float64
from invid.recording.model import Experiment, Recording, Role
from invid.report.data import (
    POINTS,
    _abscissa,
    _denoised,
    _interior,
    _liveliest,
    _place,
    _unit,
    _wave,
    alone,
    band_of,
    fitted_wave,
    force_at,
    lines_of,
    seen_alike,
)
from invid.report.spectra_data import (
    MissingTorque,
    binned,
    binned_floor,
    binned_torque,
    line_numbers,
    missing_torque,
)
from invid.signals.spectra import LineSpectra, all_spectra
from invid.simulation.run import simulate

SAMPLES = 2000
"""Samples of a wave in a picture and in its data."""


def dependence_data(recording: Recording, model: Model) -> list[dict[str, Any]]:
    """One entry an axis: ``lines`` by kind with the floor, ``waves`` over one period, ``levels``.

    ``lines``: ``excited``, ``odd``, ``even`` (unexcited), each with ``frequency_hz`` and rms ``torque``, and
    ``floor``; all records together. ``waves``: time, missing torque, position, velocity, acceleration and the
    deflection of every spring of the axis, of the record in which the axis moves most. ``levels``: rms of
    motion and of missing torque in every record. The linear part of ``model`` says what is missing.
    """
    try:
        spectra = all_spectra(recording)
    except InvidError:
        return []
    if not spectra or spectra[0].axis_count != model.chains.branches:
        return []
    all_missing = [missing_torque(s, model.chains) for s in spectra]
    return [_axis(recording, model, spectra, all_missing, i) for i in range(recording.axis_count)]


def _axis(
    recording: Recording,
    model: Model,
    spectra: Sequence[LineSpectra],
    missing: Sequence[MissingTorque],
    i: int,
) -> dict[str, Any]:
    chains = model.chains
    liveliest = _liveliest(spectra, i)
    m = next(x for x in missing if x.spectra is liveliest)
    keep = _interior(liveliest, liveliest.time.size)
    step = max(1, (keep.stop - keep.start) // SAMPLES)
    thin = slice(keep.start, keep.stop, step)
    jw = 1j * liveliest.omega
    own = liveliest.position[:, i]
    waves = {
        "time": liveliest.time,
        "missing_torque": -_wave(liveliest, _denoised(m.torque[:, i], m.std[:, i])),
        "position": np.asarray(liveliest.position_wave)[:, i],
        "velocity": _wave(liveliest, jw * own),
        "acceleration": _wave(liveliest, jw**2 * own),
    }
    first = int(chains.motor_dofs[i])
    for q in range(chains.springs[i].size):
        moved = np.einsum("fm,fm->f", m.motion[:, first + q] - m.motion[:, first + q + 1], liveliest.position)
        waves[f"deflection_{q + 1}"] = _wave(liveliest, moved)
    hz, floor = binned_floor(missing, i)
    return {
        "axis": recording.axes[i],
        "experiment": liveliest.key,
        "torque_unit": recording.torque_unit,
        "position_unit": recording.position_unit,
        "lines": {
            "floor": {"frequency_hz": hz, "torque": floor},
            **{kind: _lines(missing, i, kind) for kind in ("excited", "odd", "even")},
        },
        "waves": {name: np.asarray(wave)[thin].tolist() for name, wave in waves.items()},
        "levels": [
            {
                "experiment": x.spectra.key,
                "role": str(x.spectra.role),
                "motion_rms": float(np.std(np.asarray(x.spectra.position_wave)[:, i])),
                "missing_rms": _rms(x.torque[:, i], x.std[:, i]),
                "noise_rms": _rms(x.std[:, i].astype(complex), x.std[:, i]),
            }
            for x in missing
        ],
    }


def _rms(lines: Any, std: Float64) -> float:
    """Rms over time on the lines that say something (not where a clamped resonance multiplies the noise)."""
    good = std <= np.sqrt(10.0) * np.median(std)
    return float(np.sqrt(0.5 * np.sum(np.abs(lines[good]) ** 2)))


def _kind(s: LineSpectra, kind: str) -> Bool:
    """Lines of a kind; odd and even are those that the excitation leaves alone."""
    if kind == "excited":
        return np.asarray(s.excited)
    found: Bool = ~np.asarray(s.excited) & (line_numbers(s) % 2 == (kind == "odd"))
    return found


def _lines(missing: Sequence[MissingTorque], i: int, kind: str) -> dict[str, list[float]]:
    hz, rms = binned_torque(missing, i, [_kind(m.spectra, kind) for m in missing])
    return {"frequency_hz": hz, "torque": rms}


def linear_model_of(diagnosis: Diagnosis) -> Model:
    """The linear model before the diagnosis; the diagnosed one where no cause changed it."""
    before = diagnosis.details.get("linear_model")
    return model_from_json(before) if isinstance(before, dict) else diagnosis.model


def replay_data(recording: Recording, diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """One entry an axis: the held-out motion measured, simulated by the linear and by the extended model.

    Empty where a model cannot be simulated on this recording. The record is the held-out one with the most
    motion, the first one where none is held out; a stretch of it that a picture can show.
    """
    experiments = [e for e in recording.experiments if e.frequencies_hz.size]
    held = [e for e in experiments if e.role is Role.VALIDATE] or experiments[:1]
    if not held:
        return []
    chosen = max(held, key=lambda e: float(e.position.std()))
    after = diagnosis.model
    after = replace(after, effects=effects_of_plant(after.effects))
    linear = replace(linear_model_of(diagnosis), effects=())
    try:
        runs = [simulate(x, recording, only=(chosen.key,)).experiments[0] for x in (linear, after)]
    except InvidError:
        return []
    return [_replayed(recording, chosen, runs, i, bool(after.effects)) for i in range(recording.axis_count)]


def _replayed(
    recording: Recording, measured: Experiment, runs: Sequence[Experiment], i: int, extended: bool
) -> dict[str, Any]:
    # Two cycles of the lowest line, from the middle of the record.
    span = 2.0 / max(float(measured.frequencies_hz.min()), 1e-9)
    rows = int(np.clip(span * measured.sample_rate_hz, 50, measured.samples))
    start = (measured.samples - rows) // 2
    shown = slice(start, start + rows, max(1, rows // SAMPLES))
    position = measured.position[:, i]
    error = [np.asarray(run.position[:, i] - position) for run in runs]
    return {
        "axis": recording.axes[i],
        "experiment": measured.key,
        "role": str(measured.role),
        "unit": recording.position_unit,
        "torque_unit": recording.torque_unit,
        "extended": extended,
        "time": measured.time[shown].tolist(),
        "measured": position[shown].tolist(),
        "simulated_before": runs[0].position[shown, i].tolist(),
        "simulated_after": runs[1].position[shown, i].tolist(),
        "rms": {
            "motion": float(position.std()),
            "error_before": float(np.sqrt(np.mean(error[0] ** 2))),
            "error_after": float(np.sqrt(np.mean(error[1] ** 2))),
        },
    }


SIDES = (laws.VELOCITY, laws.POSITION, laws.DEFLECTION)


def cause_views(recording: Recording, model: Model, diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """One entry a finding (or the axis on which something unexplained lives, without a fit).

    Each has ``cause``, ``axis``, ``element``, ``y_label``, ``own`` (what the cause depends on), ``sides``
    (``what``, ``x_label``, ``x``, ``y``, ``fit`` {x, y} as points of the same instants in the band of the
    measured ones, or null, ``law`` {x, y} the cause itself over its own quantity, or null), ``band_hz`` and
    ``spectrum`` (``frequency_hz``, ``missing``, ``left`` after the cause, ``noise_floor``). Empty where
    the recording carries no spectra.
    """
    chains = diagnosis.model.chains
    try:
        spectra = all_spectra(recording)
    except InvidError:
        return []
    if not spectra or chains.branches != len(recording.axes):
        return []
    held_out = tuple(s for s in spectra if s.role is Role.VALIDATE) or spectra
    terms = [f.effect for f in diagnosis.findings if f.effect.axis in recording.axes]
    out = [_views(recording, held_out, chains, term, terms) for term in terms]
    lost = diagnosis.unexplained
    if not out and lost is not None and lost.axis in recording.axes:
        nameless = EffectTerm("", lost.axis, {}, "mass 1")
        out.append(_views(recording, held_out, model.chains, nameless, ()))
    return out


def _views(
    recording: Recording,
    spectra: Sequence[LineSpectra],
    chains: CoupledChains,
    term: EffectTerm,
    all_terms: Sequence[EffectTerm],
) -> dict[str, Any]:
    i, pattern, stiffness = _place(chains, term)
    s = _liveliest(spectra, i)
    m, note = alone(s, chains, term, all_terms)
    force, std = force_at(m, pattern)
    y = -_wave(s, _denoised(force, std))
    keep = _interior(s, y.size)
    own = laws.abscissa(term)
    fit = None if own is None else fitted_wave(m, pattern, i, term, own, stiffness)
    seen = None if fit is None else seen_alike(s, force, std, fit)
    sides = []
    for what in dict.fromkeys((*([own] if own else []), *SIDES)):
        x = _side(m, chains, pattern, i, what, term if what == own else None)
        if x is None:
            continue
        step = max(1, y[keep].size // POINTS)
        picture: dict[str, Any] = {
            "what": what,
            "x_label": f"{what} [{_unit(recording, what)}]",
            "x": x[keep][::step].tolist(),
            "y": y[keep][::step].tolist(),
            "fit": None,
            "law": None,
        }
        if seen is not None:
            picture["fit"] = {"x": picture["x"], "y": seen[keep][::step].tolist()}
        if what == own:
            law = laws.curve(term, x, stiffness)
            picture["law"] = None if law is None or law.path else {"x": law.x.tolist(), "y": law.y.tolist()}
        sides.append(picture)
    return {
        "cause": term.cause or None,
        "axis": term.axis,
        "element": term.element if term.cause else None,
        "y_label": f"missing torque [{recording.torque_unit}]",
        "note": note,
        "own": own,
        "sides": sides,
        "band_hz": band_of(s),
        "spectrum": _spectrum(s, force, std, fit),
    }


def _side(
    m: MissingTorque, chains: CoupledChains, pattern: Float64, axis: int, what: str, term: EffectTerm | None
) -> Float64 | None:
    """(n,) the quantity at the cause's place; the deflection is that of the spring next to it."""
    if what != laws.DEFLECTION or np.count_nonzero(pattern) == 2:
        if what in (laws.VELOCITY, laws.POSITION) and np.count_nonzero(pattern) == 2:
            pattern = np.maximum(pattern, 0.0)  # of a spring: its motor's side
        return _abscissa(m, pattern, axis, what, term)
    springs = chains.springs[axis].size
    if springs == 0:
        return None
    place = int(np.flatnonzero(pattern)[0]) - int(chains.motor_dofs[axis])
    first = int(chains.motor_dofs[axis]) + min(max(place, 0), springs - 1)
    across = np.zeros(chains.dofs)
    across[first], across[first + 1] = 1.0, -1.0
    return _abscissa(m, across, axis, what, None)


def _spectrum(s: LineSpectra, force: Complex128, std: Float64, fit: Float64 | None) -> dict[str, Any]:
    """Rms over frequency of the torque at the cause's place, before and with the cause taken out."""
    inside = line_numbers(s) <= s.time.size // 2
    hz = s.frequency_hz[inside]
    centre, before = binned([hz], [np.abs(force[inside]) ** 2])
    _, noise = binned([hz], [std[inside] ** 2])
    left = None
    if fit is not None:
        left = binned([hz], [np.abs(force + lines_of(s, fit))[inside] ** 2])[1].tolist()
    return {
        "frequency_hz": centre.tolist(),
        "missing": before.tolist(),
        "left": left,
        "noise_floor": noise.tolist(),
    }
