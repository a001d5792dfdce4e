"""Two checks of a fit by methods with less structure.

The paper's inverse on modes fitted to the FRF matrix, and a rational FRF of no structure at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from invid.errors import InvidError, NotIdentifiableError
from invid.inverse import PaperResult, identify_paper
from invid.likelihood.fit import Fit
from invid.likelihood.levenberg_marquardt import Solution
from invid.likelihood.residual import MissingTorqueProblem
from invid.model.chains import CoupledChains
from invid.model.forward import frf
from invid.modes import Modes
from invid.modes.model import high_gain_pairs, modes_of_matrices, pairs
from invid.modes.pole_search import Unstructured, unstructured
from invid.numerics.arrays import Float64
from invid.signals.frf import FrfMatrix, frf_matrix
from invid.signals.spectra import LineSpectra

OWN_ERROR = 0.005
"""Relative error of the paper's route beyond its covariance (empirical): it has no hold and only viscous
friction."""
GRANTED_ERROR = 0.01
"""Share of every amplitude that counts as noise in the comparison with a rational FRF (physical: an error
below it does not matter)."""
MOST_MODES = 100
"""Modes times motors squared up to which the second route is taken (empirical: a second or two)."""
SUSPECT = 5.0
"""χ²/ν against sensor noise above which the fit is compared with a rational FRF of no structure."""
MOST_BEATEN = 4.0
"""Missed mean square of the fit, over that of a rational FRF and over that of 1 % of the amplitudes, above
which it is doubted (empirical): a factor of two in amplitude."""
BEATEN = "missed_over_free_frf"
"""Name of that ratio in the facts of a fit."""
MORE_MODES = 2
"""Modes the rational FRF may have beyond the model's: one that the model lacks, and one for friction."""


def missed_by_structure(spectra: Sequence[LineSpectra], fit: Fit) -> tuple[float, float]:
    """Missed power of the fit over that of a rational FRF, and the first alone; (0, 0) without a rational
    FRF.

    Both are mean squares on the same lines, with the sensors' noise plus ``GRANTED_ERROR`` of every amplitude
    as unit. Both miss a machine that is not linear alike: the ratio stays near one. It is large for a fit in
    a wrong minimum, or a structure that cannot move as the machine does (springs to ground, masses too few).
    """
    return FreeFrf(spectra, fit.structure.sizes).missed(fit.problem, fit.solution)


class FreeFrf:
    """A rational FRF of no structure, fitted once, and fits beside it."""

    def __init__(self, spectra: Sequence[LineSpectra], sizes: Sequence[int]) -> None:
        self._spectra, self._sizes = spectra, tuple(sizes)

    @cached_property
    def _found(self) -> Unstructured | None:
        try:
            with np.errstate(all="ignore"):
                return unstructured(self._spectra, self._sizes, further=MORE_MODES, model_error=GRANTED_ERROR)
        except np.linalg.LinAlgError:  # a pole upon a line of the record: the search ended nowhere
            return None

    def misses_too(self) -> bool:
        """Return whether it misses far more than noise and ``GRANTED_ERROR`` as well: no start of a
        linear structure reaches either.
        """
        return self._found is not None and self._found.mean_square > SUSPECT

    def is_no_better(self, problem: MissingTorqueProblem, solution: Solution) -> bool:
        """Return whether it misses as much as a fit, to a factor of two in amplitude: what is missing
        is no other start's.
        """
        return 0.0 < self.missed(problem, solution)[0] <= MOST_BEATEN

    def missed(self, problem: MissingTorqueProblem, solution: Solution) -> tuple[float, float]:
        """As ``missed_by_structure``."""
        found = self._found
        if found is None:
            return 0.0, 0.0
        left, rows = 0.0, 0
        for record, state in zip(found.records, problem.states(solution.p), strict=True):
            omega, _, _, weight, _ = record
            lines = np.searchsorted(state.block.omega, omega * (1.0 - 1e-9))
            lines = np.minimum(lines, state.block.omega.size - 1)
            shared = np.abs(state.block.omega[lines] / omega - 1.0) < 1e-6
            lines = lines[shared]
            # Missing torque as the acceleration error it stands for: ω²G r.
            acceleration_error = np.linalg.solve(state.stiffness[lines], state.residual[lines][..., None])
            error = np.abs((omega[shared] ** 2)[:, None] * acceleration_error[..., 0] * weight[shared])
            left += float((error**2).sum())
            rows += 2 * error.size
        own = left / max(rows, 1)
        return own / max(found.mean_square, 0.5), own


def second_route(spectra: Sequence[LineSpectra], fit: Fit) -> PaperResult | InvidError:
    """The paper's inverse on modes of the FRF matrix; the search for poles starts at those of the fit.

    A common start does not make the routes agree: modes know nothing of chains, and move to where the FRF has
    them.
    """
    sizes, axes = fit.structure.sizes, fit.structure.axes
    if (sum(sizes) - len(sizes)) * len(sizes) ** 2 > MOST_MODES:
        return NotIdentifiableError("the plant is large: the second route takes minutes (--method paper)")
    if any(s.transient for s in spectra):
        return NotIdentifiableError("records that are not settled: the paper's method needs settled ones")
    offsets = [v["value"] for k, v in fit.facts["time_offset_s"].items() if k.endswith(".time_offset")]
    measured = frf_matrix(spectra, delay_s=float(np.mean(offsets)) if offsets else 0.0)
    if measured.frequency_hz.size < 8:
        return NotIdentifiableError("too few frequencies at which all axes are excited for a second route")
    variance = measured.variance + (GRANTED_ERROR * np.abs(measured.frf)) ** 2
    start = modes_of_chains(fit.chains)
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
    names: Sequence[str],
    values: Float64,
    covariance: Float64,
    warnings: list[str],
) -> dict[str, Any]:
    """Return whether the paper's inverse and the maximum-likelihood fit agree within their joint uncertainty.

    The paper's route counts only where its modes explain the FRF to its noise; otherwise its covariance lacks
    its own error.
    """
    if isinstance(paper, InvidError):
        return {"paper": None, "reason": str(paper)}
    by_paper = paper.named
    worst_name, worst = "", 0.0
    table: dict[str, float] = {}
    for k, name in enumerate(names):
        if name not in by_paper:
            continue
        value, variance = by_paper[name]
        table[name] = value
        joint = float(np.sqrt(max(variance, 0.0) + max(covariance[k, k], 0.0)))
        joint = float(np.hypot(joint, OWN_ERROR * abs(values[k])))
        z = abs(value - values[k]) / joint if np.isfinite(joint) and joint > 0 else 0.0
        if z > worst:
            worst_name, worst = name, z
    is_sound = paper.modes.model_error == 0.0 and not paper.warnings
    # 4 standard deviations on the worst of a few dozen parameters.
    agree = worst < 4.0
    out: dict[str, Any] = {
        "paper": table,
        "agree": agree,
        "worst": {"name": worst_name, "deviations": worst},
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


__all__ = [
    "compare_routes",
    "missed_by_structure",
    "modes_of_chains",
    "second_route",
    "widen_by_method_error",
]
