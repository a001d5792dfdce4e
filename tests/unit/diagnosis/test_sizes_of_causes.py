"""Sizes of causes and their standard deviations, on the plants of ``tests/hidden``."""

from hidden.generator import make

from invid.diagnosis.diagnose import diagnose


def test_a_delay_is_not_longer_by_the_half_sample_that_holding_a_torque_takes() -> None:
    recording, _ = make(
        "torque_delay",
        (0, 0),
        {"delay": 0.01},
        seed=500,
        masses=(2,),
        noise=0.003,
        drive="sampled",
    )
    (finding,) = diagnose(recording).findings
    found = finding.effect.parameters["delay"]
    half = 0.5 / recording.experiments[0].sample_rate_hz
    assert found.std is not None
    assert abs(found.value - 0.01) < max(0.1 * half, 3.0 * found.std)
    assert found.std < half
