"""Samples that were lost and repeated, as a finding beside what the search names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from invid.effects.units import unit_of
from invid.model.diagnosis_document import Diagnosis, Finding, Verdict
from invid.model.document import EffectTerm, Estimate
from invid.recording.model import Recording
from invid.signals.dropped_rows import DroppedRows
from invid.wording.sentence import sentence

CONFIDENCE = 0.99
"""Of lost samples: the false alarms of their test are a hundred times rarer (statistical)."""


def with_lost_samples(result: Diagnosis, recording: Recording, dropped: Sequence[DroppedRows]) -> Diagnosis:
    """The diagnosis of a recording whose repeated rows were interpolated, with them as findings.

    What they cost is not in ``residual``, which is that of the repaired rows.
    """
    findings = tuple(_finding(result, recording, d) for d in dropped)
    if not findings:
        return result
    complete = result.verdict in (Verdict.CONSISTENT, Verdict.EXPLAINED)
    own = () if result.verdict is Verdict.CONSISTENT else result.sentences
    return replace(
        result,
        verdict=Verdict.EXPLAINED if complete else Verdict.PARTLY_EXPLAINED,
        findings=(*findings, *result.findings),
        model=result.model.extended(*(f.effect for f in findings)),
        sentences=(*(f.sentence for f in findings), *own),
    )


def _finding(result: Diagnosis, recording: Recording, dropped: DroppedRows) -> Finding:
    axis = recording.axes[dropped.axis]
    missed = next(r for r in result.residual if r.axis == axis)
    fraction = Estimate(dropped.fraction, dropped.std, unit_of("ratio", False))
    return Finding(
        effect=EffectTerm("dropped_samples", axis, {"fraction": fraction}),
        confidence=CONFIDENCE,
        before=missed.before,
        after=missed.after,
        fraction=0.0,
        sentence=(
            sentence(
                "Axis {axis}: {share:.2g} % of the samples were lost and the one before was repeated.",
                axis=axis,
                share=100 * dropped.fraction,
            )
        ),
    )
