"""Turn fits into models: values, standard deviations, doubts, warnings, and the facts of the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np

from invid.errors import InvidError
from invid.identification.crosscheck import (
    BEATEN,
    MOST_BEATEN,
    SUSPECT,
    compare_routes,
    missed_by_structure,
)
from invid.identification.identifiability import Unidentifiable, blind_directions
from invid.inverse import PaperResult
from invid.likelihood.fit import Fit
from invid.model.document import EffectTerm, Estimate, Model, parameter_vector, std_by_name, units
from invid.model.doubts import Doubt, DoubtCode, doubt_facts
from invid.numerics import budget
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.model import Recording, Role
from invid.signals.frf import FrfMatrix
from invid.signals.spectra import LineSpectra

EXPLAINED = 0.9
"""Share of the torque a trustworthy model explains. Empirical: real drives with friction stand above
0.99, a wrong order or a torque that is none below 0.7 (flexible bench, case study)."""


CUT_SHORT = "cut_short"
"""Name of the doubts, among the facts of a fit, that a spent budget makes: nothing is concluded from them."""


def provenance_of(recording: Recording) -> dict[str, Any]:
    """What a model says of where it comes from."""
    return {
        "software": f"invid {version('invid')}",
        "recording": recording.source,
        "recorded": recording.created,
        "experiments": [e.key for e in recording.experiments if e.role is Role.IDENTIFY],
    }


def paper_model(
    recording: Recording,
    paper: PaperResult,
    measured: FrfMatrix,
    warnings: list[str],
    order: dict[str, Any],
) -> Model:
    """The model of the paper's route alone."""
    chains = paper.chains
    names_all, values = parameter_vector(chains)
    known = {n: float(np.sqrt(max(v, 0.0))) for n, (_, v) in paper.named.items()}
    std = np.array([known.get(name, np.nan) for name in names_all])
    doubts = _doubts_of_order(order)
    warnings = [*warnings, *paper.warnings, *(d.text for d in doubts)]
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
            **({"order": order} if order else {}),
        },
        provenance=provenance_of(recording),
    )


def _doubts_of_order(order: Mapping[str, Any]) -> list[Doubt]:
    """Doubts about structures that the data cannot tell apart: other parameters, the same motion."""
    if not order.get("alike"):
        return []
    alike = " and ".join(",".join(map(str, n)) for n in (order["chosen"], *order["alike"]))
    return [
        Doubt(
            DoubtCode.ORDER_OPEN,
            f"order: {alike} masses explain these data alike: the motors do not show on which branch the "
            "further mass is; say it with --masses",
        )
    ]


def refined_model(
    recording: Recording,
    spectra: Sequence[LineSpectra],
    fit: Fit,
    paper: PaperResult | InvidError,
    warnings: list[str],
    order: dict[str, Any],
) -> Model:
    """The model of a maximum-likelihood fit, with the doubts about it."""
    chains = fit.chains
    names, values = parameter_vector(chains)
    place = {name: k for k, name in enumerate(fit.names)}
    index = [place[n] for n in names]
    covariance = fit.covariance[np.ix_(index, index)]
    top = max(float(s.frequency_hz[s.excited].max()) for s in spectra if s.excited.any())
    bottom = min(float(s.frequency_hz[s.excited].min()) for s in spectra if s.excited.any())
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    blind = blind_directions(chains, names, values, covariance, (bottom, top))
    doubts: list[Doubt] = []
    unseen: list[str] = []
    cut_short: list[str] = []
    if fit.solution.result != "converged":
        said = f"the fit did not converge ({fit.solution.result} after {fit.solution.iterations} iterations)"
        doubts.append(Doubt(DoubtCode.NOT_CONVERGED, said))
        cut_short = [said] if budget.is_spent() else []
    if blind.unseen:
        std = np.where([n in blind.unseen for n in names], np.nan, std)
        unseen += blind.sentences or [f"{', '.join(sorted(blind.unseen))}: not known from these data"]
        doubts += [Doubt(DoubtCode.UNSEEN, said) for said in unseen]
    if fit.explained < EXPLAINED:
        said = (
            f"the model explains {fit.explained:.0%} of the torque only: another number of masses, a torque "
            "channel that is not the motor torque, or axes that do not move freely"
        )
        doubts.append(Doubt(DoubtCode.LITTLE_EXPLAINED, said, {"share": fit.explained}))
    doubts += _doubts_of_order(order)
    missed_ratio, missed_power = missed_by_structure(spectra, fit) if fit.noise_chi2 > SUSPECT else (0.0, 0.0)
    if missed_ratio > MOST_BEATEN and missed_power > MOST_BEATEN:
        times = float(np.sqrt(missed_ratio))
        said = (
            f"an FRF without structure misses the records by {times:.2g} times less than the "
            "fitted plant: the fit stands in a wrong minimum, or the machine has another structure (number "
            "of masses, springs to ground)"
        )
        doubts.append(Doubt(DoubtCode.WRONG_STRUCTURE, said, {"times": times}))
    warnings += [d.text for d in doubts]
    if fit.noise_chi2 > 2.0:
        warnings.append(
            f"the torque is missed by {np.sqrt(fit.noise_chi2):.2g} times its noise: something acts that the "
            "model does not contain; standard deviations include it; invid diagnose names it where it can"
        )
    for axis in fit.facts["hold_timing"]:
        warnings.append(
            f"{axis}: a hold works while this axis is driven, and nothing tells whether it acts inside the "
            "drive or is held over the sample: the standard deviation of its motor mass covers both; record "
            "a torque_demand that leaves the hold out, drive the axis without a hold, or state hold_by"
        )
    for axis, lag in fit.facts["torque_lag_s"].items():
        if abs(lag["value"]) > 3.0 * lag["std"]:
            channel = "torque" if lag["value"] > 0 else "position"
            warnings.append(
                f"{axis}: the recorded {channel} is low-passed ({1e3 * abs(lag['value']):.3g} ± "
                f"{1e3 * lag['std']:.1g} ms, a lag, no mere delay); the parameters are corrected for it"
            )
    routes = compare_routes(paper, names, values, covariance, warnings)
    finite = np.isfinite(covariance).all()
    facts = {
        **doubt_facts(doubts),
        "unseen": unseen,
        **({CUT_SHORT: cut_short} if cut_short else {}),
        "chi2": fit.solution.chi2,
        "dof": fit.solution.dof,
        "noise_chi2_per_dof": fit.noise_chi2,
        "explained": fit.explained,
        BEATEN: missed_ratio if missed_power > MOST_BEATEN else 0.0,
        "band_hz": [bottom, top],
        "lines": {b.key: int(b.omega.size) for b in fit.problem.blocks},
        "periods": {s.key: s.periods for s in spectra},
        **{k: v for k, v in fit.facts.items() if k not in ("chi2", "dof")},
        "correlations": _correlations(names, covariance),
        "routes": routes,
        **({"order": order} if order else {}),
    }
    return Model(
        robot=recording.robot,
        method="refined",
        chains=chains,
        std=std_by_name(chains, dict(zip(names, std, strict=True))),
        linear=recording.linear,
        effects=_significant_friction(fit, recording),
        warnings=tuple(dict.fromkeys(warnings)),
        covariance=frozen_float(covariance) if finite else None,
        parameter_names=names if finite else (),
        fit=_plain_json(facts),
        provenance=provenance_of(recording),
    )


def _correlations(names: Sequence[str], covariance: Float64) -> list[list[Any]]:
    """[name, name, correlation] of pairs with |ρ| > 0.9."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    found = []
    for i in range(len(names)):
        for j in range(i + 1, len(names)):
            scale = deviation[i] * deviation[j]
            rho = covariance[i, j] / scale if np.isfinite(scale) and scale > 0 else 0.0
            if abs(rho) > 0.9:
                found.append([names[i], names[j], round(float(rho), 4)])
    return sorted(found, key=lambda row: -abs(row[2]))


def _significant_friction(fit: Fit, recording: Recording) -> tuple[EffectTerm, ...]:
    """Significant friction of the fit as effects of the model, without which its simulation would not
    damp."""
    torque = "N" if recording.linear else "N·m"
    damping = units(recording.linear)["damping"]
    found = []
    for name, estimate in fit.facts["friction"].items():
        # Names read A1.coulomb, A1.viscous, A1.viscous.2; axis names may hold dots of their own.
        value, std = estimate["value"], estimate["std"]
        if not value > 3.0 * std:
            continue
        if name.endswith(".coulomb"):
            axis = name.removesuffix(".coulomb")
            found.append(
                EffectTerm(
                    "coulomb_friction", axis, {"torque": Estimate(value, std, torque)}, element="mass 1"
                )
            )
            continue
        axis, _, number = name.rpartition(".viscous")
        element = f"mass {number.removeprefix('.') or 1}"
        found.append(
            EffectTerm(
                "viscous_friction", axis, {"coefficient": Estimate(value, std, damping)}, element=element
            )
        )
    return tuple(found)


def _plain_json(value: Any) -> Any:
    """The value for strict JSON: NaN and infinity become null."""
    if isinstance(value, dict):
        return {k: _plain_json(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain_json(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    return value
