"""Chains that follow a motor's own stiffness."""

from __future__ import annotations

import numpy as np
import pytest

from invid.identification.own_stiffness import RUBBING, follow


@pytest.mark.parametrize("friction", [0.0, 2.0, 15.0])
def test_a_chain_is_followed_whatever_its_motor_rubs(friction: float) -> None:
    omega = 2 * np.pi * np.arange(0.4, 12.0, 0.25)
    masses, springs = np.array([0.7, 2.0, 3.0]), np.array([1000.0, 2000.0])
    beyond = -(omega**2) * masses[2] + 0j
    for mass, spring in zip(masses[1::-1], springs[::-1], strict=True):
        link = spring * (1 + 0.02j)
        beyond = -(omega**2) * mass + link * beyond / (link + beyond)
    size = np.abs(beyond + 1j * omega * friction)
    start = np.concatenate((masses, springs)) * np.array([1.2, 0.8, 1.1, 0.9, 1.15])
    found, _ = follow(omega, size, start[None], RUBBING)
    assert found[0] == pytest.approx(np.concatenate((masses, springs)), rel=0.05)
