"""The model of the paper's inverse, on what the records show of resonances near the fitted plant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.identification.elastic_model import finished_fit, model_of_fit
from invid.identification.fitted_model import chains_of
from invid.identification.search_start import SearchStart
from invid.inverse import PaperResult, Readings, identify_paper
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.value import StackWork, real_rows
from invid.model.document import Model, parameter_vector, std_by_name, stds_by_name
from invid.numerics.arrays import Float64, frozen_float


def paper_model(begun: SearchStart) -> Model:
    """The fitted model with masses, springs and couplings by the paper's inverse; ``fit["refined"]`` has the
    estimates beside them.

    Raises
    ------
    NotIdentifiableError
        Readings that belong to no chain.
    """
    end, worths = finished_fit(begun)
    refined, found = model_of_fit(begun, end, worths), _read(end, begun.recording.axes)
    deviation = dict(zip(found.names, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))
    names, values = parameter_vector(refined.chains)
    return replace(
        refined,
        method="paper",
        chains=found.chains,
        std=std_by_name(found.chains, {**stds_by_name(refined), **deviation}),
        covariance=frozen_float(found.covariance),
        parameter_names=found.names,
        fit={
            **refined.fit,
            "refined": dict(zip(names, values.tolist(), strict=True)),
            "resonances_hz": (found.resonances / 2 / np.pi).tolist(),
            "antiresonances_hz": [(z / 2 / np.pi).tolist() for z in found.antiresonances],
        },
    )


def _read(end: FittedHypothesis, axes: tuple[str, ...]) -> PaperResult:
    """Readings by least squares on what the records miss, laws free beside them, and the paper's inverse."""
    readings, value = Readings.of(chains_of(end, axes)[0]), end.fit.value
    rows = [_rows(readings, work) for work in value.work]
    missing = [(work.missing + work.laws @ value.coefficients).ravel() for work in value.work]
    matrix, right = np.concatenate([r for r, _ in rows]), np.concatenate(missing)
    size = np.linalg.norm(matrix, axis=0) + 1e-300
    normal = np.linalg.pinv((matrix / size).T @ (matrix / size), hermitian=True)
    x = normal @ ((matrix / size).T @ right)
    left = float(np.sum((right - matrix / size @ x) ** 2))
    # What the rows still miss beyond their noise counts as noise.
    excess = max(left / max(right.size - x.size, 1), 1.0)
    own = rows[0][1]
    covariance = excess * normal / size[:, None] / size
    return identify_paper(readings, (x / size)[:own], covariance[:own, :own])


def _rows(readings: Readings, work: StackWork) -> tuple[Float64, int]:
    """(R·2FM, p + J) whitened slopes of the missing torque by readings and laws without ends; p."""
    omega, stiffness = np.where(work.turning > 0, work.stack.omega, 1.0), work.condensed.stiffness
    torque = (stiffness @ work.stack.position[..., None])[..., 0]
    slopes = work.whitener @ stiffness @ readings.motion_slopes(omega, torque)
    rows = real_rows(np.where((work.turning > 0)[:, None, None], slopes, 0.0))
    rows = work.ends.out_of(rows)
    whole = np.concatenate((rows, -work.laws), axis=2)
    return whole.reshape(-1, whole.shape[2]), rows.shape[2]
