"""From a selection to findings: how sure, what competes, and whether to name anything at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.diagnosis.evidence import (
    CandidateEvidence,
    Step,
    is_extension_of,
    is_size_significant,
    unearned_phase_penalty,
)
from invid.diagnosis.outcome import Cause, competes, finding_of, likelihood_share
from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import (
    AT_FLOOR,
    BROUGHT_DOWN,
    COMPETES,
    FLOOR,
    LARGER,
    MOST_OF_CHI2,
    NAMED,
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

SLOW = 400.0
"""χ² gain of dry friction below which a Stribeck effect is not excluded, where none was fitted: forty per
cent more torque in the sixth of the time that is slow is a fortieth of dry friction's power, and 9 (3 σ) of
that needs 400. On paper; no campaign counted it."""
SPRING = (
    "It may as well be a spring to ground, such as a hose or a cable: no constant torque comes with it. Move "
    "the axis by some tens of degrees and measure again."
)
"""Said of a weight in balance, which the catalogue knows and a spring from a load to ground it does not."""
GRADUAL = 0.1
"""Rounding over Stribeck velocity above which friction still rises where a Stribeck effect falls: nothing of
it is static. On paper, and from a tester's eddy-current brakes, named Stribeck friction at 0.97."""
FADES = 5.0
"""Static friction over the Coulomb level from where on it is no contact that begins to slide: those of the
literature lose up to two thirds. On paper."""
BRAKE = (
    "It may as well be a resistance that no contact makes, such as an eddy-current brake: it hardly starts "
    "at rest, or hardly anything of it stays at speed. Move the axis slowly at constant speeds: dry friction "
    "stays at the slowest."
)
"""Said of Stribeck friction without one of the two levels that it is named for."""
STICKS = 0.4
"""Static friction over the Coulomb level, less one, from where on a Stribeck effect is one: as in SLOW."""


@dataclass(frozen=True, eq=False)
class Judgement:
    """What may be said."""

    findings: tuple[Finding, ...]
    named: bool
    complete: bool
    explained: float
    warnings: tuple[str, ...] = ()


def judge(selection: Selection, recording: Recording, after: NullTest) -> Judgement:
    """Findings with confidence and alternatives."""
    if not selection.steps:
        return Judgement((), False, False, 0.0)
    base, final = selection.base, selection.final
    before = base.excess
    left = final.excess
    total = base.cost - final.cost
    explained = float(np.clip(1.0 - max(left, 0.0) / max(before, total, 1e-300), 0.0, 1.0))
    held_before = base.held.cost - base.held.dof
    held_left = final.held.cost - final.held.dof
    held = 1.0 - max(held_left, 0.0) / max(held_before, base.held.cost - final.held.cost, 1e-300)
    explained = min(explained, float(np.clip(held, 0.0, 1.0))) if after.rejects else 1.0
    findings = tuple(
        _finding(selection, number, recording, explained) for number in range(len(selection.steps))
    )
    complete = not after.rejects or (explained > BROUGHT_DOWN and is_at_floor(final))
    named = explained >= NAMED or (explained >= MOST_OF_CHI2 and _power_explained(base, final) >= NAMED)
    if selection.partly:
        named, complete = True, False
    return Judgement(findings, named, complete, explained)


def is_at_floor(final: CandidateEvidence) -> bool:
    """Whether every axis' held-out missing torque is within 1.2 times its floor: what ``residual`` shows.

    χ² says less: a rest on a few lines weighs little among many, and is what the torque still lacks.
    """
    motors = final.fit.layout.structure.motors
    pairs = [rms_torque(final.held, i) for i in range(motors)]
    return all(r <= FLOOR * n for r, n in pairs)


def _power_explained(base: CandidateEvidence, final: CandidateEvidence) -> float:
    """The contract's explained fraction: power of the torque missing on held-out data, noise taken off."""
    motors = base.fit.layout.structure.motors
    before = [rms_torque(base.held, i) for i in range(motors)]
    after = [rms_torque(final.held, i) for i in range(motors)]
    floor = sum(n**2 for _, n in after)
    excess = sum(r**2 for r, _ in before) - floor
    return 1.0 - (sum(r**2 for r, _ in after) - floor) / excess if excess > 0 else 0.0


def parameter_estimates(trial: CandidateEvidence, number: int, linear: bool) -> dict[str, Estimate]:
    """The contract's parameters of one effect with their standard deviations."""
    term, x = trial.fit.candidate.terms[number], trial.fit.candidate.x[number]
    covariance = trial.fit.covariance_of(number)
    values = term.effect.values(x.tolist(), term.place)
    jacobian = np.zeros((len(values), x.size))
    for k in range(x.size):
        h = 1e-5 * max(abs(float(x[k])), 1e-9)
        moved = x.copy()
        moved[k] += h
        changed = term.effect.values(moved.tolist(), term.place)
        jacobian[:, k] = [(changed[n] - values[n]) / h for n in values]
    # What the data do not see (the moment of a change between two records) is no reason to lose the rest.
    seen = np.isfinite(np.diag(covariance))
    known = jacobian[:, seen]
    variance = np.einsum("ik,kl,il->i", known, covariance[np.ix_(seen, seen)], known)
    variance[(jacobian[:, ~seen] != 0).any(axis=1)] = np.inf
    if term.effect.coefficients == ("sine", "cosine") and seen[:2].all():
        variance[0] = max(variance[0], _of_amplitude(x[:2], covariance[:2, :2]))
    out = {}
    for (name, value), v in zip(values.items(), variance, strict=True):
        std = float(np.sqrt(v)) if np.isfinite(v) and v > 0 else None
        if std is None and name == "time":
            std = _gap(trial, value) / float(np.sqrt(12.0))
        out[name] = Estimate(value, std, unit_of(term.effect.parameters[name], linear))
    return out


def _of_amplitude(x: Float64, covariance: Float64) -> float:
    """Variance of √(sine² + cosine²), as far as it goes within three standard deviations of the two.

    Where one of them is about zero and known much worse (a wave seen over a small part of its cycle), the
    slope there says that it does not matter.
    """
    sizes, axes = np.linalg.eigh(covariance)
    steps = 3.0 * np.sqrt(np.maximum(sizes, 0.0)) * axes
    moved = np.hypot(*np.concatenate((x[:, None] + steps, x[:, None] - steps), axis=1))
    change = np.abs(moved - np.hypot(*x)).reshape(2, -1).max(axis=0) / 3.0
    return float(change @ change)


def _gap(trial: CandidateEvidence, time: float) -> float:
    """Length of the gap between records in which ``time`` lies: anywhere in it the data are the same."""
    records = [*trial.fit.evaluation.records, *trial.held.records]
    before = max((r.end_time for r in records if r.end_time <= time + r.step), default=time)
    after = min((r.start_time for r in records if r.start_time >= time - r.step), default=time)
    return max(after - before, records[0].step)


def effect_term(trial: CandidateEvidence, number: int, recording: Recording) -> EffectTerm:
    """One effect in the model's terms."""
    term = trial.fit.candidate.terms[number]
    parameters = parameter_estimates(trial, number, recording.linear)
    if isinstance(term.effect, DryLaw) and term.effect.rounding > 0:
        unit = unit_of("velocity", recording.linear)
        parameters[ROUNDING] = Estimate(term.effect.rounding, None, unit)
    return EffectTerm(
        cause=term.effect.cause,
        axis=recording.axes[term.place.axis],
        parameters=parameters,
        element=term.place.element,
        other_axis=recording.axes[term.place.other] if term.place.other >= 0 else None,
    )


def _rms(trial: CandidateEvidence) -> float:
    motors = trial.fit.layout.structure.motors
    return float(np.sqrt(sum(rms_torque(trial.held, i)[0] ** 2 for i in range(motors))))


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
    alternatives += _other_scale(final, term, recording, alternatives)
    alternatives += _slow_friction(step, recording, alternatives)
    axis = term.place.axis
    before, after = _axis_rms(step.before, axis), _axis_rms(step.chosen, axis)
    total = sum(s.before.cost - s.chosen.cost for s in selection.steps)
    fraction = float(np.clip((step.before.cost - step.chosen.cost) / max(total, 1e-300), 0, 1)) * explained
    said = (SPRING,) if _like_a_spring(final.fit, at) else (BRAKE,) if is_degenerate_stribeck(effect) else ()
    cause = Cause(
        effect, before, after, fraction, share, alternatives, is_size_significant(final.fit, at), doubts=said
    )
    near = final.cost <= AT_FLOOR * final.dof and not selection.partly
    sizes = final.fit.layout.structure.sizes
    return finding_of(cause, explained, sizes, recording.axes, at_noise=near, own=selection.partly)


def _like_a_spring(fit: JointFit, at: int) -> bool:
    """Whether a weight hangs in balance, as far as the records tell: only stiffness, no constant torque."""
    if fit.candidate.terms[at].effect.cause != "gravity":
        return False
    constant, std = float(fit.candidate.x[at][1]), float(np.sqrt(fit.covariance_of(at)[1, 1]))
    return abs(constant) < 3.0 * std


def is_degenerate_stribeck(effect: EffectTerm) -> bool:
    """Whether Stribeck friction lacks its static part, or a Coulomb level by three standard deviations."""
    if effect.cause != "stribeck_friction":
        return False
    at = effect.parameters
    gradual = ROUNDING in at and at[ROUNDING].value > GRADUAL * at["velocity"].value
    level = at["coulomb"].value + 3.0 * (at["coulomb"].std or 0.0)
    return gradual or at["static"].value > FADES * level


def _slow_friction(
    step: Step, recording: Recording, known: tuple[Alternative, ...]
) -> tuple[Alternative, ...]:
    """Stribeck friction beside dry friction that is too weak to tell what it does at slow speed."""
    term, chosen = step.chosen.term, step.chosen
    if term.effect.cause != "coulomb_friction" or any(a.cause == "stribeck_friction" for a in known):
        return ()
    axis = term.place.axis
    fitted = [
        t for t, _ in step.ranked if t.term.effect.cause == "stribeck_friction" and t.term.place == term.place
    ]
    if fitted:
        if not _sticks(fitted[0], chosen):
            return ()
    elif step.before.cost - chosen.cost > SLOW * chosen.dispersion:
        return ()
    return (
        Alternative("stribeck_friction", recording.axes[axis], term.place.element, _axis_rms(chosen, axis)),
    )


def _sticks(slow: CandidateEvidence, dry: CandidateEvidence) -> bool:
    """Whether a fitted Stribeck effect gains what its parameters do by chance, and is as large as one is."""
    std = float(np.sqrt(max(slow.fit.covariance_of(-1)[1, 1], 0.0)))
    gained = (dry.cost - slow.cost) / dry.dispersion
    return gained > slow.term.size - dry.term.size and float(slow.x[1]) + 2.0 * std > STICKS * float(
        slow.x[0]
    )


def _other_scale(
    final: CandidateEvidence, term: PlacedEffect, recording: Recording, known: tuple[Alternative, ...]
) -> tuple[Alternative, ...]:
    """With two axes, one's torque scaled by g and the other's by 1/g are the same data."""
    if term.effect.cause != "torque_gain" or recording.axis_count != 2:
        return ()
    axis = 1 - term.place.axis
    if any(a.cause == "torque_gain" for a in known):
        return ()
    return (Alternative("torque_gain", recording.axes[axis], None, _axis_rms(final, axis), None),)


def _rivals(step: Step, left: float) -> tuple[list[CandidateEvidence], float]:
    """Candidates that the data cannot tell from the chosen one, and its share of the likelihood."""
    rows = step.before.fit.dof
    scores: Float64 = np.array([s - unearned_phase_penalty(t, rows) for t, s in step.ranked])
    # Weight is weight, at the load or at the motor: the other end is an alternative, no doubt of the cause.
    own = [n == 0 or _same_weight(t.term, step.ranked[0][0].term) for n, (t, _) in enumerate(step.ranked)]
    chosen, best = step.ranked[0][1], step.chosen
    rivals = [
        t
        for t, s in sorted(step.ranked[1:], key=lambda ranked: ranked[1] - chosen >= COMPETES)
        if competes(s - chosen, t.cost - best.cost, left) and _competes(step, t)
    ]
    return rivals, likelihood_share(scores, own)


def _same_weight(one: PlacedEffect, other: PlacedEffect) -> bool:
    """Whether both are gravity on the same axis."""
    return one.effect.cause == other.effect.cause == "gravity" and one.place.axis == other.place.axis


def _competes(step: Step, rival: CandidateEvidence) -> bool:
    """Not a larger friction model at the same place that gains nothing by being larger.

    Nested models always fit as well; the smaller is the answer unless the larger gains what its
    parameters may by chance once in a hundred.
    """
    if rival.term.effect.is_null(rival.x.tolist()):
        return False
    chosen = step.chosen
    if len(rival.fit.candidate.terms) < len(chosen.fit.candidate.terms):
        return True  # one cause for two: a constant torque with it
    return not (is_extension_of(rival, chosen) and chosen.cost - rival.cost < LARGER)
