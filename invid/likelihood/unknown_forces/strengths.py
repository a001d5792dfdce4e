"""Strengths of the unknown forces, raised and lowered by what is missed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.likelihood.unknown_forces.forces import PACE, colours, missing_noise
from invid.likelihood.unknown_forces.value import Numbers, Problem, Value, missing_torque


def stronger(problem: Problem, value: Value, steps: int = 3) -> Numbers:
    """The numbers with strengths that lower −2 ln L for the torque that is missed as it is.

    Multiplicative steps q ← q·(Σ w g |Hᴴ S⁻¹ r|² / Σ w R g Hᴴ S⁻¹ H)^½…, laws and ends as they are.
    """
    strength = value.numbers.strength
    missed = [missing_torque(value, k) for k in range(len(value.work))]
    for _ in range(steps):
        push, hold = np.zeros(strength.shape), np.zeros(strength.shape)
        for work, residual in zip(value.work, missed, strict=True):
            stack = work.stack
            shape = colours(stack.omega, problem.corner)
            noise = missing_noise(
                work.condensed.stiffness,
                work.noise.reach,
                shape @ strength.T,
                (work.position_noise, work.torque_noise),
            )
            whitener = noise.whitener
            reach = whitener @ work.noise.reach
            white = whitener @ residual.transpose(1, 2, 0)
            told = (np.abs(reach.conj().transpose(0, 2, 1) @ white) ** 2).sum(axis=2)
            expected = stack.count * (np.abs(reach) ** 2).sum(axis=1)
            push += (told * stack.weight[:, None]).T @ shape
            hold += (expected * stack.weight[:, None]).T @ shape
        moved = np.maximum(strength * (push / np.maximum(hold, 1e-300)) ** PACE, problem.least)
        moved[problem.shut] = strength[problem.shut]
        strength = moved
    return replace(value.numbers, strength=strength)
