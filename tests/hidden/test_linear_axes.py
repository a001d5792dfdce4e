"""Ripples over the position of axes in metres: a magnet's pitch, a screw's."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from invid.diagnosis.diagnose import diagnose

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.generator import make
from hidden.scoring import score


@pytest.mark.parametrize(("cause", "seed"), [("cogging", 2), ("transmission_error", 12)])
def test_a_ripple_of_a_linear_axis_is_named_with_its_pitch(cause: str, seed: int) -> None:
    recording, truth = make(cause, seed=seed, linear=True, target_db=25.0)
    assert recording.position_unit == "m"
    found = diagnose(recording)
    assert score(truth, found).outcome == "right"
    (finding,) = found.findings
    true = truth.effects[0].parameters
    for key, value in true.items():
        assert finding.effect.value(key) == pytest.approx(value, rel=0.02, abs=0.02), key
    size = {"cogging": ("torque", "N"), "transmission_error": ("amplitude", "m")}[cause]
    assert finding.effect.parameters[size[0]].unit == size[1]
