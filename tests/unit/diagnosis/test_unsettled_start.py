"""A motion that still settles is told from a process that scatters."""

import numpy as np
import pytest
from two_masses import NOISE, PERIOD, from_rest
from two_masses import recording as recording_of

from invid.diagnosis.diagnose import diagnose
from invid.model.diagnosis_document import Verdict
from invid.recording import Role


def test_the_noise_floor_of_a_record_from_rest_is_that_of_its_sensors() -> None:
    """Two periods whose motion dies away differ from each other: that is no noise."""
    recording = recording_of(from_rest(1, Role.IDENTIFY, "000"), from_rest(2, Role.VALIDATE, "001"))
    diagnosis = diagnose(recording)
    assert diagnosis.verdict is Verdict.CONSISTENT
    (residual,) = diagnosis.residual
    # White noise of two averaged periods on the lines in use: 60 excited ones, their gaps, a fifth above.
    lines = 1.2 * 119
    expected = NOISE * np.sqrt(2 * lines / (2 * PERIOD))
    assert residual.noise_floor == pytest.approx(expected, rel=0.15)
    assert residual.after == pytest.approx(expected, rel=0.2)
