"""The paper's inverse on modes fitted to the FRF matrix, as a check of a fit and of itself."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from invid.errors import InvidError, NotIdentifiableError
from invid.inverse import PaperResult, identify_paper
from invid.model.chains import CoupledChains
from invid.model.document import Model, parameter_vector, stds_by_name
from invid.model.forward import frf
from invid.modes import Modes
from invid.modes.model import high_gain_pairs, modes_of_matrices, pairs
from invid.recording.model import Recording, Role
from invid.signals.drive_torque import replace_by_acting_torque
from invid.signals.frf import FrfMatrix, frf_matrix
from invid.signals.spectra import all_spectra

OWN_ERROR = 0.005
"""Relative error of the paper's route beyond its covariance (empirical): it has no hold and only viscous
friction."""
GRANTED_ERROR = 0.01
"""Share of every amplitude that counts as noise in the comparison with a rational FRF (physical: an error
below it does not matter)."""
MOST_MODES = 100
"""Modes times motors squared up to which the second route is taken (empirical: a second or two)."""


def second_route(recording: Recording, model: Model) -> PaperResult | InvidError:
    """The paper's inverse on modes of the FRF matrix; the search for poles starts at those of the model.

    A common start does not make the routes agree: modes know nothing of chains, and move to where the FRF has
    them.
    """
    sizes, axes = model.chains.masses_per_branch, model.axes
    if (sum(sizes) - len(sizes)) * len(sizes) ** 2 > MOST_MODES:
        return NotIdentifiableError("the plant is large: the second route takes minutes (--method paper)")
    spectra = replace_by_acting_torque(all_spectra(recording, Role.IDENTIFY), recording.experiments)
    if any(s.transient for s in spectra):
        return NotIdentifiableError("records that are not settled: the paper's method needs settled ones")
    offsets = [v["value"] for v in model.fit["time_offset_s"].values()]
    measured = frf_matrix(spectra, delay_s=float(np.mean(offsets)))
    if measured.frequency_hz.size < 8:
        return NotIdentifiableError("too few frequencies at which all axes are excited for a second route")
    variance = measured.variance + (GRANTED_ERROR * np.abs(measured.frf)) ** 2
    start = modes_of_chains(model.chains)
    try:
        return identify_paper(measured.frequency_hz, measured.frf, variance, sizes, axes=axes, start=start)
    except InvidError as error:
        return error
    except (np.linalg.LinAlgError, ValueError, FloatingPointError) as error:
        return NotIdentifiableError(f"the paper's method failed on these data: {error}")


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


def modes_of_chains(chains: CoupledChains) -> Modes:
    """The modes of a plant as its motors show them; no covariance."""
    modes = modes_of_matrices(
        chains.mass_matrix,
        chains.damping_matrix,
        chains.stiffness_matrix,
        chains.motor_dofs.tolist(),
        chains.masses_per_branch,
    )
    rows, columns = pairs(chains.branches)
    allowed = high_gain_pairs(chains.masses_per_branch)
    high = np.zeros_like(modes.high_gain)
    keep = (rows[allowed], columns[allowed])
    high[keep] = high[keep[1], keep[0]] = modes.high_gain[keep]
    return replace(modes, high_gain=high)


def compare_routes(
    paper: PaperResult | InvidError,
    model: Model,
    warnings: list[str],
) -> dict[str, Any]:
    """Return whether the paper's inverse and the maximum-likelihood fit agree within their joint uncertainty.

    The paper's route counts only where its modes explain the FRF to its noise; otherwise its covariance lacks
    its own error.
    """
    if isinstance(paper, InvidError):
        return {"paper": None, "reason": str(paper)}
    by_paper = paper.named
    names, values = parameter_vector(model.chains)
    known = stds_by_name(model)
    deviation = np.array([known.get(n, np.nan) for n in names])
    worst_name, worst = "", 0.0
    table: dict[str, float] = {}
    for k, name in enumerate(names):
        if name not in by_paper:
            continue
        value, variance = by_paper[name]
        table[name] = value
        joint = float(np.sqrt(max(variance, 0.0) + deviation[k] ** 2))
        joint = float(np.hypot(joint, OWN_ERROR * abs(values[k])))
        z = abs(value - values[k]) / joint if np.isfinite(joint) and joint > 0 else 0.0
        if z > worst:
            worst_name, worst = name, z
    is_sound = paper.modes.model_error == 0.0 and not paper.warnings
    # 4 standard deviations on the worst of a few dozen parameters.
    agree = bool(worst < 4.0)
    out: dict[str, Any] = {
        "paper": table,
        "agree": agree,
        "worst": {"name": worst_name, "deviations": float(worst)},
    }
    if not is_sound:
        out["reason"] = "the paper's route does not explain the FRF to its noise: no judge of the fit"
    elif not agree:
        warnings.append(
            f"the paper's inverse gives {table[worst_name]:.4g} for {worst_name}, the fit "
            f"{values[list(names).index(worst_name)]:.4g}, {worst:.1f} joint standard deviations apart: the "
            "structure (number of masses, friction, a spring to ground) may differ from the machine's"
        )
    return out
