"""From target torque to encoder over the bus: the frequency response is the plant's, inputs held."""

from __future__ import annotations

import math

import numpy as np
from node_master import Master, cell
from scipy.signal import cont2discrete

PERIOD = 500  # cycles


def test_the_response_over_the_bus_is_the_zero_order_hold_of_the_plant() -> None:
    masses, k, d, viscous = (0.7, 2.0), 1000.0, 8.0, 20.0
    simulation = {
        "plant": {
            "branches": [
                {
                    "axis": "A1",
                    "masses_kgm2": list(masses),
                    "springs_Nm_per_rad": [k],
                    "dampers_Nms_per_rad": [d],
                }
            ]
        },
        "defaults": {
            "rated_torque_Nm": 100,
            "encoder_counts_per_rev": 2**28,
            "friction": {"viscous_Nms_per_rad": viscous},
            "command_delay_cycles": 1,
        },
    }
    master = Master(cell(simulation))
    master.prepare()
    master.enable()
    lines = np.array([3, 5, 8, 13, 21, 34])  # of 2 Hz: 6 to 68 Hz, around the 7 Hz mode
    phase = np.array([0.3, 1.7, 4.0, 2.2, 5.1, 0.9])
    t = np.arange(PERIOD) / PERIOD
    wave = np.round(60 * np.cos(2 * np.pi * np.outer(t, lines) + phase).sum(axis=1)).astype(int)
    wave[0] -= wave.sum()  # no mean, no drift
    rows = []
    for n in range(16 * PERIOD):  # modes settle within 0.2 s, so e^-40 is left
        rows.append(master.cycle([int(wave[n % PERIOD])], 0x0F)[1][:2])
    master.close()
    last = np.array(rows[-PERIOD:], dtype=float)
    angle = np.fft.rfft(last[:, 0] * 2 * math.pi / 2**28)[lines]
    torque = np.fft.rfft(last[:, 1] * 0.1)[lines]

    mass = np.diag(masses)
    stiffness = k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    damping = d * np.array([[1.0, -1.0], [-1.0, 1.0]]) + np.diag([viscous, 0.0])
    inverse = np.linalg.inv(mass)
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -inverse @ damping]])
    b = np.concatenate((np.zeros(2), inverse[:, 0]))[:, None]
    c = np.array([[1.0, 0.0, 0.0, 0.0]])
    ad, bd, *_ = cont2discrete((a, b, c, np.zeros((1, 1))), 0.001)
    z = np.exp(2j * np.pi * lines / PERIOD)
    # 0x6077 at a SYNC is the torque of the interval before it: one sample later than the input
    expected = [(c @ np.linalg.solve(x * np.eye(4) - ad, bd))[0, 0] * x for x in z]
    np.testing.assert_allclose(angle / torque, expected, rtol=2e-5)
