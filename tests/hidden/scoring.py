"""Whether a diagnosis found what was hidden. One rule for the tests and for the campaigns."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from hidden.generator import TrueEffect, Truth
from invid.model.diagnosis_document import Diagnosis, Finding, Verdict
from invid.model.document import model_from_json

CONFIDENT = 0.9
"""A wrong name from here on is what the product must not do."""

MAIN = {
    "coulomb_friction": "torque",
    "viscous_friction": "coefficient",
    "stribeck_friction": "coulomb",
    "presliding_friction": "torque",
    "asymmetric_friction": "coulomb_positive",
    "torque_offset": "torque",
    "cogging": "torque",
    "torque_delay": "delay",
    "torque_lag": "time_constant",
    "torque_gain": "gain",
    "torque_saturation": "limit",
    "encoder_eccentricity": "amplitude",
    "dropped_samples": "fraction",
    "spring_damping": "coefficient",
    "cubic_stiffness": "coefficient",
    "backlash": "gap",
    "spring_hysteresis": "torque",
    "transmission_error": "amplitude",
    "gravity": "torque",
    "extra_mode": "mass",
    "coupling_stiffness": "stiffness",
    "base_compliance": "stiffness",
    "payload_change": "mass",
    "parameter_drift": "rate",
}


@dataclass(frozen=True)
class Score:
    """``outcome``: right, cannot_tell (true cause among the alternatives), unexplained, missed (called
    consistent), wrong_place (right cause), wrong, and false_alarm; for pairs one_of_two as well."""

    outcome: str
    named: str
    confidences: tuple[tuple[float, bool], ...] = ()
    """(confidence, right) of every finding."""
    wrong_confident: bool = False
    size_error: float | None = None
    """(estimate − truth)/truth of the main parameter."""
    size_sigmas: float | None = None
    over_floor: float | None = None
    """Residual after extension over the noise floor, worst axis."""


def at_place(e: TrueEffect, axis: str, element: str | None, other_axis: str | None) -> bool:
    """Whether a place named is the true one; an element that is not named leaves it open."""
    if e.cause == "base_compliance":  # under all axes
        return True
    if e.other_axis is not None:
        return {axis, other_axis} == {e.axis, e.other_axis}
    if axis != e.axis:
        # Of two axes, one scaled by g and the other by 1/g are the same data: the common scale is invisible.
        return e.cause == "torque_gain" and e.either_axis
    return e.element is None or element is None or element == e.element


def names(e: TrueEffect, f: Finding) -> bool:
    """The finding is the true cause at the true place."""
    return f.effect.cause == e.cause and at_place(e, f.effect.axis, f.effect.element, f.effect.other_axis)


def _listed(e: TrueEffect, f: Finding) -> bool:
    return any(a.cause == e.cause and at_place(e, a.axis, a.element, a.other_axis) for a in f.alternatives)


def score(truth: Truth, d: Diagnosis) -> Score:
    """Compare a diagnosis with what was hidden."""
    named = "+".join(f.effect.cause for f in d.findings) or str(d.verdict)
    true = [e for e in truth.effects if e.in_catalogue]
    # A mass too few declared is a mode too few: that is what an extra mode says.
    spare = truth.kind == "wrong_order"
    flags = tuple(
        (f.confidence, any(names(e, f) for e in true) or (spare and f.effect.cause == "extra_mode"))
        for f in d.findings
    )
    floors = [r.after / r.noise_floor for r in d.residual if r.noise_floor]
    common: dict[str, Any] = {
        "named": named,
        "confidences": flags,
        "wrong_confident": any(
            c >= CONFIDENT and not good and not any(_listed(e, f) for e in true)
            for (c, good), f in zip(flags, d.findings, strict=True)
        ),
        "over_floor": max(floors) if floors else None,
    }
    if truth.kind == "null":
        return Score(
            "right" if d.verdict is Verdict.CONSISTENT and not d.findings else "false_alarm", **common
        )
    if truth.kind == "wrong_order":
        return Score(_wrong_order(truth, d), **common)
    if truth.kind == "outside":
        if d.verdict is Verdict.CONSISTENT:
            return Score("missed", **common)
        good = d.verdict in (Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED)
        return Score("right" if good else "wrong", **common)
    hits = [any(names(e, f) for f in d.findings) or _in_the_dampers(e, truth, d) for e in true]
    sizes = _size(true[0], d)
    common |= {"size_error": sizes[0], "size_sigmas": sizes[1]}
    if truth.kind == "pair":
        wrong = any(not good for _, good in flags)
        if all(hits):
            return Score("right" if not wrong else "right_and_wrong", **common)
        listed = [h or any(_listed(e, f) for f in d.findings) for h, e in zip(hits, true, strict=True)]
        if all(listed):
            return Score("cannot_tell", **common)
        if any(hits):
            return Score("one_of_two" if not wrong else "one_and_wrong", **common)
        return Score(_nothing_right(true, d), **common)
    if all(hits):
        extra = [f for f, (_, good) in zip(d.findings, flags, strict=True) if not good]
        return Score("right_and_wrong" if extra else "right", **common)
    return Score(_nothing_right(true, d), **common)


def _in_the_dampers(e: TrueEffect, truth: Truth, d: Diagnosis) -> bool:
    """A damper beside every spring is in the linear model: nothing is missing once it is fitted.

    Where anything is named the extended model's damper has to be the true one, to a tenth or three of its
    standard deviations; where nothing is, nothing may be missing.
    """
    if e.cause != "spring_damping":
        return False
    if not d.findings:
        return d.verdict is Verdict.CONSISTENT
    chains, axis = d.model.chains, truth.chains.axes.index(e.axis)
    if chains.masses_per_branch != truth.chains.masses_per_branch or e.element is None:
        return False
    at = int(e.element.split()[1]) - 1
    true = float(truth.chains.dampers[axis][at]) + e.parameters["coefficient"]
    std = float(d.model.std.dampers[axis][at])
    return abs(float(chains.dampers[axis][at]) - true) < max(0.1 * true, 3.0 * std)


def _nothing_right(true: list[TrueEffect], d: Diagnosis) -> str:
    if not d.findings:
        return "missed" if d.verdict is Verdict.CONSISTENT else "unexplained"
    if any(_listed(e, f) for e in true for f in d.findings):
        return "cannot_tell"
    if any(f.effect.cause == e.cause for e in true for f in d.findings):
        return "wrong_place"
    return "wrong"


def _wrong_order(truth: Truth, d: Diagnosis) -> str:
    """Any honest sign that the number of masses is not the one declared; no other cause named."""
    true = tuple(len(m) for m in truth.chains.masses)
    if d.model.chains.masses_per_branch == true and not d.findings:
        return "right"
    if all(f.effect.cause == "extra_mode" for f in d.findings) and d.verdict is not Verdict.CONSISTENT:
        return "right"
    if not d.findings and d.verdict is Verdict.CONSISTENT:
        # One mass too many does no harm; one too few that is invisible in the band neither.
        return "right" if sum(d.model.chains.masses_per_branch) >= sum(true) else "missed"
    return "wrong"


def _size(e: TrueEffect, d: Diagnosis) -> tuple[float | None, float | None]:
    for f in d.findings:
        if names(e, f):
            key = MAIN[e.cause]
            found = f.effect.parameters.get(key)
            if found is None or key not in e.parameters:
                return None, None
            value, true = found.value, e.parameters[key]
            if e.cause == "torque_gain":
                if f.effect.axis != e.axis:
                    true = 1.0 / true
                value, true = value - 1.0, true - 1.0
            elif e.cause not in ("torque_offset", "parameter_drift", "torque_delay"):
                value, true = abs(value), abs(true)
            error = value - true
            sigmas = error / found.std if found.std else None
            return float(error / true), None if sigmas is None else float(sigmas)
    return None, None


BIASED = 15.0
"""Linear error over the extended model's std from which five times less can be seen above three of them."""


def bias(truth: Truth, d: Diagnosis) -> tuple[float, float] | None:
    """Rms relative error of the masses and springs that the effect had biased: of the linear fit, and of the
    extended model. None where none was (``BIASED``), nothing is named, or the structure is another."""
    linear = d.details.get("linear_model")
    if linear is None or d.model.chains.masses_per_branch != tuple(len(m) for m in truth.chains.masses):
        return None
    before = model_from_json(linear).chains

    def flat(masses: Any, springs: Any) -> np.ndarray:
        return np.concatenate([np.asarray(x, dtype=float) for x in (*masses, *springs)])

    true = flat(truth.chains.masses, truth.chains.springs)
    off = np.abs(flat(before.masses, before.springs) / true - 1.0)
    left = np.abs(flat(d.model.chains.masses, d.model.chains.springs) / true - 1.0)
    std = flat(d.model.std.masses, d.model.std.springs) / true
    biased = off > BIASED * std  # False where the std is not known
    if not biased.any():
        return None
    return float(np.sqrt((off[biased] ** 2).mean())), float(np.sqrt((left[biased] ** 2).mean()))


def parameter_error(truth: Truth, d: Diagnosis) -> float | None:
    """Largest relative error of masses and springs of the extended model; None for another structure."""
    chains = d.model.chains
    if chains.masses_per_branch != tuple(len(m) for m in truth.chains.masses):
        return None
    pairs = [*zip(chains.masses, truth.chains.masses, strict=True)]
    pairs += [*zip(chains.springs, truth.chains.springs, strict=True)]
    return float(max(np.abs(a / b - 1).max(initial=0.0) for a, b in pairs))
