"""Records that are valid and unusual: an analysis ends, and every figure is a number."""

import numpy as np
import pytest
from large_motion import experiment, recording

from invid.diagnosis.rigid import diagnose_trajectory
from invid.model.diagnosis_document import Diagnosis
from invid.recording import Experiment, Kind, Role

RATE = 500.0


def _axes(
    rng: np.random.Generator, q: np.ndarray, resistance: np.ndarray, key: str, role: Role = Role.IDENTIFY
) -> Experiment:
    """Two axes of 0.3 and 0.2 kg·m² that moved along ``q`` (n, 2) against ``resistance`` (n, 2)."""
    time = np.arange(q.shape[0]) / RATE
    rate = np.gradient(np.gradient(q, time, axis=0), time, axis=0)
    torque = np.array([0.3, 0.2]) * rate + resistance + 0.02 * rng.standard_normal(q.shape)
    return experiment(time, q + 1e-6 * rng.standard_normal(q.shape), torque, Kind.OTHER, key, role)


def _are_numbers(found: Diagnosis) -> bool:
    residual = [[r.before, r.after, r.noise_floor] for r in found.residual]
    share = found.explained_fraction
    return bool(np.isfinite(residual).all()) and (share is None or bool(np.isfinite(share)))


@pytest.mark.timeout(60)
@pytest.mark.parametrize("seed", range(4))
def test_friction_in_one_direction_only_comes_to_an_end(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.arange(4000)[:, None] / RATE
    size, rate = rng.uniform(2.0, 3.0, 2), 2 * np.pi * rng.uniform(0.3, 0.6, 2)
    q = size * np.sin(rate * time) + 0.3 * size * np.sin(2.3 * rate * time + 1.0)
    v = np.gradient(q, time[:, 0], axis=0)
    found = diagnose_trajectory(recording(_axes(rng, q, np.where(v > 0, 2.0 + 0.4 * v, 0.1 * v), "000")))
    assert _are_numbers(found)
    assert found.findings


def test_constant_velocities_of_a_second_each_leave_numbers() -> None:
    rng = np.random.default_rng(1)
    records = []
    for number, speed in enumerate(s * a for a in (0.2, 0.4, 0.6, 0.8, 1.0, 1.2) for s in (1, -1)):
        time = np.arange(24) / 20.0
        velocity = speed * np.clip(np.minimum(time, time[-1] - time) / 0.35, 0.0, 1.0)
        torque = 2.0 * np.sign(speed) + 0.5 * speed + 0.02 * rng.standard_normal(time.size)
        position = np.cumsum(velocity) / 20.0
        records.append(
            experiment(
                time,
                position[:, None],
                torque[:, None],
                Kind.CONSTANT_VELOCITY,
                f"{number:03d}",
                Role.IDENTIFY,
            )
        )
    assert _are_numbers(diagnose_trajectory(recording(*records)))
