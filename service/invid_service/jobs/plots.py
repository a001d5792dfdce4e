"""The numbers of the page's pictures, computed once by the runner: FRFs on one scale, missing torque."""

from __future__ import annotations

from typing import Any

import numpy as np

from invid.arrays import Complex128, Float64
from invid.diagnosis import Diagnosis
from invid.errors import InvidError
from invid.forward import dynamic_stiffness, frf, resonances
from invid.frf import frf_matrix
from invid.model import Model
from invid.recording import Recording
from invid.spectra import LineSpectra, all_spectra

_POINTS = 600
_CLOUD = 800


def plot_data(recording: Recording, model: Model, diagnosis: Diagnosis) -> dict[str, Any]:
    """Pictures as plain numbers; parts that the data do not allow are ``None``, with the reason."""
    notes: list[str] = []
    document: dict[str, Any] = {"axes": list(recording.axes), "frf": None, "missing_torque": None}
    try:
        spectra = all_spectra(recording)
        document["frf"] = _frf(spectra, model, diagnosis)
        document["missing_torque"] = _missing(spectra, model, diagnosis)
    except (InvidError, np.linalg.LinAlgError, ValueError) as error:
        notes.append(f"no picture of the spectra: {error}")
    unit = recording.position_unit, recording.torque_unit
    return {**document, "position_unit": unit[0], "torque_unit": unit[1], "notes": notes}


def _frf(spectra: tuple[LineSpectra, ...], model: Model, diagnosis: Diagnosis) -> dict[str, Any] | None:
    measured = frf_matrix(spectra)
    if measured.frequency_hz.size < 2:
        return None
    step = max(1, int(np.ceil(measured.frequency_hz.size / _POINTS)))
    hz = measured.frequency_hz[::step]
    grid = np.geomspace(hz[0], hz[-1], _POINTS)
    before, after = (
        _db(frf(model.chains, 2 * np.pi * grid)),
        _db(frf(diagnosis.model.chains, 2 * np.pi * grid)),
    )
    seen = _db(measured.frf[::step])
    peaks = [float(f) for f in resonances(diagnosis.model.chains) / (2 * np.pi) if hz[0] <= f <= hz[-1]]
    pairs = []
    for i in range(seen.shape[1]):
        for j in range(i, seen.shape[1]):
            pairs.append(
                {
                    "response": i,
                    "excitation": j,
                    "measured_db": _rounded(seen[:, i, j]),
                    "before_db": _rounded(before[:, i, j]),
                    "after_db": _rounded(after[:, i, j]),
                }
            )
    return {
        "measured_hz": _rounded(hz, 4),
        "model_hz": _rounded(grid, 4),
        "pairs": pairs,
        "peaks_hz": [round(f, 3) for f in peaks],
        "extended": bool(diagnosis.findings),
    }


def _db(values: Complex128) -> Float64:
    result: Float64 = 20 * np.log10(np.maximum(np.abs(values), 1e-300))
    return result


def _rounded(values: Float64, digits: int = 2) -> list[float]:
    return [round(float(v), digits) for v in values]


def _missing(spectra: tuple[LineSpectra, ...], model: Model, diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Missing torque r = ZΘ − T of the linear part: over frequency, and as a cloud over one period
    against velocity and position of the motor."""
    periodic = [s for s in spectra if not s.transient and s.frequency_hz.size > 2]
    if not periodic:
        return None
    s = max(periodic, key=lambda one: float(np.abs(one.torque).max()))
    omega = 2 * np.pi * s.frequency_hz
    chains = diagnosis.model.chains if diagnosis.findings else model.chains
    rest = np.einsum("fij,fj->fi", dynamic_stiffness(chains, omega), s.position) - s.torque
    first = np.einsum("fij,fj->fi", dynamic_stiffness(model.chains, omega), s.position) - s.torque
    band = omega <= 1.2 * omega[s.excited].max(initial=0.0) if s.excited.any() else np.ones(omega.size, bool)
    duration = 1.0 / float(np.min(np.diff(np.concatenate(([0.0], s.frequency_hz)))))
    t = np.linspace(0.0, min(duration, s.time.size / s.sample_rate_hz), _CLOUD, endpoint=False)
    wave = np.exp(1j * np.outer(t, omega[band]))
    torque = np.real(wave @ rest[band])
    place = np.real(wave @ s.position[band])
    speed = np.real(wave @ (1j * omega[band, None] * s.position[band]))
    step = max(1, int(np.ceil(int(band.sum()) / _POINTS)))
    return {
        "experiment": s.key,
        "frequency_hz": _rounded(s.frequency_hz[band][::step], 4),
        "axes": [
            {
                "before_db": _rounded(_db(first[band, i][::step])),
                "torque": [float(f"{v:.4g}") for v in torque[:, i]],
                "velocity": [float(f"{v:.4g}") for v in speed[:, i]],
                "position": [float(f"{v:.4g}") for v in place[:, i]],
            }
            for i in range(rest.shape[1])
        ],
        "causes": [
            {
                "axis": f.effect.axis,
                "cause": f.effect.cause,
                "element": f.effect.element,
                "parameters": {n: p.value for n, p in f.effect.parameters.items()},
            }
            for f in diagnosis.findings
        ],
    }
