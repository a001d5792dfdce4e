"""Dry friction so strong that the motor sticks again and again, in motion that never repeats."""

import numpy as np
import pytest

from benchmarks.shared import plant_oracle as oracle
from invid.diagnosis.diagnose import diagnose
from invid.recording.model import Experiment, Kind, Recording, Role

RATE, SECONDS = 2000.0, 10.0
DRY, VISCOUS = 0.25, 0.05


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [pytest.param(3, marks=pytest.mark.panel), 4])
def test_friction_of_a_motor_that_sticks_in_chirps_is_named_with_its_sizes_and_as_nothing_else(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    plant = oracle.OraclePlant([[0.05, 0.12]], [[90.0]], [[0.03]], coulomb=(DRY,), viscous=(VISCOUS,))
    t = np.arange(int(RATE * SECONDS)) / RATE
    experiments = []
    for number, (role, top) in enumerate(((Role.IDENTIFY, 15.0), (Role.VALIDATE, 12.0))):
        turns = 0.5 * t + (top - 0.5) * t**2 / (2 * SECONDS) + rng.uniform()
        wave = (rng.uniform(2.0, 3.0) * np.sin(2 * np.pi * turns) * np.minimum(1.0, t / 0.2))[:, None]
        position, torque = oracle.simulate(plant, wave, RATE, gain=np.array([1.5]), damping=np.array([0.2]))
        step = 2 * np.pi / 2**20
        experiments.append(
            Experiment(
                f"{number:03d}", Kind.OTHER, role, 0, np.full(1, np.nan), 0, np.zeros(0), RATE,
                np.arange(wave.size) / RATE + 11 * number, np.round(position / step) * step,
                torque + 0.01 * rng.standard_normal(torque.shape),
            )
        )  # fmt: skip
    recording = Recording("arm", ("J1",), "rad", "N·m", "2026-12-01T00:00:00Z", tuple(experiments))
    speed = np.abs(np.diff(experiments[0].position[:, 0]))
    assert (speed < 0.02 * speed.std()).mean() > 0.08
    found = diagnose(recording)
    sizes = {f.effect.cause: f.effect.parameters for f in found.findings}
    assert set(sizes) == {"coulomb_friction", "viscous_friction"}
    assert sizes["coulomb_friction"]["torque"].value == pytest.approx(DRY, rel=0.01)
    assert sizes["viscous_friction"]["coefficient"].value == pytest.approx(VISCOUS, rel=0.05)
    assert found.residual[0].after < 3.0 * found.residual[0].noise_floor
