"""A torque that keeps its own time is no noise, although it repeats with none of the periods."""

import numpy as np
import pytest
from two_masses import held, recording

from invid.diagnosis.diagnose import diagnose
from invid.model.diagnosis_document import Verdict
from invid.recording import Role
from invid.recording.model import Experiment, Kind, Recording

STEP, PERIOD, PERIODS, HZ = 0.002, 2048, 6, 7.31
LINES = np.arange(1, 100, 2)


def _experiment(rng: np.random.Generator, role: Role, key: str, tone: float, noise: float) -> Experiment:
    """Three periods of an odd multisine on a held axis, with a tone and noise of torque beside it."""
    bins = np.zeros(PERIOD // 2 + 1, complex)
    bins[LINES] = np.exp(2j * np.pi * rng.random(LINES.size)) * PERIOD / 2
    push = np.tile(np.fft.irfft(bins), PERIODS)
    time = np.arange(push.size) * STEP
    beside = tone * np.sin(2 * np.pi * HZ * time + 1.0) + noise * rng.standard_normal(push.size)
    position, torque = held(push, STEP, 60.0, 6.0, beside)
    kept = slice(3 * PERIOD, None)
    return Experiment(
        key=key,
        kind=Kind.MULTISINE,
        role=role,
        excited_axis=0,
        hold_gain=np.array([60.0]),
        period_samples=PERIOD,
        frequencies_hz=LINES / (PERIOD * STEP),
        sample_rate_hz=1.0 / STEP,
        time=time[kept],
        position=(position + 1e-7 * rng.standard_normal(push.size))[kept, None],
        torque=(torque + 0.01 * rng.standard_normal(push.size))[kept, None],
    )


def _recording(tone: float, noise: float) -> Recording:
    rng = np.random.default_rng(3)
    return recording(
        _experiment(rng, Role.IDENTIFY, "000", tone, noise),
        _experiment(rng, Role.VALIDATE, "001", tone, noise),
    )


@pytest.mark.campaign
def test_a_tone_that_repeats_with_no_period_is_said_with_its_frequency() -> None:
    found = diagnose(_recording(tone=0.5, noise=0.0))
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.findings == ()
    assert found.unexplained is not None
    assert found.unexplained.axis == "A1"
    assert found.unexplained.character == ("time-dependent",)
    assert found.unexplained.frequencies_hz == pytest.approx([HZ], abs=0.02 / (3 * PERIOD * STEP))
    (residual,) = found.residual
    assert residual.before == pytest.approx(0.5 / np.sqrt(2), rel=0.1)
    assert residual.noise_floor < 0.1 * residual.before
