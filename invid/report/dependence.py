"""Missing torque over all it may depend on, and the motion simulated against the measured, as plain lists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from invid.effects.registry import of_the_plant
from invid.errors import InvidError
from invid.model.diagnosis_document import Diagnosis
from invid.model.document import Model, model_from_json
from invid.numerics.arrays import Bool, Float64
from invid.recording.model import Experiment, Recording, Role
from invid.report import data as shared
from invid.report.spectra_data import (
    MissingTorque,
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
    liveliest = shared._liveliest(spectra, i)
    m = next(x for x in missing if x.spectra is liveliest)
    keep = shared._interior(liveliest, liveliest.time.size)
    step = max(1, (keep.stop - keep.start) // SAMPLES)
    thin = slice(keep.start, keep.stop, step)
    jw = 1j * liveliest.omega
    own = liveliest.position[:, i]
    waves = {
        "time": liveliest.time,
        "missing_torque": -shared._wave(liveliest, shared._denoised(m.torque[:, i], m.std[:, i])),
        "position": np.asarray(liveliest.position_wave)[:, i],
        "velocity": shared._wave(liveliest, jw * own),
        "acceleration": shared._wave(liveliest, jw**2 * own),
    }
    first = int(chains.motor_dofs[i])
    for q in range(chains.springs[i].size):
        moved = np.einsum("fm,fm->f", m.motion[:, first + q] - m.motion[:, first + q + 1], liveliest.position)
        waves[f"deflection_{q + 1}"] = shared._wave(liveliest, moved)
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
    after = replace(after, effects=of_the_plant(after.effects))
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
