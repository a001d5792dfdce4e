"""A search that the budget ends names what it had found, in doubt."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))
from hidden.generator import make

from invid.diagnosis.evidence import CandidateEvidence, Step
from invid.diagnosis.judged_search import JudgedSearch
from invid.diagnosis.search_pass import run_search_pass
from invid.identification.identify import identify
from invid.likelihood.joint_fit import drop_last_effect, evaluate_held_out
from invid.model.diagnosis_document import Verdict


def test_friction_found_before_the_cut_is_named_though_most_is_missing_without_the_spring() -> None:
    """A search that came to its end names nothing there: the friction may stand for what has no name."""
    recording, _ = make(
        "coulomb_friction", (0, 1), seed=301, masses=(2,), motors=1, second="cubic_stiffness", target_db=12.0,
        noise=0.003, drive="smooth",
    )  # fmt: skip
    with np.errstate(all="ignore"):
        search = run_search_pass(recording, identify(recording))
        whole = search.selection
        assert [s.chosen.term.effect.cause for s in whole.steps] == ["coulomb_friction", "cubic_stiffness"]
        fit = drop_last_effect(whole.final.fit, search.train)
        alone = CandidateEvidence(fit, evaluate_held_out(fit, search.held))
        step = Step(whole.base, alone, ((alone, alone.cost),))
        found = replace(whole, final=alone, steps=(step,))
        full, cut = (
            JudgedSearch(search, []).diagnosis(replace(found, is_cut_short=is_cut))
            for is_cut in (False, True)
        )
    assert (full.verdict, full.findings) == (Verdict.UNEXPLAINED, ())
    assert cut.verdict is Verdict.PARTLY_EXPLAINED
    assert [(f.cause, f.confidence <= 0.5) for f in cut.findings] == [("coulomb_friction", True)]
    assert cut.unexplained is not None
