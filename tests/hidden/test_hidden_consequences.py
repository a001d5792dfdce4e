"""What a hidden cause amounts to on its machine, beside the truth that was simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hidden.generator import make
from invid.diagnosis.diagnose import diagnose
from invid.model.diagnosis_document import Grade


@pytest.mark.parametrize(
    ("share", "grade"), [(0.02, Grade.AS_EXPECTED), (0.2, Grade.WATCH), (0.5, Grade.ACT)]
)
def test_the_share_of_rated_torque_and_its_grade_are_those_of_the_simulated_friction(
    share: float, grade: Grade
) -> None:
    recording, truth = make("coulomb_friction", seed=11, motors=1, target_db=20)
    true = truth.effects[0].parameters["torque"]
    recording = replace(recording, rated_torque=np.array([true / share]))
    result = diagnose(recording)
    finding = result.findings[0]
    assert finding.effect.cause == "coulomb_friction"
    assert finding.consequence is not None
    std = finding.effect.parameters["torque"].std
    assert finding.consequence.share_of_rated_torque == pytest.approx(share, abs=4 * std / true * share)
    assert finding.consequence.grade is grade
    # At 20 dB a static part at the slowest speeds may be told from none or not.
    begins = "Dry friction" if grade is Grade.AS_EXPECTED else "The mechanics: dry friction"
    assert result.headline.startswith(begins)
    assert f" on {finding.effect.axis}" in result.headline
