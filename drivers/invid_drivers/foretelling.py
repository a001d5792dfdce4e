"""What is known of a cell's sensors before it moves, for the expected covariance of a plan."""

from __future__ import annotations

import numpy as np

from invid.config import CellConfig
from invid.numerics.arrays import frozen_float
from invid.planning.expected_covariance import Noise, assumed_noise
from invid_drivers.simulated import simulation_of


def sensor_noise(config: CellConfig) -> Noise:
    """Noise and lattice of every axis: those of the simulated drives, else assumed ones."""
    if not config.simulated:
        return assumed_noise(config)
    simulation = simulation_of(config)
    turn = 1.0 if config.linear else 2 * np.pi
    own = [simulation.axis(a.name) for a in config.axes]
    # as the simulated drive takes it: its own, else the axis's, else 100
    rated = np.array(
        [s.rated_torque or a.rated_torque or 100.0 for s, a in zip(own, config.axes, strict=True)]
    )
    step = np.array(
        [a.position_per_count or turn / s.encoder_counts for s, a in zip(own, config.axes, strict=True)]
    )
    return Noise(
        position=frozen_float(step * [s.position_noise_counts for s in own]),
        position_step=frozen_float(step),
        torque=frozen_float(rated * [s.torque_noise for s in own]),
        torque_step=frozen_float(rated * [1e-3 * s.torque_steps_permille for s in own]),
        source="the simulated drives of the config",
    )
