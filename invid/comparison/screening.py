"""Test one short record against the accepted model: has anything changed, and where.

The record is fitted from the accepted parameters with everything free, friction, time offsets and
boundary terms among it. Where nothing changed the difference d of the parameters has covariance
S = C_record + C_model, and dᵀS⁻¹d is χ². Freeing a part of the machine takes its parameters out of the
sum (the marginal of the rest): the fewest parts without which the rest is not refuted are what changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invid.errors import ModelError, NotIdentifiableError
from invid.likelihood.fit import Fit, fit_structure
from invid.model.chains import CoupledChains
from invid.model.document import Model, chains_by_name, parameter_vector, std_by_name
from invid.model.parameters import structure_of
from invid.numerics.arrays import Bool, Float64, frozen_float
from invid.numerics.distributions import chi2_sf
from invid.planning.expected_covariance import is_in_goal, parameter_scale
from invid.recording.model import Recording, Role
from invid.signals.spectra import all_spectra

ALARM = 1e-3
"""Probability of refuting a machine that has not changed."""
SYSTEMATIC = 0.001
"""Relative difference of two records of one machine beyond their noise. Empirical: what friction that is
not quite Coulomb's leaves in records of five seconds of the simulated case study."""
EXPLAINED = 0.9
"""As in ``identify``: share of the torque that a linear model must explain."""
NEW_MISFIT = 4.0
"""Missing torque power against noise, over what the accepted model left, that is called something new;
empirical: blocks of different amplitude on one machine differ by less than 2."""
SEEN = 4.0
"""Standard deviations of a change that is seen nearly always at ``ALARM``."""


@dataclass(frozen=True, eq=False)
class Screening:
    """Verdict on one record.

    ``verdict`` is "unchanged", "changed" or "cannot tell"; ``parts`` are branches ("A2") and couplings
    ("A1-A2") whose parameters changed; ``detectable`` (n,) the relative change of each parameter that
    would have been seen.
    """

    verdict: str
    parts: tuple[str, ...]
    chi2: float
    dof: int
    probability: float
    names: tuple[str, ...]
    before: Float64
    now: Float64
    std: Float64
    detectable: Float64
    reason: str
    fit: Fit | None

    @property
    def refuted(self) -> tuple[str, ...]:
        """Names of all parameters of the changed parts."""
        return tuple(n for n in self.names if part_of(n) in self.parts)

    @property
    def sentence(self) -> str:
        """Return the verdict in a sentence."""
        if self.verdict == "unchanged":
            worst = int(np.argmax(self.detectable))
            return (
                f"nothing changed: χ² {self.chi2:.1f} on {self.dof} (probability {self.probability:.2g}); "
                f"a change of {100 * float(np.median(self.detectable)):.2g} % would have shown in most "
                f"parameters, {100 * self.detectable[worst]:.2g} % in {self.names[worst]}"
            )
        if self.verdict == "changed":
            moved = (self.now - self.before) / np.maximum(self.std, 1e-300)
            own = np.array([n in self.refuted for n in self.names])
            at = int(np.argmax(np.where(own, np.abs(moved), 0.0)))
            return (
                f"changed: {', '.join(self.parts)}; most clearly {self.names[at]}, {self.before[at]:.4g} → "
                f"{self.now[at]:.4g} ± {self.std[at]:.2g}"
            )
        return f"cannot tell: {self.reason}"

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "verdict": self.verdict,
            "changed": list(self.parts),
            "chi2": self.chi2 if np.isfinite(self.chi2) else None,
            "dof": self.dof,
            "probability": self.probability if np.isfinite(self.probability) else None,
            "summary": self.sentence,
            "parameters": [
                {"name": n, "before": float(b), "now": float(v), "std": float(s), "detectable": float(x)}
                for n, b, v, s, x in zip(
                    self.names, self.before, self.now, self.std, self.detectable, strict=True
                )
            ],
        }


def part_of(name: str) -> str:
    """ "A2" for "A2.mass.3", "A1-A2" for "A1-A2.coupling"."""
    if name.endswith(".coupling"):
        return name.removesuffix(".coupling")
    return name.rsplit(".", 2)[0]


def screen(recording: Recording, model: Model) -> Screening:
    """Test a record against the accepted model.

    Raises
    ------
    ModelError
        A model without a covariance, or of other axes.
    """
    names, before, prior = accepted(model, recording.axes)
    empty = np.full(len(names), np.nan)

    def unable(reason: str) -> Screening:
        return Screening(
            "cannot tell", (), np.nan, 0, np.nan, names, before, empty, empty, empty, reason, None
        )

    try:
        fit = refit_from(recording, model.chains)
    except NotIdentifiableError as error:
        return unable(str(error))
    if fit.solution.result != "converged" or fit.explained < EXPLAINED:
        return unable(
            f"the accepted structure explains {fit.explained:.0%} of the torque only "
            f"(fit {fit.solution.result}): identify anew"
        )
    now, covariance = fitted_values(fit, names)
    if not np.isfinite(covariance).all():
        return unable("the record does not show every parameter: excite every axis, or longer")
    scale = parameter_scale(model.chains)[is_in_goal(parameter_vector(model.chains)[0])]
    spread = prior + covariance + np.diag((SYSTEMATIC * scale) ** 2)
    difference = now - before
    chi2 = _quadratic(difference, spread)
    probability = chi2_sf(chi2, len(names))
    std = np.sqrt(np.diag(spread))
    facts = (chi2, len(names), probability, names, before, now, std, SEEN * std / scale)
    misfit = fit.noise_chi2 / max(float(model.fit.get("noise_chi2_per_dof") or 1.0), 1.0)
    if probability >= ALARM:
        if misfit > NEW_MISFIT:
            text = (
                f"masses and springs are as they were, but {misfit:.1f} times as much torque power is "
                "missing as the accepted model left: something else acts; measure fully and run invid "
                "diagnose"
            )
            return Screening("cannot tell", (), *facts, text, fit)
        return Screening("unchanged", (), *facts, "", fit)
    return Screening("changed", changed_parts(names, difference, spread), *facts, "", fit)


def accepted(model: Model, axes: Sequence[str]) -> tuple[tuple[str, ...], Float64, Float64]:
    """Names, values and covariance of the masses, springs and couplings of an accepted model."""
    if model.axes != tuple(axes):
        raise ModelError(
            f"the model has axes {', '.join(model.axes)}, the cell {', '.join(axes)}; give its own model"
        )
    if model.covariance is None:
        raise ModelError(
            "the model has no covariance, so nothing can be tested against it; identify once more with "
            "--method refined and data that show every parameter"
        )
    everything, values = parameter_vector(model.chains)
    wanted = is_in_goal(everything)
    names = tuple(n for n, w in zip(everything, wanted, strict=True) if w)
    place = {n: k for k, n in enumerate(model.parameter_names)}
    index = [place[n] for n in names]
    return names, values[wanted], model.covariance[np.ix_(index, index)]


def refit_from(recording: Recording, start: CoupledChains) -> Fit:
    """The maximum-likelihood fit of the record from known parameters."""
    spectra = all_spectra(recording, Role.IDENTIFY)
    if not spectra:
        raise NotIdentifiableError("no experiment shakes an axis")
    return fit_structure(spectra, structure_of(start), [start])


def fitted_values(fit: Fit, names: Sequence[str]) -> tuple[Float64, Float64]:
    """Values and covariance of the named parameters."""
    place = {n: k for k, n in enumerate(fit.names)}
    index = [place[n] for n in names]
    return fit.values[index], fit.covariance[np.ix_(index, index)]


def changed_parts(names: Sequence[str], difference: Float64, spread: Float64) -> tuple[str, ...]:
    """Return the fewest parts whose freeing leaves a rest that is not refuted."""
    parts = list(dict.fromkeys(part_of(n) for n in names))
    owner = np.array([parts.index(part_of(n)) for n in names])
    freed: list[int] = []
    while len(freed) < len(parts):
        keep: Bool = ~np.isin(owner, freed)
        if _likely(difference[keep], spread[np.ix_(keep, keep)])[0] >= ALARM:
            break
        left = []
        for part in range(len(parts)):
            if part in freed:
                left.append(-1.0)
                continue
            rest = keep & (owner != part)
            likely, value = _likely(difference[rest], spread[np.ix_(rest, rest)])
            # far out every probability is zero: there χ² itself decides
            left.append(likely + 1e-12 / (1.0 + value))
        freed.append(int(np.argmax(left)))
    return tuple(parts[k] for k in sorted(freed))


def update_model(model: Model, screening: Screening, fit: Fit) -> Model:
    """The accepted model with its changed parts measured again.

    Unchanged masses, springs and couplings keep what was known of them, as a Gaussian prior; the
    parameters of the changed parts come from the new records alone. Dampers come from the new records.
    """
    everything, _ = parameter_vector(model.chains)
    now, covariance = fitted_values(fit, everything)
    known, before, prior = accepted(model, model.axes)
    kept = [k for k, n in enumerate(known) if n not in screening.refuted]
    pick = np.zeros((len(kept), len(everything)))
    for row, k in enumerate(kept):
        pick[row, everything.index(known[k])] = 1.0
    # Gaussian update: gain = C Pᵀ (P C Pᵀ + C₀)⁻¹
    inner = pick @ covariance @ pick.T + prior[np.ix_(kept, kept)]
    gain = np.linalg.solve(inner, pick @ covariance).T
    values = now + gain @ (before[kept] - pick @ now)
    spread = covariance - gain @ pick @ covariance
    spread = 0.5 * (spread + spread.T)
    # Masses, springs and dampers are positive; couplings have a sign.
    least = [-np.inf if n.endswith(".coupling") else 0.0 for n in everything]
    chains = chains_by_name(model.chains, dict(zip(everything, np.maximum(values, least), strict=True)))
    std = np.sqrt(np.maximum(np.diag(spread), 0.0))
    return replace(
        model,
        chains=chains,
        std=std_by_name(chains, dict(zip(everything, std, strict=True))),
        covariance=frozen_float(spread),
        parameter_names=everything,
        fit={**model.fit, "remeasured": list(screening.parts), "noise_chi2_per_dof": fit.noise_chi2},
    )


def _likely(difference: Float64, spread: Float64) -> tuple[float, float]:
    """Return the probability of a χ² at least as large, and the χ² itself."""
    value = _quadratic(difference, spread)
    return (chi2_sf(value, difference.size) if difference.size else 1.0), value


def _quadratic(difference: Float64, spread: Float64) -> float:
    if difference.size == 0:
        return 0.0
    ruler = np.sqrt(np.diag(spread))
    scaled = spread / ruler[:, None] / ruler
    d = difference / ruler
    return float(d @ np.linalg.solve(scaled, d))
