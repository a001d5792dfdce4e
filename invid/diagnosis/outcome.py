"""Verdict, confidence and words for the figures of a search, for elastic and rigid machines alike.

The caller hands over residuals on held-out rows, causes and their competitors. The words mean what the
contract says (CONTRACT.md): *explained* asks for nine tenths of what was missing and every axis within 1.2 of
its floor; a finding with alternatives has a confidence of at most 0.89; a model that misses more than half of
the torque is not to be trusted, and the first warning says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from invid.clauses import dependent_on
from invid.diagnosis.sentences import finding_sentence, separating_text
from invid.diagnosis.thresholds import CONTESTED, EXPLAINED, FLOOR, MISSED, NAMED, SMALL, SOFTER, UNSIZED
from invid.effects.laws.empirical_law import NAMELESS, is_like_law
from invid.effects.registry import BY_CAUSE
from invid.model.diagnosis_document import Alternative, AxisResidual, Diagnosis, Finding, Unexplained, Verdict
from invid.model.document import EffectTerm, Model
from invid.model.doubts import Doubt, DoubtCode
from invid.recording.model import Recording, Role
from invid.wording.sentence import joined, listed, sentence


@dataclass(frozen=True, eq=False)
class Cause:
    """One cause that was found, with its figures.

    Attributes
    ----------
    before, after
        Rms missing torque of its axis on held-out rows, without it and with it.
    fraction
        Share of what the model missed that it explains.
    share
        Its share of the likelihood among all competitors (``share_among_rivals``).
    alternatives
        Causes that the data cannot tell from it (``COMPETES``).
    size_is_significant
        Whether its size differs from zero; ``None`` where that is not known.
    remarks
        Further sentences; ``doubts`` are those that limit the confidence.
    """

    effect: EffectTerm
    before: float
    after: float
    fraction: float
    share: float
    alternatives: tuple[Alternative, ...] = ()
    size_is_significant: bool | None = None
    remarks: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


def share_among_rivals(worse: Sequence[float]) -> float:
    """Share of the likelihood of all that a cause has, beside none and its rivals, by how much higher −2 ln L
    is with each of these."""
    odds = np.exp(-np.clip(worse, 0.0, 200.0) / SOFTER)
    return float(1.0 / (1.0 + odds.sum()))


def finding_of(
    cause: Cause,
    explained: float,
    sizes: Sequence[int],
    axes: Sequence[str],
    *,
    at_noise: bool,
    own: bool = False,
) -> Finding:
    """A cause as a finding: confidence, sentence, and the experiment that tells it from its rivals.

    The confidence is limited where alternatives remain or more than 1.2 floors are left (not ``at_noise``):
    the true cause may then be another. ``own``: the cause stands on its own evidence, whatever share of all
    that was missing is explained.
    """
    ramp = float(np.clip((explained - NAMED) / (0.995 - NAMED), 0.0, 1.0))
    sure = 1.0 if own else 0.55 + 0.45 * ramp
    confidence = float(np.clip(cause.share * sure, 0.01, 0.999))
    # A law without a name may be that of a cause which nobody has thought of.
    if cause.alternatives or cause.doubts or not at_noise or cause.effect.cause == NAMELESS:
        confidence = min(confidence, CONTESTED)
    if cause.size_is_significant is False:
        confidence = min(confidence, UNSIZED)
    said = finding_sentence(cause.effect, cause.fraction, confidence, cause.alternatives, sizes, axes)
    return Finding(
        effect=cause.effect,
        confidence=confidence,
        before=cause.before,
        after=cause.after,
        fraction=cause.fraction,
        alternatives=cause.alternatives,
        separating_experiment=separating_experiment_of(cause.effect, cause.alternatives),
        sentence=joined([said, *cause.remarks, *cause.doubts], " "),
    )


def separating_experiment_of(term: EffectTerm, rivals: Sequence[Alternative]) -> dict[str, object] | None:
    """The experiment that tells a cause from its rivals; ``None`` without rivals."""
    if not rivals:
        return None
    effect = BY_CAUSE[term.cause]
    others = sorted({r.cause for r in rivals} - {term.cause})
    slow = effect.family in ("friction", "position", "constant")
    return {
        "kind": "constant_velocity" if slow else "multisine",
        "axis": term.axis,
        "separates": [term.cause, *others],
        "description": separating_text([term.cause, *others]),
    }


def explained_share(residual: Sequence[AxisResidual]) -> float:
    """Explained fraction of the contract: share of the power of the missing torque that is gone, noise
    subtracted."""
    before, after, noise = (
        sum(x**2 for x in column)
        for column in zip(*((r.before, r.after, r.floor) for r in residual), strict=True)
    )
    return float(np.clip(1.0 - (after - noise) / max(before - noise, 1e-300), 0.0, 1.0))


def axis_above_floor(residual: Sequence[AxisResidual]) -> AxisResidual | None:
    """The axis farthest above 1.2 times its floor; ``None`` where all are within."""
    left = [r for r in residual if not r.after <= FLOOR * r.floor]
    return max(left, key=floors_left, default=None)


def floors_left(residual: AxisResidual) -> float:
    """Missing torque of an axis in units of its noise floor."""
    return residual.after / max(residual.floor, 1e-300)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a search says of a record beside its causes.

    Attributes
    ----------
    missing, complete
        Whether the null test rejects the model without causes, and whether nothing is left beside the named.
    explained
        ``explained_share``; ``None`` where nothing is named.
    is_weighed
        Whether all that was fitted was weighed: else nothing counts as explained.
    left
        What is left in words, where the search knows more of it than its size.
    opening
        Sentences before those of findings.
    """

    missing: bool
    complete: bool
    explained: float | None
    is_weighed: bool = True
    left: Unexplained | None = None
    opening: Sequence[str] = ()
    warnings: Sequence[str] = ()
    details: Mapping[str, Any] = field(default_factory=dict)

    def verdict(self, residual: Sequence[AxisResidual], *, named: bool) -> Verdict:
        """The verdict on axes of these residuals, with or without causes."""
        if not named:
            return Verdict.UNEXPLAINED if self.missing else Verdict.CONSISTENT
        is_enough = self.explained is None or self.explained >= EXPLAINED
        is_whole = self.complete and self.is_weighed and is_enough and axis_above_floor(residual) is None
        return Verdict.EXPLAINED if is_whole else Verdict.PARTLY_EXPLAINED


def assemble_diagnosis(
    recording: Recording,
    residual: Sequence[AxisResidual],
    findings: Sequence[Finding],
    model: Model,
    outcome: Outcome,
) -> Diagnosis:
    """The diagnosis of verdict, residuals, findings and sentences."""
    laws = [f for f in findings if f.effect.table is not None]
    findings = [
        replace(f, confidence=min(f.confidence, _most_beside(f, laws), CONTESTED if f.alternatives else 1.0))
        for f in findings
    ]
    if laws:
        outcome = replace(outcome, complete=False, missing=True, left=_with_law(outcome.left, laws[0]))
    verdict, left = outcome.verdict(residual, named=bool(findings)), outcome.left
    closing: tuple[str, ...] = ()
    is_open = laws or not outcome.is_weighed or verdict is not Verdict.PARTLY_EXPLAINED
    small = None if is_open else small_remainder(residual, recording)
    if small is not None:
        verdict, left, closing = Verdict.EXPLAINED, None, (small,)
    if verdict in (Verdict.PARTLY_EXPLAINED, Verdict.UNEXPLAINED) and left is None:
        left = describe_remainder(residual, outcome.explained)
    sentences = [*outcome.opening, *(f.sentence for f in findings)]
    if verdict is Verdict.CONSISTENT:
        sentences.append(
            sentence("The model explains the measurement to within its noise: nothing is missing.")
        )
    if left is not None:
        sentences.append(left.sentence)
    open_sizes = _unknown_sizes(findings)
    result = Diagnosis(
        verdict=verdict,
        residual=tuple(residual),
        explained_fraction=outcome.explained,
        findings=tuple(findings),
        unexplained=left,
        model=replace(model, warnings=tuple(dict.fromkeys([*model.warnings, *open_sizes]))),
        warnings=tuple(dict.fromkeys([*outcome.warnings, *open_sizes])),
        sentences=tuple(dict.fromkeys([*sentences, *closing])),
        details=outcome.details,
    )
    return _mark_untrusted(result, recording)


def small_remainder(residual: Sequence[AxisResidual], recording: Recording) -> str | None:
    """What is left beyond noise in words, where it is below ``SMALL`` of rated torque on every axis; else
    ``None``."""
    if recording.rated_torque is None:
        return None
    left = [np.sqrt(max(r.after**2 - (r.noise_floor or 0.0) ** 2, 0.0)) for r in residual]
    shares = np.array(left) / np.asarray(recording.rated_torque)
    worst = int(np.argmax(shares))
    if not 0.0 <= shares[worst] < SMALL:
        return None
    return sentence(
        "What is left is small: at most {shares:.2g} % of rated torque, on {axis}; less "
        "than {small:.2g} % counts as explained.",
        shares=100 * shares[worst],
        axis=residual[worst].axis,
        small=100 * SMALL,
    )


def _with_law(left: Unexplained | None, law: Finding) -> Unexplained:
    """What is left in words, a law without a name with it."""
    if left is None:
        left = Unexplained(
            law.axis, (), (), sentence("{axis}: what acts there has no name in the catalogue", axis=law.axis)
        )
    quantities = () if law.effect.table is None else law.effect.table.quantities
    follows = [dependent_on(q) for q in quantities]
    return replace(left, character=tuple(dict.fromkeys([*left.character, *follows])))


def _most_beside(finding: Finding, laws: Sequence[Finding]) -> float:
    """Largest confidence of a finding beside laws without a name: it may be a part of one."""
    tables = [w.effect.table for w in laws if w.axis == finding.axis and w.effect.table is not None]
    overs = [q for table in tables for q in table.quantities]
    if not overs or finding.effect.table is not None:
        return 1.0
    is_like = any(is_like_law(BY_CAUSE[finding.cause], over) for over in overs)
    return UNSIZED if is_like else CONTESTED


def _unknown_sizes(findings: Sequence[Finding]) -> list[str]:
    """What would tell the parameters of causes that the data do not."""
    said = []
    for f in findings:
        names = [n.replace("_", " ") for n, p in f.effect.parameters.items() if p.std is None]
        if names:
            tells = BY_CAUSE[f.effect.cause].separating.text or sentence(
                "measure longer, or with a larger amplitude"
            )
            where = sentence("{what} on {axes}", what=f.effect.cause.replace("_", " "), axes=f.effect.axis)
            said.append(
                sentence(
                    "{where}: the data do not tell its {names}; {tells}",
                    where=where,
                    names=listed(names),
                    tells=tells,
                )
            )
    return said


def describe_remainder(residual: Sequence[AxisResidual], explained: float | None) -> Unexplained:
    """How much torque is left unexplained, on the axis farthest above its floor."""
    worst = max(residual, key=floors_left)
    short = explained is not None and explained < EXPLAINED
    of = (
        sentence(", {share:.0%} of what was missing on all axes", share=1 - (explained or 0.0))
        if short
        else ""
    )
    return Unexplained(
        worst.axis,
        (),
        (),
        sentence(
            "{axis}: {after:.3g} {unit} rms is left over a noise floor of {floor:.3g} {unit}{of}",
            axis=worst.axis,
            after=worst.after,
            unit=worst.unit,
            floor=worst.floor,
            of=of,
        ),
    )


def _mark_untrusted(diagnosis: Diagnosis, recording: Recording) -> Diagnosis:
    """The diagnosis marked as not to be trusted, first of all sentences, where the model misses over half the
    torque."""
    share = missed_torque_share(diagnosis.residual, recording)
    if not share > MISSED:
        return diagnosis
    warning = sentence(
        "The model cannot be trusted: it misses {share:.0%} of the torque. See that the "
        "torque channel is the motor's, that every axis moves freely, and that the number "
        "of masses fits.",
        share=share,
    )
    return replace(
        diagnosis,
        model=diagnosis.model.distrusted(Doubt(DoubtCode.MISSED_TORQUE, warning, {"share": share})),
        warnings=(warning, *diagnosis.warnings),
        sentences=(warning, *diagnosis.sentences),
        details={**diagnosis.details, "missed_fraction": share},
    )


def missed_torque_share(residual: Sequence[AxisResidual], recording: Recording) -> float:
    """Rms that the extended model misses beyond noise, over the rms of the torque, all axes together."""
    left = sum(max(r.after**2 - r.floor**2, 0.0) for r in residual)
    held = recording.with_role(Role.VALIDATE) or recording.experiments
    power = np.zeros(recording.axis_count)
    samples = sum(e.samples for e in held)
    for e in held:
        power += np.nansum(np.square(e.torque), axis=0)
    total = float(power.sum()) / max(samples, 1)
    return float(np.sqrt(left / total)) if total > 0 else 0.0


def limit_unfinished_search(result: Diagnosis) -> Diagnosis:
    """The diagnosis with its certainty limited because the search did not end.

    A cause that was found may have a rival that was not examined: no finding is surer than a contested one.
    Without any finding the record counts as unexplained and its model as not to be trusted.
    """
    details = {**result.details, "cut_short": True}
    if result.findings:
        findings = tuple(replace(f, confidence=min(f.confidence, CONTESTED)) for f in result.findings)
        return replace(result, findings=findings, details=details)
    reason = sentence(
        "the search for causes was cut short by its budget: what was not looked at may be there"
    )
    left = result.unexplained
    if left is None:
        left = Unexplained(max(result.residual, key=floors_left).axis, (), (), "")
        left = replace(left, sentence=sentence("{axis}: {reason}", axis=left.axis, reason=reason))
    else:
        left = replace(
            left, sentence=joined([left.sentence, reason], " " if left.sentence.endswith(".") else "; ")
        )
    replaced = {*result.sentences[-1:]} if result.unexplained is None else {result.unexplained.sentence}
    sentences = (*(s for s in result.sentences if s not in replaced), left.sentence)
    return replace(
        result,
        verdict=Verdict.UNEXPLAINED,
        unexplained=left,
        sentences=sentences,
        model=result.model.distrusted(Doubt(DoubtCode.CUT_SHORT, reason)),
        warnings=(*result.warnings, reason),
        details=details,
    )
