"""The model of the paper's inverse alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.errors import InvidError
from invid.identification.fitted_model import provenance_of
from invid.identification.identifiability import LIMIT
from invid.inverse import PaperResult, identify_paper
from invid.model.document import Model, parameter_vector, std_by_name
from invid.model.doubts import Doubt, DoubtCode, doubt_facts
from invid.model.forward import frf
from invid.numerics.arrays import frozen_float
from invid.recording.model import Recording
from invid.signals.frf import FrfMatrix


def paper_model(recording: Recording, paper: PaperResult, measured: FrfMatrix, warnings: list[str]) -> Model:
    """The model of the paper's route alone."""
    chains = paper.chains
    names_all, values = parameter_vector(chains)
    known = {n: float(np.sqrt(max(v, 0.0))) for n, (_, v) in paper.named.items()}
    std = np.array([known.get(name, np.nan) for name in names_all])
    doubts: list[Doubt] = []
    warnings = [*warnings, *paper.warnings]
    for name, value, error in zip(names_all, values, std, strict=True):
        if ".damper." in name or ".coupling" in name:
            continue
        if not np.isfinite(error) or error > LIMIT * abs(value):
            said = f"{name}: {value:.4g} ± {error:.2g} is not known; measure longer or use refined"
            doubts.append(Doubt(DoubtCode.UNSEEN, said))
            warnings.append(said)
    return Model(
        robot=recording.robot,
        method="paper",
        chains=chains,
        std=std_by_name(chains, known),
        linear=recording.linear,
        warnings=tuple(dict.fromkeys(warnings)),
        covariance=frozen_float(paper.covariance),
        parameter_names=tuple(known),
        fit={
            **doubt_facts(doubts),
            "resonances_hz": (np.sort(paper.modes.omega) / 2 / np.pi).tolist(),
            "frf_error": float(paper.modes.model_error),
            "band_hz": [float(measured.frequency_hz[0]), float(measured.frequency_hz[-1])],
        },
        provenance=provenance_of(recording),
    )


def widen_by_method_error(paper: PaperResult, measured: FrfMatrix) -> PaperResult:
    """The paper's result with the error of its method added to the covariance.

    The method takes damping to first order. Applied to the FRF of its own result it has to return that
    result; the standard deviations are widened by the difference.
    """
    omega = 2 * np.pi * measured.frequency_hz
    sizes, axes = paper.chains.masses_per_branch, paper.chains.axes
    try:
        repeated = identify_paper(
            measured.frequency_hz,
            frf(paper.chains, omega),
            measured.variance,
            sizes,
            axes=axes,
            start=paper.modes,
        )
        values = np.array([v for v, _ in paper.named.values()])
        method_error = np.array([v for v, _ in repeated.named.values()]) - values
    except (InvidError, np.linalg.LinAlgError, ValueError, FloatingPointError) as error:
        warning = f"the method could not be checked on its own result ({error}): its errors may be larger"
        return replace(paper, warnings=(*paper.warnings, warning))
    covariance = paper.covariance + np.diag(method_error**2)
    deviation = np.sqrt(np.maximum(np.diag(paper.covariance), 1e-300))
    found = paper.warnings
    if np.any((np.abs(method_error) > 2.0 * deviation) & (np.abs(method_error) > 1e-3 * np.abs(values))):
        worst = int(np.argmax(np.abs(method_error) / deviation))
        found = (
            *found,
            f"damping: applied to its own result the paper's method is off by "
            f"{abs(method_error[worst] / values[worst]):.1%} in {list(paper.named)[worst]}; standard "
            "deviations include it; refined has no such error",
        )
    return replace(paper, covariance=covariance, warnings=found)
