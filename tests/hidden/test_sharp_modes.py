"""A mode sharper than the grid that screens it."""

from __future__ import annotations

from hidden.generator import make
from hidden.scoring import score
from invid.diagnosis.diagnose import diagnose


def test_a_sharp_mode_at_the_motor_is_found_between_the_shapes_of_the_grid() -> None:
    """The next shape of the grid took less than masses elsewhere do: it was not looked at."""
    recording, truth = make("extra_mode", seed=1140014, target_db=31.3)
    diagnosis = diagnose(recording)
    assert score(truth, diagnosis).outcome == "right"
    assert diagnosis.findings[0].confidence > 0.9
