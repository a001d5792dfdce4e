"""The extension is simulated over time on held-out data, and refused where it gains nothing there."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from hidden.generator import make

from invid.diagnosis import judged_search
from invid.diagnosis.diagnose import diagnose
from invid.diagnosis.time_domain_check import Replay
from invid.identification.identify import identify
from invid.model.diagnosis_document import Verdict
from invid.model.document import Estimate

QUICK = {"seed": 11, "motors": 1}


@pytest.mark.parametrize("cause", ["cubic_stiffness"])
def test_the_simulation_over_time_leaves_what_the_regression_leaves(cause: str) -> None:
    recording, _ = make(cause, target_db=20, **QUICK)
    d = diagnose(recording)
    assert d.findings
    answer = d.details["replay"]
    held = [e.key for e in recording.experiments if str(e.role) == "validate"]
    assert answer["experiments"] == held
    axis, r = answer["axes"][0], d.residual[0]
    assert axis["torque_after"] == pytest.approx(r.noise_floor, rel=0.3)
    assert axis["torque_after"] < 0.5 * r.before
    assert axis["position_after"] < axis["position_before"]
    assert answer["gain_chi2"] > answer["gain_std"] > 0


@pytest.mark.campaign
def test_an_extension_that_gains_less_than_its_uncertainty_over_time_is_refused(monkeypatch) -> None:
    recording, _ = make("coulomb_friction", target_db=20, **QUICK)
    honest = judged_search.simulate_held_out

    def useless(*given, **named):
        found = honest(*given, **named)
        assert isinstance(found, Replay)
        return replace(found, gain=3.0, std=3.5)

    monkeypatch.setattr(judged_search, "simulate_held_out", useless)
    d = diagnose(recording)
    assert d.findings == ()
    assert d.verdict is Verdict.UNEXPLAINED
    assert d.model.effects == identify(recording).effects
    assert any("refused" in w for w in d.warnings)


@pytest.mark.campaign
def test_a_wrong_extension_does_not_pass_the_simulation_over_time(monkeypatch) -> None:
    """Friction with its sign turned: the regression says so here, the simulation knows better."""
    recording, _ = make("coulomb_friction", target_db=20, **QUICK)
    honest = judged_search.simulate_held_out

    def turned(sound, spectra, linear, extended, *rest):
        (term,) = extended.effects
        wrong = replace(term, parameters={"torque": Estimate(3.0 * term.value("torque"))})
        return honest(sound, spectra, linear, replace(extended, effects=(wrong,)), *rest)

    monkeypatch.setattr(judged_search, "simulate_held_out", turned)
    d = diagnose(recording)
    assert d.findings == () or d.findings[0].confidence < 0.9
    assert any("over time" in w for w in d.warnings)
    assert np.isfinite(d.residual[0].after)
