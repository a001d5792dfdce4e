"""The model of the paper's inverse alone."""

from __future__ import annotations

import numpy as np

from invid.identification.fitted_model import provenance_of
from invid.identification.identifiability import Unidentifiable
from invid.inverse import PaperResult
from invid.model.document import Model, parameter_vector, std_by_name
from invid.model.doubts import Doubt, DoubtCode, doubt_facts
from invid.numerics.arrays import frozen_float
from invid.recording.model import Recording
from invid.signals.frf import FrfMatrix


def paper_model(
    recording: Recording,
    paper: PaperResult,
    measured: FrfMatrix,
    warnings: list[str],
) -> Model:
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
        if not np.isfinite(error) or error > Unidentifiable.LIMIT * abs(value):
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
