"""Plants and drives that a plain fit gets wrong: barely visible modes, springs to ground, late reversals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.shared import plant_oracle as oracle
from invid.cli.app import run
from invid.identification.identify import identify
from invid.model.document import Model
from invid.recording import write_recording
from invid.recording.model import Experiment, Kind, Recording, Role

RATE = 500.0


def record(
    plant: oracle.OraclePlant,
    *,
    seed: int = 1,
    band: tuple[float, float],
    stiff: float = 0.0,
    in_drive: bool = False,
    noise: float = 0.002,
    position_noise: float = 2e-6,
) -> Recording:
    """One axis, three periods in steady state; ``stiff`` is a spring to ground (a hold not recorded)."""
    rng = np.random.default_rng(seed)
    period, peak = 4000, 20.0
    wave, hz = oracle.multisine(rng, period, RATE, band)
    demand = peak * np.tile(wave, 5)[:, None]
    gain = np.array([stiff if stiff else 100.0])
    damping = np.array([0.02 * stiff if stiff else 20.0])
    position, torque = oracle.simulate(
        plant, demand, RATE, gain=gain, damping=damping, in_drive=in_drive or stiff > 0
    )
    seen = demand if stiff else torque
    keep = slice(2 * period, None)
    position = position[keep] + position_noise * rng.standard_normal((3 * period, 1))
    seen = seen[keep] + noise * peak * rng.standard_normal((3 * period, 1))
    experiment = Experiment(
        "000", Kind.MULTISINE, Role.IDENTIFY, 0, np.zeros(1) if stiff else gain, period, hz, RATE,
        np.arange(3 * period) / RATE, position, seen,
    )  # fmt: skip
    return Recording("hard", ("A1",), "rad", "N·m", "2026-11-21T00:00:00Z", (experiment,))


def worst(model: Model, plant: oracle.OraclePlant) -> float:
    masses = np.abs(model.chains.masses[0] / plant.masses[0] - 1).max()
    springs = np.abs(model.chains.springs[0] / plant.springs[0] - 1).max()
    return float(max(masses, springs))


# The third mode (9.4 Hz) moves the motor by a hundredth of the first: its peak is lost in a 2 % error.


def test_a_hold_inside_the_drive_that_is_recorded_as_one_with_the_command_widens_the_motor_mass() -> None:
    plant = oracle.OraclePlant([[1.0, 2.0]], [[1500.0]], [[0.8]])
    model = identify(record(plant, band=(0.3, 13.0), in_drive=True), masses=(2,))
    assert abs(model.chains.masses[0][0] - 1.0) < 3.0 * model.std.masses[0][0]


def test_a_motor_that_rubs_and_is_held_inside_the_drive_says_what_the_hold_may_cost() -> None:
    plant = oracle.OraclePlant([[1.0, 2.0]], [[1500.0]], [[0.8]], coulomb=(0.6,))
    model = identify(record(plant, band=(0.3, 13.0), in_drive=True), masses=(2,))
    assert abs(model.chains.masses[0][0] - 1.0) < 3.0 * model.std.masses[0][0]


@pytest.mark.parametrize("late", [0, 2])
def test_a_demand_logged_beside_an_aperiodic_record_tells_when_the_hold_acts(late: int) -> None:
    plant = oracle.OraclePlant([[1.0, 2.0]], [[1500.0]], [[0.8]])
    rng = np.random.default_rng(5)
    count, peak = 10_000, 20.0
    wave, _ = oracle.multisine(rng, count, RATE, (0.3, 13.0), odd=False)
    demand = peak * wave[:, None] * np.minimum(np.arange(count) / 500, 1.0)[:, None]
    position, torque = oracle.simulate(
        plant, demand, RATE, gain=np.array([300.0]), damping=np.array([40.0]), in_drive=True
    )
    torque = np.concatenate((np.zeros((late, 1)), torque))[:count]
    experiment = Experiment(
        "000", Kind.OTHER, Role.IDENTIFY, 0, np.array([np.nan]), 0, np.zeros(0), RATE,
        np.arange(count) / RATE, position + 2e-6 * rng.standard_normal((count, 1)),
        torque + 0.04 * rng.standard_normal((count, 1)), torque_demand=demand,
    )  # fmt: skip
    recording = Recording("hard", ("A1",), "rad", "N·m", "2026-11-21T00:00:00Z", (experiment,))
    model = identify(recording, masses=(2,))
    assert model.fit["trustworthy"]
    assert not any("a hold works" in w for w in model.warnings)
    # The command, held over its sample, acts half of it after its instant; the record shows it ``late``.
    assert model.fit["time_offset_s"]["A1.time_offset"]["value"] == pytest.approx(
        (0.5 - late) / RATE, abs=1e-4
    )
    # Half a sample of this hold's damping is 4 % of the motor's mass; the drive's loop leaves an eighth.
    assert worst(model, plant) < 0.01
    assert abs(model.chains.masses[0][0] - 1.0) < 3.5 * model.std.masses[0][0]


def test_a_demand_logged_in_periods_that_still_settle_tells_when_the_hold_acts() -> None:
    plant = oracle.OraclePlant([[1.0, 2.0]], [[1500.0]], [[0.3]])
    rng = np.random.default_rng(1)
    wave, hz = oracle.multisine(rng, 2000, RATE, (0.5, 12.0), odd=False)
    demand = 20.0 * np.tile(wave, 3)[:, None]
    position, torque = oracle.simulate(  # from rest, and the hold swings for seconds
        plant, demand, RATE, gain=np.array([300.0]), damping=np.array([1.5]), in_drive=True
    )
    experiment = Experiment(
        "000", Kind.MULTISINE, Role.IDENTIFY, 0, np.array([np.nan]), 2000, hz, RATE, np.arange(6000) / RATE,
        position + 1e-6 * rng.standard_normal((6000, 1)), torque + 0.1 * rng.standard_normal((6000, 1)),
        torque_demand=demand,
    )  # fmt: skip
    recording = Recording("hard", ("A1",), "rad", "N·m", "2026-11-21T00:00:00Z", (experiment,))
    settling = np.abs(position[2000:4000] - position[4000:]).max()
    assert settling > 0.01 * np.ptp(position)  # else the case shows nothing
    model = identify(recording, masses=(2,))
    assert model.fit["trustworthy"]
    assert not any("a hold works" in w for w in model.warnings)
    assert worst(model, plant) < 0.003


@pytest.mark.campaign
def test_too_few_masses_are_doubted_and_the_command_says_so_with_status_3(tmp_path: Path) -> None:
    plant = oracle.OraclePlant([[1.0, 2.0, 1.5]], [[3000.0, 2500.0]], [[1.0, 1.0]])
    recording = replace(record(plant, band=(0.5, 14.0)), masses_per_axis=(2,))
    model = identify(recording)
    assert not model.fit["trustworthy"]
    assert any("number of masses" in d for d in model.fit["doubts"])
    write_recording(recording, tmp_path / "r.h5")
    assert run(["identify", str(tmp_path / "r.h5")]) == 3
