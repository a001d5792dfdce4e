"""What is said of torque that no cause explains: what it goes with."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hidden.generator import make

from invid.diagnosis.diagnose import diagnose
from invid.numerics.arrays import Float64

Torque = Callable[[Float64, Float64, Float64], Float64]


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("torque", "character"),
    [
        (lambda time, position, velocity: np.exp(-time / 40.0), "time-dependent"),
        (lambda time, position, velocity: np.tanh(time / 10.0 - 2.0), "time-dependent"),
        (lambda time, position, velocity: velocity * np.abs(velocity), "velocity-dependent"),
    ],
    ids=["cooling down", "a load that comes slowly", "drag"],
)
def test_torque_without_a_name_is_said_to_go_with_what_it_goes_with(torque: Torque, character: str) -> None:
    recording, _ = make(None, seed=7, motors=1, masses=(2,), noise=0.003, moves=False)
    experiments = []
    for e in recording.experiments:
        position = e.position[:, 0]
        velocity = np.gradient(position, e.time)
        extra = torque(e.time, position / position.std(), velocity / velocity.std())
        size = 0.3 * e.torque.std()
        experiments.append(replace(e, torque=e.torque + size * extra[:, None]))
    found = diagnose(replace(recording, experiments=tuple(experiments))).unexplained
    assert found is not None
    said = {c for c in found.character if c not in ("odd", "even")}
    assert said == {character}
