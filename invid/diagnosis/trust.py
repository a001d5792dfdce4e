"""Whether the linear model can carry a diagnosis: on a wrong model a named cause is wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from invid.diagnosis.evidence import CandidateEvidence
from invid.diagnosis.thresholds import CONTESTED, LEFT, REACHED, UNSIZED
from invid.identification.crosscheck import BEATEN, MOST_BEATEN
from invid.identification.identifiability import blind_directions
from invid.identification.model_facts import CUT_SHORT
from invid.likelihood.evaluation import Evaluation
from invid.likelihood.joint_fit import JointFit
from invid.likelihood.nuisance.hold_share import HOLD_BAND, SHARES, driven_hold
from invid.likelihood.null_test import NullTest
from invid.model.diagnosis_document import Finding, Unexplained
from invid.model.document import Model, parameter_vector, stds_by_name
from invid.model.doubts import Doubt, DoubtCode, by_weight, doubts_of
from invid.recording.model import Recording

LEAST_EXPLAINED = 0.9
"""Share of the torque that a linear model of the right machine explains (empirical, as in
``invid.identify``)."""


@dataclass(frozen=True)
class Trust:
    """Doubts about the linear fit, the weightiest first; empty where there are none."""

    reasons: tuple[Doubt, ...] = ()
    unseen: tuple[str, ...] = ()
    """Sentences about parameters that the data do not determine."""
    broken: bool = False
    """Whether the linear model itself is wrong, so that no cause may be named on it."""

    @property
    def trustworthy(self) -> bool:
        """Whether the exit status may be 0."""
        return not self.broken and not self.unseen

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """All doubts, the weightiest first."""
        return (*self.reasons, *(Doubt(DoubtCode.UNSEEN, said) for said in self.unseen))


def judge_linear_fit(
    model: Model,
    extended: Model,
    base: CandidateEvidence,
    final: CandidateEvidence,
    tests: tuple[NullTest, NullTest],
    recording: Recording,
) -> Trust:
    """Doubts about the model, judged with the causes in it on rows kept out.

    A strong cause makes a linear fit look wrong that is right once the cause is in the model. Where the
    extended model comes down to the noise, or predicts the rows kept out and no FRF without structure does
    better by more than a factor of two, only parameters that the data do not determine are reported.
    """
    unseen = _unseen_parameters(extended, final, recording.linear)
    short = _short_experiments(recording)
    before, after = (t.chi2 / max(t.dof, 1) for t in tests)
    left = max(after - 1.0, 0.0) / max(before - 1.0, 1e-300)
    if (after < REACHED or left < LEFT) and not short:
        return Trust(unseen=unseen)
    share = _explained_share(final.held)
    beaten = float(model.fit.get(BEATEN) or 0.0) * min(left, 1.0)
    is_extended = final.fit is not base.fit
    if is_extended and share >= LEAST_EXPLAINED and beaten <= MOST_BEATEN and not short:
        return Trust(unseen=unseen)
    # A parameter that the linear fit could not determine makes no wrong model: a strong cause hides it from
    # the fit without effects, and what the extended fit cannot determine is in ``unseen``.
    blind = {*model.fit.get("unseen", ()), *model.fit.get(CUT_SHORT, ())}
    reasons = [d for d in doubts_of(model.fit) if d.code is not DoubtCode.UNSEEN and d.text not in blind]
    reasons += short
    if not is_extended and not base.fit.converged and not reasons:
        reasons.append(Doubt(DoubtCode.NOT_CONVERGED, "the linear fit did not converge"))
    share = min(share, _explained_share(final.fit.evaluation))
    if share < LEAST_EXPLAINED and not any(d.code is DoubtCode.LITTLE_EXPLAINED for d in reasons):
        said = (
            f"the model accounts for {share:.0%} of the torque only: another number of masses, a "
            "torque channel that is not the motor torque, or axes that do not move freely"
        )
        reasons.append(Doubt(DoubtCode.LITTLE_EXPLAINED, said, {"share": share}))
    return Trust(by_weight(reasons), unseen, broken=bool(reasons))


def _short_experiments(recording: Recording) -> list[Doubt]:
    """Reasons about experiments that end before their first period does: their lines are not resolved."""
    return [
        Doubt(
            DoubtCode.SHORT_RECORD,
            f"experiment {e.key} holds {e.samples / e.period_samples:.0%} of one period of its excitation",
        )
        for e in recording.experiments
        if 0 < e.samples < e.period_samples
    ][:1]


def _explained_share(evaluation: Evaluation) -> float:
    """Explained share of the noise-weighted torque power of the training records."""
    left = total = 0.0
    for number, view in enumerate(evaluation.views):
        weight = 1.0 / np.maximum(np.einsum("fii->fi", evaluation.covariance[number]).real, 1e-300)
        if view.record.weight.size:
            weight = weight * view.record.weight[:, None]
        left += float((np.abs(evaluation.missing[number][1:]) ** 2 * weight[1:]).sum())
        total += float((np.abs(view.acting[1:]) ** 2 * weight[1:]).sum())
    return max(0.0, 1.0 - left / max(total, 1e-300))


def _unseen_parameters(extended: Model, final: CandidateEvidence, linear: bool) -> tuple[str, ...]:
    """Sentences about parameters that the joint fit does not determine."""
    if extended.covariance is None:
        known, (names, _) = stds_by_name(extended), parameter_vector(extended.chains)
        lost = [n for n in names if not np.isfinite(known[n]) and ".damper." not in n]
        return (f"{', '.join(lost)}: not seen by these data",) if lost else ()
    bands = [v.omega[v.record.excited] for v in final.fit.evaluation.views if v.record.excited.any()]
    if not bands:
        return ()
    band = (min(float(b[0]) for b in bands) / 2 / np.pi, max(float(b[-1]) for b in bands) / 2 / np.pi)
    names, values = parameter_vector(extended.chains)
    blind = blind_directions(extended.chains, names, values, extended.covariance, band)
    return blind.sentences if any(".damper." not in n for n in blind.unseen) else ()


def limit_confidence(findings: tuple[Finding, ...], found: Trust) -> tuple[Finding, ...]:
    """Findings with limited confidence where the model is wrong, or the data do not determine all of it."""
    most = UNSIZED if found.broken else CONTESTED if found.unseen else 1.0
    return tuple(replace(f, confidence=min(f.confidence, most)) for f in findings)


def doubt_unknown_hold_timing(
    findings: tuple[Finding, ...], recording: Recording, model: Model, final: JointFit
) -> tuple[tuple[Finding, ...], list[str]]:
    """Findings without those that may be the timing of a hold, those that could be with less confidence;
    warnings.

    A hold of gain P inside the drive that acts half a sample before the record says so looks like viscous
    friction of P·h/2, exactly. A demand logged beside the torque, or records that show the hold alone, tell
    them apart. Friction no larger than that is a sampling convention, and no finding. Where the hold's share
    is fitted along, the sum of the friction and what the share contributes is known better than either.
    """
    locations, train = model.fit.get("holds", {}), final.evaluation.records
    out, warnings = [], []
    for f in findings:
        axis = f.effect.axis
        i = recording.axes.index(axis)
        held, declared = driven_hold(recording, i)
        is_told = not str(locations.get(axis, "open")).startswith("open")
        is_known = is_told or any(r.command is not None or r.staircase[i] == 1.0 for r in train)
        if f.effect.cause != "viscous_friction" or f.effect.element != "mass 1" or not held or is_known:
            out.append(f)
            continue
        size = f.effect.parameters["coefficient"]
        gain, step = _stiffest_hold(declared, model, i, final), train[0].step
        is_small = size.value <= 0.5 * step * gain + 3.0 * (size.std or 0.0)
        if is_small and not _exceeds_hold(final, i):
            warnings.append(
                f"viscous friction of {size.value:.2g} {size.unit} on {axis} is what its hold makes by "
                "acting up to half a sample before the record: a matter of sampling, so it is no finding; "
                "record the demanded torque over whole periods, or drive the axis without a hold, to tell"
            )
            continue
        out.append(replace(f, confidence=min(f.confidence, CONTESTED)))
        warnings.append(
            f"viscous friction of {axis}: a hold works while the axis is driven, nothing says when it "
            "acts, and half a sample of it looks like such friction: record the demanded torque over "
            "whole periods, or drive the axis without a hold"
        )
    # Another cause may fit what wrong gains of such a hold leave: a damped mode was a false alarm.
    untimed = {f.effect.axis for f in findings if f not in out}
    kept = (
        replace(f, confidence=min(f.confidence, CONTESTED)) if f.effect.axis in untimed else f for f in out
    )
    return tuple(kept), warnings


def _exceeds_hold(final: JointFit, axis: int) -> bool:
    """Whether viscous friction at a motor and its hold's share of it exceed what the whole hold could make.

    By three standard deviations of their sum (statistical).
    """
    layout, terms = final.layout, final.candidate.terms
    holds = [k for k, h in enumerate(layout.holds) if h.axis == axis and h.stiffness and not h.damping]
    at = [
        k
        for k, t in enumerate(terms)
        if t.effect.cause == "viscous_friction" and (t.place.axis, t.place.number) == (axis, 1)
    ]
    if not holds or not at:
        return False
    friction = layout.count + sum(t.size for t in terms[: at[0]])
    share, per_share = (
        layout.hold_slice.start + holds[0],
        0.5 * layout.step * layout.holds[holds[0]].stiffness,
    )
    variance = final.covariance[np.ix_([friction, share], [friction, share])]
    weights = np.array([1.0, per_share])
    std = float(np.sqrt(max(weights @ variance @ weights, 0.0)))
    total = float(final.candidate.x[at[0]][0]) + per_share * float(final.p[share])
    return total - 3.0 * std > SHARES[1] * per_share


def _stiffest_hold(declared: float | None, model: Model, axis: int, final: JointFit) -> float:
    """Proportional gain of an axis' hold [torque per position]: declared, or the largest that is
    plausible."""
    if declared is not None:
        return declared
    inside = max((h.stiffness for h in final.layout.holds if h.axis == axis), default=0.0)
    if inside:
        return inside
    records = final.evaluation.records
    lowest = min(float(r.omega[r.excited].min()) for r in records if r.excited.any())
    return float(model.chains.masses[axis].sum()) * (HOLD_BAND * lowest) ** 2


def distrust_sentences(found: Trust, masses: tuple[int, ...], *, is_named: bool = False) -> list[str]:
    """What is wrong with the model and how to correct it, as the first sentences of the diagnosis.

    ``is_named``: what stands on its own evidence, or was found until the budget was spent, is named all the
    same.
    """
    if found.broken:
        sizes = ", ".join(str(n) for n in masses)
        named = "what is named is in doubt" if is_named else "no cause is named"
        return [
            f"The linear model itself cannot be trusted, so {named}: {found.reasons[0].text}.",
            "Put that right first: see that every axis is excited and hits nothing, and that the torque "
            f"channel is the motor's; try another number of masses than {sizes} (--masses auto lets the data "
            "choose); record more periods, a wider band, or a smaller amplitude, at which a strong effect is "
            "a weak one.",
        ]
    if found.unseen:
        return [
            f"Not everything in the model is known from these data: {'; '.join(found.unseen)}. "
            "What follows holds for what the model predicts, not for those parameters."
        ]
    return []


def qualify_unexplained(found: Trust, left: Unexplained | None) -> Unexplained | None:
    """The description of the unexplained torque, with the doubt of the model as reason where there is one."""
    if left is None or not found.broken:
        return left
    return replace(
        left, sentence=left.sentence.replace("that no cause of the catalogue explains", "under that model")
    )


def untold_remainder(axis: str) -> Unexplained:
    """What is left where nothing stands out of the noise, under a linear fit that is broken."""
    said = f"Axis {axis}: nothing stands out of the noise, which says nothing under a model that is wrong."
    return Unexplained(axis, (), (), said)
