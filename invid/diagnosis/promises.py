"""What the words of a diagnosis promise, kept in one place whichever engine found it (CONTRACT.md).

*Explained* asks for nine tenths of what was missing and every axis within 1.2 of its floor; a finding with
alternatives has a confidence of at most 0.89; a model that misses more than half of the torque is not to be
trusted, and the first warning says so.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.diagnosis.thresholds import CONTESTED, EXPLAINED, FLOOR, MISSED
from invid.model.diagnosis_document import AxisResidual, Diagnosis, Unexplained, Verdict
from invid.recording.model import Recording, Role


def keep_promises(diagnosis: Diagnosis, recording: Recording) -> Diagnosis:
    """The same diagnosis, with no word in it that its numbers do not carry."""
    findings = tuple(
        replace(f, confidence=min(f.confidence, CONTESTED)) if f.alternatives else f
        for f in diagnosis.findings
    )
    return _missed(_explained(replace(diagnosis, findings=findings)), recording)


def above_floor(diagnosis: Diagnosis) -> AxisResidual | None:
    """The axis farthest above 1.2 times its floor; ``None`` where all are within."""
    left = [r for r in diagnosis.residual if not r.after <= FLOOR * r.noise_floor]
    return max(left, key=lambda r: r.after / max(r.noise_floor, 1e-300), default=None)


def _explained(diagnosis: Diagnosis) -> Diagnosis:
    """``explained`` only where the named causes take nine tenths and leave every axis at its floor."""
    if diagnosis.verdict is not Verdict.EXPLAINED:
        return diagnosis
    share, worst = diagnosis.explained_fraction, above_floor(diagnosis)
    if (share is None or share >= EXPLAINED) and worst is None:
        return diagnosis
    left = diagnosis.unexplained
    if left is None:
        if worst is None:
            worst = max(diagnosis.residual, key=lambda r: r.after / max(r.noise_floor, 1e-300))
        short = share is not None and share < EXPLAINED
        of = f", {1 - (share or 0.0):.0%} of what was missing on all axes" if short else ""
        left = Unexplained(
            worst.axis,
            (),
            (),
            f"{worst.axis}: {worst.after:.3g} {worst.unit} rms is left over a noise floor of "
            f"{worst.noise_floor:.3g} {worst.unit}{of}",
        )
    return replace(
        diagnosis,
        verdict=Verdict.PARTLY_EXPLAINED,
        unexplained=left,
        sentences=tuple(dict.fromkeys([*diagnosis.sentences, left.sentence])),
    )


def _missed(diagnosis: Diagnosis, recording: Recording) -> Diagnosis:
    """A model that misses more than half of the torque is not to be trusted, and that comes first."""
    share = missed_share(diagnosis, recording)
    if not share > MISSED:
        return diagnosis
    said = (
        f"The model cannot be trusted: it misses {share:.0%} of the torque. See that the torque channel is "
        "the motor's, that every axis moves freely, and that the number of masses fits."
    )
    doubts = list(diagnosis.model.fit.get("doubts", ()))
    model = replace(
        diagnosis.model, fit={**diagnosis.model.fit, "trustworthy": False, "doubts": [*doubts, said]}
    )
    return replace(
        diagnosis,
        model=model,
        warnings=(said, *diagnosis.warnings),
        sentences=(said, *diagnosis.sentences),
        details={**diagnosis.details, "missed_fraction": share},
    )


def missed_share(diagnosis: Diagnosis, recording: Recording) -> float:
    """Rms that the extended model misses beyond noise, over the rms of the torque, all axes together."""
    left = sum(max(r.after**2 - r.noise_floor**2, 0.0) for r in diagnosis.residual)
    held = recording.with_role(Role.VALIDATE) or recording.experiments
    power = np.zeros(recording.axis_count)
    samples = sum(e.samples for e in held)
    for e in held:
        power += np.nansum(np.square(e.torque), axis=0)
    total = float(power.sum()) / max(samples, 1)
    return float(np.sqrt(left / total)) if total > 0 else 0.0


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
