"""Nothing is sure where a record does not show what its sensors' noise alone would leave."""

import numpy as np
from test_consequence_grades import diagnosis as document_of
from test_consequence_grades import term

from invid.diagnosis.unknown_forces.floor_doubts import doubt_floors
from invid.recording.model import Experiment, Kind, Recording, Role

RATE, PERIOD, PERIODS = 1000.0, 4096, 6


def recording(corner_hz: float | None, periods: int = PERIODS) -> Recording:
    """Three axes with a multisine and white noise in their torque, the first one's through a low-pass."""
    rng = np.random.default_rng(11)
    count = PERIOD * periods
    hz = np.fft.rfftfreq(PERIOD, 1 / RATE)[1:82:2]
    time = np.arange(count) / RATE
    wave = np.sum([np.sin(2 * np.pi * f * time + rng.uniform(0, 6)) for f in hz], axis=0)
    torque = wave[:, None] + 0.1 * rng.standard_normal((count, 3))
    if corner_hz is not None:
        share = 1.0 / (1.0 + 1j * np.fft.rfftfreq(count, 1 / RATE) / corner_hz) ** 2
        torque[:, 0] = np.fft.irfft(np.fft.rfft(torque[:, 0]) * share, count)
    one = Experiment(
        "000", Kind.MULTISINE, Role.VALIDATE, 0, np.zeros(3), PERIOD, hz, RATE, time, 0.01 * torque, torque
    )
    return Recording("cell", ("A1", "A2", "A3"), "rad", "N·m", "2026-01-01T00:00:00Z", (one,))


def test_a_filtered_torque_has_no_floor_and_what_stands_on_it_is_in_doubt() -> None:
    found = document_of(term("coulomb_friction", torque=0.4), term("coulomb_friction", "A2", torque=0.4))
    doubted = doubt_floors(found, recording(100.0))
    assert [r.noise_floor is None for r in doubted.residual] == [True, False, False]
    assert [f.confidence for f in doubted.findings] == [0.5, 0.99]
    assert any("low-pass" in w for w in doubted.warnings)


def test_white_noise_keeps_its_floor() -> None:
    found = document_of(term("coulomb_friction", torque=0.4))
    assert doubt_floors(found, recording(None)) is found


def test_one_short_period_makes_nothing_sure() -> None:
    found = document_of(term("coulomb_friction", torque=0.4))
    doubted = doubt_floors(found, recording(None, periods=1))
    assert all(r.noise_floor is None for r in doubted.residual)
    assert all(f.confidence <= 0.5 for f in doubted.findings)
