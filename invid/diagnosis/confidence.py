"""Findings of a selection: confidence, alternatives, and whether anything may be named."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from invid.diagnosis.evidence import (
    CandidateEvidence,
    Step,
    is_extension_of,
    is_size_significant,
    unearned_phase_penalty,
)
from invid.diagnosis.outcome import Cause, finding_of, is_rival, likelihood_share
from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import (
    AT_FLOOR,
    BROUGHT_DOWN,
    COMPETES,
    FLOOR,
    LARGER,
    MOST_OF_CHI2,
    NAMED,
    UNSIZED,
)
from invid.effects.laws.sign import ROUNDING, DryLaw
from invid.effects.units import unit_of
from invid.likelihood.joint_fit import JointFit
from invid.likelihood.null_test import NullTest, rms_torque
from invid.likelihood.placed_effect import PlacedEffect
from invid.model.diagnosis_document import Alternative, Finding
from invid.model.document import EffectTerm, Estimate
from invid.numerics.arrays import Float64
from invid.recording.model import Recording

STRIBECK_EXCLUDED = 400.0
"""χ² gain of dry friction below which a Stribeck effect is not excluded where none was fitted. Physical: 40 %
more torque in the sixth of the time that is slow is 1/40 of the power of dry friction; 3 σ (χ² 9) of that
needs 400."""
SPRING_DOUBT = (
    "It may as well be a spring to ground, such as a hose or a cable: no constant torque comes with it. Move "
    "the axis by some tens of degrees and measure again."
)
"""Doubt of a weight in balance: a spring from a load to ground is not in the catalogue."""
MOST_ROUNDING = 0.1
"""Rounding over Stribeck velocity above which friction still rises where a Stribeck effect falls, so that
nothing of it is static. Physical; checked on eddy-current brakes, which were named Stribeck friction at
0.97."""
MOST_STATIC = 5.0
"""Static over Coulomb friction above which it is no contact that begins to slide. Physical: in the literature
dry friction loses up to two thirds."""
BRAKE_DOUBT = (
    "It may as well be a resistance that no contact makes, such as an eddy-current brake: it hardly starts "
    "at rest, or hardly anything of it stays at speed. Move the axis slowly at constant speeds: dry friction "
    "stays at the slowest."
)
"""Doubt of Stribeck friction without one of the two levels that define it."""
LEAST_STATIC = 0.4
"""Static over Coulomb friction, less one, from which a Stribeck effect counts as one. Physical, as for
``STRIBECK_EXCLUDED``."""


@dataclass(frozen=True, eq=False)
class Judgement:
    """Findings of a selection; whether they may be ``named`` and are ``complete``; explained share of the
    excess χ²."""

    findings: tuple[Finding, ...]
    named: bool
    complete: bool
    explained: float
    warnings: tuple[str, ...] = ()


def judge(selection: Selection, recording: Recording, after: NullTest) -> Judgement:
    """Findings of a selection with confidence and alternatives; ``after``: null test with all causes."""
    if not selection.steps:
        return Judgement((), False, False, 0.0)
    base, final = selection.base, selection.final
    before = base.excess
    remainder = final.excess
    total = base.cost - final.cost
    explained = float(np.clip(1.0 - max(remainder, 0.0) / max(before, total, 1e-300), 0.0, 1.0))
    held_before = base.held.cost - base.held.dof
    held_left = final.held.cost - final.held.dof
    held = 1.0 - max(held_left, 0.0) / max(held_before, base.held.cost - final.held.cost, 1e-300)
    explained = min(explained, float(np.clip(held, 0.0, 1.0))) if after.rejects else 1.0
    findings = tuple(
        _finding(selection, number, recording, explained) for number in range(len(selection.steps))
    )
    complete = not after.rejects or (explained > BROUGHT_DOWN and is_at_floor(final))
    named = explained >= NAMED or (explained >= MOST_OF_CHI2 and _power_explained(base, final) >= NAMED)
    if selection.only_independent:
        named, complete = True, False
    elif not named and selection.is_cut_short:
        # What was found is named, in doubt: a cut is evidence of nothing.
        named = True
        findings = tuple(replace(f, confidence=min(f.confidence, UNSIZED)) for f in findings)
    return Judgement(findings, named, complete, explained)


def is_at_floor(final: CandidateEvidence) -> bool:
    """Whether the held-out missing torque of every axis is within 1.2 times its floor, as ``residual`` shows
    it.

    χ² alone is weaker: an excess on a few lines weighs little among many, and the torque still lacks it.
    """
    motors = final.fit.layout.structure.motors
    pairs = [rms_torque(final.held, i) for i in range(motors)]
    return all(r <= FLOOR * n for r, n in pairs)


def _power_explained(base: CandidateEvidence, final: CandidateEvidence) -> float:
    """Explained share of the power of the missing held-out torque, noise subtracted (contract)."""
    motors = base.fit.layout.structure.motors
    before = [rms_torque(base.held, i) for i in range(motors)]
    after = [rms_torque(final.held, i) for i in range(motors)]
    floor = sum(n**2 for _, n in after)
    excess = sum(r**2 for r, _ in before) - floor
    return 1.0 - (sum(r**2 for r, _ in after) - floor) / excess if excess > 0 else 0.0


def parameter_estimates(trial: CandidateEvidence, number: int, linear: bool) -> dict[str, Estimate]:
    """Parameters of one effect with standard deviations, named and in the units of the contract."""
    term, x = trial.fit.candidate.terms[number], trial.fit.candidate.x[number]
    covariance = trial.fit.covariance_of(number)
    structure = trial.fit.layout.structure
    effect = term.effect.of_machine(structure.chains(trial.fit.p[: structure.count]))
    values = effect.values(x.tolist(), term.place)
    jacobian = np.zeros((len(values), x.size))
    for k in range(x.size):
        h = 1e-5 * max(abs(float(x[k])), 1e-9)
        shifted = x.copy()
        shifted[k] += h
        changed = effect.values(shifted.tolist(), term.place)
        jacobian[:, k] = [(changed[n] - values[n]) / h for n in values]
    # Parameters that the data do not determine (when a load changed between two records) leave the others.
    is_finite = np.isfinite(np.diag(covariance))
    known = jacobian[:, is_finite]
    variance = np.einsum("ik,kl,il->i", known, covariance[np.ix_(is_finite, is_finite)], known)
    variance[(jacobian[:, ~is_finite] != 0).any(axis=1)] = np.inf
    if term.effect.coefficients == ("sine", "cosine") and is_finite[:2].all():
        variance[0] = max(variance[0], _amplitude_variance(x[:2], covariance[:2, :2]))
    # A number that no fit moves (which spring drifts) was chosen: it has no uncertainty.
    fitted = {n for n, row in zip(values, jacobian, strict=True) if row.any()}
    out = {}
    for (name, value), v in zip(values.items(), variance, strict=True):
        std = float(np.sqrt(v)) if np.isfinite(v) and v > 0 else None
        if name not in fitted:
            std = 0.0
        if std is None and name == "time":
            std = _gap_length(trial, value) / float(np.sqrt(12.0))
        out[name] = Estimate(value, std, unit_of(effect.parameters[name], linear))
    return out


def _amplitude_variance(x: Float64, covariance: Float64) -> float:
    """Variance of √(sine² + cosine²), from its change at ±3 standard deviations along the principal axes.

    Where one of the two is near zero and known much worse (a wave seen over a small part of its cycle) the
    derivative there would say that it does not matter.
    """
    sizes, axes = np.linalg.eigh(covariance)
    steps = 3.0 * np.sqrt(np.maximum(sizes, 0.0)) * axes
    shifted = np.hypot(*np.concatenate((x[:, None] + steps, x[:, None] - steps), axis=1))
    change = np.abs(shifted - np.hypot(*x)).reshape(2, -1).max(axis=0) / 3.0
    return float(change @ change)


def _gap_length(trial: CandidateEvidence, time: float) -> float:
    """Length [s] of the gap between records in which ``time`` lies; the data are the same anywhere in it."""
    records = [*trial.fit.evaluation.records, *trial.held.records]
    before = max((r.end_time for r in records if r.end_time <= time + r.step), default=time)
    after = min((r.start_time for r in records if r.start_time >= time - r.step), default=time)
    return max(after - before, records[0].step)


def effect_term(trial: CandidateEvidence, number: int, recording: Recording) -> EffectTerm:
    """One effect of a fit as a term of the model document."""
    term = trial.fit.candidate.terms[number]
    parameters = parameter_estimates(trial, number, recording.linear)
    if isinstance(term.effect, DryLaw) and term.effect.rounding > 0:
        unit = unit_of("velocity", recording.linear)
        parameters[ROUNDING] = Estimate(term.effect.rounding, 0.0, unit)
    return EffectTerm(
        cause=term.effect.cause,
        axis=recording.axes[term.place.axis],
        parameters=parameters,
        element=term.place.element,
        other_axis=recording.axes[term.place.other] if term.place.other >= 0 else None,
        table=term.effect.table(
            trial.fit.candidate.x[number], trial.fit.covariance_of(number), linear=recording.linear
        ),
    )


def _axis_rms(trial: CandidateEvidence, axis: int) -> float:
    return rms_torque(trial.held, axis)[0]


def _finding(selection: Selection, number: int, recording: Recording, explained: float) -> Finding:
    step, final = selection.steps[number], selection.final
    at = len(selection.base.fit.candidate.terms) + number  # after the effects that the model came with
    term = final.fit.candidate.terms[at]
    effect = effect_term(final, at, recording)
    rivals, share = _rivals(step, final.beyond_noise)
    alternatives = tuple(
        Alternative(
            t.term.effect.cause,
            recording.axes[t.term.place.axis],
            t.term.place.element,
            _axis_rms(t, t.term.place.axis),
            recording.axes[t.term.place.other] if t.term.place.other >= 0 else None,
        )
        for t in rivals
    )
    alternatives += _gain_alternative(final, term, recording, alternatives)
    alternatives += _stribeck_alternative(step, recording, alternatives)
    alternatives += _one_motor_alternatives(final, term, recording, alternatives)
    axis = term.place.axis
    before, after = _axis_rms(step.before, axis), _axis_rms(step.chosen, axis)
    total = sum(s.gain for s in selection.steps)
    fraction = float(np.clip(step.gain / max(total, 1e-300), 0, 1)) * explained
    doubts = (
        (SPRING_DOUBT,)
        if _is_like_spring(final.fit, at)
        else (BRAKE_DOUBT,)
        if is_degenerate_stribeck(effect)
        else ()
    )
    cause = Cause(
        effect,
        before,
        after,
        fraction,
        share,
        alternatives,
        is_size_significant(final.fit, at),
        doubts=doubts,
    )
    near = final.cost <= AT_FLOOR * final.dof and not selection.only_independent
    sizes = final.fit.layout.structure.sizes
    return finding_of(cause, explained, sizes, recording.axes, at_noise=near, own=selection.only_independent)


def _is_like_spring(fit: JointFit, at: int) -> bool:
    """Whether gravity is fitted by its stiffness alone, with no significant constant torque (a weight in
    balance)."""
    if fit.candidate.terms[at].effect.cause != "gravity":
        return False
    constant, std = float(fit.candidate.x[at][1]), float(np.sqrt(fit.covariance_of(at)[1, 1]))
    return abs(constant) < 3.0 * std


def is_degenerate_stribeck(effect: EffectTerm) -> bool:
    """Whether Stribeck friction has no static part, or no Coulomb level (by three standard deviations)."""
    if effect.cause != "stribeck_friction":
        return False
    at = effect.parameters
    gradual = ROUNDING in at and at[ROUNDING].value > MOST_ROUNDING * at["velocity"].value
    level = at["coulomb"].value + 3.0 * (at["coulomb"].std or 0.0)
    return gradual or at["static"].value > MOST_STATIC * level


def _stribeck_alternative(
    step: Step, recording: Recording, known: tuple[Alternative, ...]
) -> tuple[Alternative, ...]:
    """Stribeck friction as alternative to dry friction that is too weak to show what it does at slow
    speed."""
    term, chosen = step.chosen.term, step.chosen
    if term.effect.cause != "coulomb_friction" or any(a.cause == "stribeck_friction" for a in known):
        return ()
    axis = term.place.axis
    fitted = [
        t for t, _ in step.ranked if t.term.effect.cause == "stribeck_friction" and t.term.place == term.place
    ]
    if fitted:
        if not _is_stribeck_likely(fitted[0], chosen):
            return ()
    elif step.before.cost - chosen.cost > STRIBECK_EXCLUDED * chosen.dispersion:
        return ()
    return (
        Alternative("stribeck_friction", recording.axes[axis], term.place.element, _axis_rms(chosen, axis)),
    )


def _is_stribeck_likely(slow: CandidateEvidence, dry: CandidateEvidence) -> bool:
    """Whether a fitted Stribeck effect gains more than its parameters do by chance and may be as large as
    usual."""
    std = float(np.sqrt(max(slow.fit.covariance_of(-1)[1, 1], 0.0)))
    gained = (dry.cost - slow.cost) / dry.dispersion
    return gained > slow.term.size - dry.term.size and float(slow.x[1]) + 2.0 * std > LEAST_STATIC * float(
        slow.x[0]
    )


def _gain_alternative(
    final: CandidateEvidence, term: PlacedEffect, recording: Recording, known: tuple[Alternative, ...]
) -> tuple[Alternative, ...]:
    """The other axis' torque gain as alternative: of two axes, g on one and 1/g on the other give the same
    data."""
    if term.effect.cause != "torque_gain" or recording.axis_count != 2:
        return ()
    axis = 1 - term.place.axis
    if any(a.cause == "torque_gain" for a in known):
        return ()
    return (Alternative("torque_gain", recording.axes[axis], None, _axis_rms(final, axis), None),)


def _one_motor_alternatives(
    final: CandidateEvidence, term: PlacedEffect, recording: Recording, known: tuple[Alternative, ...]
) -> tuple[Alternative, ...]:
    """The same mode at the other masses and a base that gives way as alternatives to a mode of one axis.

    Seen from one motor each of them makes the same poles and zeros; whether the search fitted them to the end
    or left another at a flat valley decides nothing.
    """
    if term.effect.cause != "extra_mode" or recording.axis_count != 1:
        return ()
    axis, after = recording.axes[0], _axis_rms(final, 0)
    listed = {a.element for a in known if a.cause == "extra_mode"} | {term.place.element}
    places = (p.element for p in term.effect.places(final.fit.layout.structure))
    modes = (Alternative("extra_mode", axis, element, after) for element in places if element not in listed)
    return (*modes, Alternative("base_compliance", axis, None, after))


def _rivals(step: Step, remainder: float) -> tuple[list[CandidateEvidence], float]:
    """Candidates that the data cannot tell from the chosen one, and its share of the likelihood."""
    rows = step.before.fit.dof
    scores: Float64 = np.array([s - unearned_phase_penalty(t, rows) for t, s in step.ranked])
    # Gravity at the load or at the motor is one cause: the other place is an alternative, not a doubt.
    own = [n == 0 or _is_same_weight(t.term, step.ranked[0][0].term) for n, (t, _) in enumerate(step.ranked)]
    chosen, best = step.ranked[0][1], step.chosen
    rivals = [
        t
        for t, s in sorted(step.ranked[1:], key=lambda ranked: ranked[1] - chosen >= COMPETES)
        if is_rival(s - chosen, t.cost - best.cost, remainder) and _is_separate_model(step, t)
    ]
    return rivals, likelihood_share(scores, own)


def _is_same_weight(one: PlacedEffect, other: PlacedEffect) -> bool:
    """Whether both are gravity on the same axis."""
    return one.effect.cause == other.effect.cause == "gravity" and one.place.axis == other.place.axis


def _is_separate_model(step: Step, rival: CandidateEvidence) -> bool:
    """Whether a rival is more than a larger friction model at the same place that gains nothing by being
    larger.

    Nested models always fit as well. The smaller is the answer unless the larger gains what its parameters
    gain by chance once in a hundred (χ²).
    """
    if rival.term.effect.is_null(rival.x.tolist()):
        return False
    chosen = step.chosen
    if len(rival.fit.candidate.terms) < len(chosen.fit.candidate.terms):
        return True  # one cause for two: a constant torque with it
    return not (is_extension_of(rival, chosen) and chosen.cost - rival.cost < LARGER)
