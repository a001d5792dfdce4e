"""Stepped sine as others record it: every frequency an experiment of its own, settled or from rest."""

import numpy as np
import pytest
from two_masses import MASS, SPRING, held
from two_masses import recording as recording_of

from invid.identification.identify import identify
from invid.recording import Role
from invid.recording.model import Experiment, Kind

STEP = 0.002
HOLD = 40.0


def sine(key: int, samples: int, cycles: int, settled: bool, rng: np.random.Generator) -> Experiment:
    """One frequency of a two-mass axis (0.7 and 2 kg·m², 1000 N·m/rad), held softly by the master."""
    ahead = samples * int(np.ceil(20.0 / STEP / samples)) if settled else 0
    excitation = 5.0 * np.sin(2 * np.pi * np.arange(ahead + samples * cycles) / samples)
    position, torque = held(excitation, STEP, HOLD, rate=8.0)
    position, torque = position[ahead:], torque[ahead:]
    return Experiment(
        key=f"{key:03d}",
        kind=Kind.STEPPED_SINE,
        role=Role.IDENTIFY,
        excited_axis=0,
        hold_gain=np.array([HOLD]),
        period_samples=samples,
        frequencies_hz=np.array([1.0 / (samples * STEP)]),
        sample_rate_hz=1.0 / STEP,
        time=np.arange(position.size) * STEP,
        position=(position + 1e-6 * rng.standard_normal(position.size))[:, None],
        torque=(torque + 0.02 * rng.standard_normal(torque.size))[:, None],
        torque_demand=torque[:, None],
    )


@pytest.mark.parametrize(
    "settled",
    [pytest.param(True, id="settled", marks=pytest.mark.campaign), pytest.param(False, id="from rest")],
)
def test_one_experiment_a_frequency_gives_the_masses_and_the_spring(settled: bool) -> None:
    rng = np.random.default_rng(3)
    periods = np.unique(np.round(1.0 / STEP / np.geomspace(0.8, 9.0, 14)).astype(int))[::-1]
    recording = recording_of(*(sine(i, int(n), 5, settled, rng) for i, n in enumerate(periods)))
    model = identify(recording)
    found = [*model.chains.masses[0], *model.chains.springs[0]]
    assert found == pytest.approx([*MASS, SPRING], rel=0.01)
    error = (np.array(found) - [*MASS, SPRING]) / [*model.std.masses[0], *model.std.springs[0]]
    assert np.abs(error).max() < 4.0
