"""Models drawn from what an identification leaves open: its covariance, and causes that may be others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.clauses import cause_name
from invid.errors import ModelError, NotIdentifiableError
from invid.exchange.linear_plant import LINEAR, parameter_spread
from invid.model.diagnosis_document import Diagnosis, Finding
from invid.model.document import EffectTerm, Estimate, Model, with_parameters
from invid.wording.sentence import joined, sentence

LOOP_CAUSES = (*LINEAR, "torque_delay")
"""Causes that the loops feel; all others are forces that feedforward or repair answers."""
_SWAPS = {"torque_delay": ("torque_lag", "delay", "time_constant"),
          "torque_lag": ("torque_delay", "time_constant", "delay")}  # fmt: skip
"""Causes whose look-alike has the same size under another name: cause, own parameter, the other's."""
_TRIES = 50


@dataclass(frozen=True, eq=False)
class Candidates:
    """The models that the data leave open, the stated one first, and what was found open.

    ``open_terms`` are effects whose cause may be another one.
    """

    models: tuple[Model, ...]
    open_terms: tuple[EffectTerm, ...]
    remarks: tuple[str, ...]


def candidates(source: Model | Diagnosis) -> Candidates:
    """Every plant that a diagnosis leaves open.

    Raises
    ------
    NotIdentifiableError
        The model is not to be trusted, or a cause that the loops feel has an alternative of unknown size.
    """
    model = source.model if isinstance(source, Diagnosis) else source
    if not model.fit.get("trustworthy", True):
        raise NotIdentifiableError(
            "the model is not to be trusted, its own warnings say why",
            way_out="measure again before anything is tuned on it",
        )
    models, remarks, terms = [model], list[str](), []
    for finding in source.findings if isinstance(source, Diagnosis) else ():
        if not finding.alternatives:
            continue
        terms.append(finding.effect)
        others = joined([cause_name(a.cause) for a in finding.alternatives])
        said = {"axis": finding.axis, "cause": cause_name(finding.cause), "others": others}
        if {finding.cause, *(a.cause for a in finding.alternatives)}.isdisjoint(LOOP_CAUSES):
            remarks.append(
                sentence("{axis}: {cause} may also be {others}; these are forces: same loops", **said)
            )
            continue
        for alternative in _alternatives(finding):
            place = _place(finding.effect)
            kept = [e for e in model.effects if _place(e) != place]
            models.append(replace(model, effects=(*kept, alternative)))
        remarks.append(
            sentence("{axis}: {cause} may also be {others}; designed for the worse of them", **said)
        )
    return Candidates(tuple(models), tuple(terms), tuple(remarks))


def _place(term: EffectTerm) -> tuple[str | None, ...]:
    return term.cause, term.axis, term.element, term.other_axis


def _alternatives(finding: Finding) -> list[EffectTerm]:
    out = []
    for a in finding.alternatives:
        swap = _SWAPS.get(finding.cause)
        if a.cause == finding.cause:
            out.append(replace(finding.effect, axis=a.axis, element=a.element, other_axis=a.other_axis))
        elif swap is not None and a.cause == swap[0] and a.axis == finding.axis:
            out.append(EffectTerm(a.cause, a.axis, {swap[2]: finding.effect.parameters[swap[1]]}))
        else:
            experiment = (finding.separating_experiment or {}).get("text") or "the separating experiment"
            raise NotIdentifiableError(
                f"{finding.axis}: {finding.cause} may also be {a.cause} on {a.axis} of unknown size, "
                "and the loops feel which of them it is",
                way_out=f"tell them apart first: {experiment}",
            )
    return out


def drawn_models(models: Sequence[Model], count: int, rng: np.random.Generator) -> list[Model]:
    """``count`` models, drawn in turn from each of ``models``: parameters jointly from the covariance (masses
    and springs as logarithms), sizes of linear effects by their standard deviations.

    A damper of unknown spread is drawn evenly between nothing and its value: less damping is the worse case.

    Raises
    ------
    NotIdentifiableError
        A mass or a spring has no standard deviation: nothing can be promised on it.
    """
    return [_drawn(models[k % len(models)], rng) for k in range(count)]


def _drawn(model: Model, rng: np.random.Generator) -> Model:
    spread = parameter_spread(model)
    known = np.isfinite(np.diag(spread.covariance))
    lost = [
        n for n, k in zip(spread.names, known, strict=True)
        if not k and (".mass." in n or ".spring." in n)
    ]  # fmt: skip
    if lost:
        raise NotIdentifiableError(
            f"{', '.join(lost)}: the data cannot tell its value, so no margin can be promised",
            way_out="the model's warnings say what measurement would tell it",
        )
    within = spread.covariance[np.ix_(known, known)]
    for _ in range(_TRIES):
        delta, values = np.zeros(spread.values.size), {}
        delta[known] = rng.multivariate_normal(
            np.zeros(within.shape[0]), within, check_valid="ignore", method="eigh"
        )
        for name, value, step, is_known in zip(spread.names, spread.values, delta, known, strict=True):
            if ".damper." in name:
                values[name] = max(0.0, value + step) if is_known else value * rng.uniform()
            elif ".coupling" in name[-9:]:
                values[name] = value + step
            else:
                values[name] = value * math.exp(step / value)
        try:
            chains = with_parameters(model.chains, values)
        except ModelError:  # couplings too large for these masses
            continue
        return replace(model, chains=chains, effects=tuple(_drawn_term(e, rng) for e in model.effects))
    raise NotIdentifiableError(
        "hardly any draw of the covariance is a possible machine; the couplings are too uncertain",
        way_out="measure longer, or with more amplitude",
    )


def _drawn_term(term: EffectTerm, rng: np.random.Generator) -> EffectTerm:
    if term.cause not in LOOP_CAUSES:
        return term

    def drawn(p: Estimate) -> Estimate:
        if not p.std or p.value == 0:
            return p
        step = rng.standard_normal() * p.std
        value = p.value + step if term.cause == "coupling_stiffness" else p.value * math.exp(step / p.value)
        return replace(p, value=value)

    return replace(term, parameters={k: drawn(p) for k, p in term.parameters.items()})
