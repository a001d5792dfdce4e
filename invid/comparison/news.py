"""A diagnosis whose headline says first what a comparison found."""

from __future__ import annotations

from dataclasses import replace

from invid.comparison.changes import Comparison
from invid.diagnosis.headline import with_headline
from invid.identification.stated_inertia import against_stated
from invid.model.diagnosis_document import Diagnosis
from invid.model.document import Model
from invid.model.doubts import DoubtCode, doubts_of
from invid.recording.model import Recording


def with_changes(diagnosis: Diagnosis, c: Comparison) -> Diagnosis:
    """Return the diagnosis whose headline and grade say what changed since the accepted model first."""
    return with_headline(replace(diagnosis, changes=c.named))


def with_stated_inertia(diagnosis: Diagnosis, recording: Recording, earlier: Model | None) -> Diagnosis:
    """Return the diagnosis that says first where the recording's config states another inertia.

    ``earlier``: an accepted model of the robot, which tells a changed machine from a wrong scale.
    """
    model = against_stated(diagnosis.model, recording, earlier)
    if model is diagnosis.model:
        return diagnosis
    old, new = (
        tuple(d.text for d in doubts_of(m.fit) if d.code is DoubtCode.STATED_INERTIA)
        for m in (diagnosis.model, model)
    )
    kept = tuple(w for w in diagnosis.warnings if w not in old + new)
    return with_headline(replace(diagnosis, model=model, warnings=(*new, *kept)))
