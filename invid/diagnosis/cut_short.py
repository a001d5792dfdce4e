"""A diagnosis whose search the budget ended: nothing is claimed of what was not looked at."""

from __future__ import annotations

from dataclasses import replace

from invid.diagnosis.thresholds import CONTESTED
from invid.model.diagnosis_document import Diagnosis, Unexplained, Verdict


def cut_short(result: Diagnosis) -> Diagnosis:
    """The diagnosis with no more certainty than a search that did not end allows.

    A cause that was found may have a rival that was not weighed: no finding is surer than a contested one.
    Without any finding the record is neither free of causes nor without a name for them: it counts as
    unexplained, and its model as not to be trusted.
    """
    details = {**result.details, "cut_short": True}
    if result.findings:
        findings = tuple(replace(f, confidence=min(f.confidence, CONTESTED)) for f in result.findings)
        return replace(result, findings=findings, details=details)
    reason = "the search for causes was cut short by its budget: what was not looked at may be there"
    left = result.unexplained
    if left is None:
        worst = max(result.residual, key=lambda r: r.after / max(r.noise_floor, 1e-300))
        left = Unexplained(worst.axis, (), (), f"{worst.axis}: {reason}")
    else:
        left = replace(left, sentence=f"{left.sentence}; {reason}")
    told = {*result.sentences[-1:]} if result.unexplained is None else {result.unexplained.sentence}
    sentences = (*(s for s in result.sentences if s not in told), left.sentence)
    doubts = [*result.model.fit.get("doubts", ()), reason]
    model = replace(result.model, fit={**result.model.fit, "trustworthy": False, "doubts": doubts})
    return replace(
        result,
        verdict=Verdict.UNEXPLAINED,
        unexplained=left,
        sentences=sentences,
        model=model,
        warnings=(*result.warnings, reason),
        details=details,
    )


__all__ = ["cut_short"]
