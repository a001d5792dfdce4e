"""The mechanics behind the simulated drives: coupled chains, friction, effects, and the inner loops.

``Plant`` owns the compiled kernel's tables. Drives write commands into ``command`` and read what they
would measure from ``measure``; time goes forward only through ``advance_to``.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm

from invid.arrays import Float64
from invid_drivers.simulated import kernel
from invid_drivers.simulated.structure import Structure

_NS = 1_000_000_000


class Plant:
    """State of the mechanics in time.

    Parameters
    ----------
    structure
        Coordinates, matrices and forces.
    substep_s
        Sub-step [s]; torques are held over it.
    """

    def __init__(self, structure: Structure, substep_s: float) -> None:
        self.structure = structure
        self.h = substep_s
        self._h_ns = max(1, round(substep_s * _NS))
        self.h = self._h_ns / _NS
        n, motors = structure.dofs, structure.motors.size
        self.state = np.zeros(2 * n)
        self.external = np.zeros(n)
        self.command, self.motor_state = kernel.empty_tables(motors)
        self._level = np.zeros(structure.friction.shape[0])
        self._memory = np.zeros(structure.elements.shape[0])
        self._work = np.zeros((3, 2 * n))
        self._slot = 0
        self._steps_done = 0
        self._blend = 0.0
        self.measured = np.zeros((motors, 4), dtype=np.int64)
        self._ring = np.zeros((motors, 4))
        self._changes = list(structure.changes)
        self._set_matrices(0.0)
        self._next_change_ns = self._change_due(0)

    def set_delay(self, axis: int, seconds: float) -> None:
        """Let the torque of one motor act later than the drive believes."""
        substeps = seconds / self.h
        if substeps + 3 > self._ring.shape[1]:
            self._ring = np.zeros((self._ring.shape[0], math.ceil(substeps) + 4))
            self._slot = 0
        self.command[axis, kernel.DELAY] = substeps

    def _set_matrices(self, time_s: float) -> None:
        mass, damping, stiffness = self.structure.matrices(time_s)
        step = discretise(mass, damping, stiffness, self.h)
        self._phi, self._gamma, self._ramp = (np.ascontiguousarray(m.T) for m in step)

    def _change_due(self, now_ns: int) -> int:
        """When the matrices are next due for renewal [ns]."""
        due = [c for c in (round(t * _NS) for t in self.structure.changes) if c > now_ns]
        if self.structure.renew_s:
            due.append(now_ns + round(self.structure.renew_s * _NS))
        return min(due, default=1 << 62)

    def advance_to(self, now_ns: int) -> None:
        """Integrate all whole sub-steps up to ``now_ns``."""
        target = now_ns // self._h_ns
        while self._steps_done < target:
            stop = target
            if self._next_change_ns <= now_ns:
                stop = min(target, max(self._next_change_ns // self._h_ns, self._steps_done + 1))
            self._slot = kernel.advance(
                self.state,
                stop - self._steps_done,
                self.h,
                self._phi,
                self._gamma,
                self._ramp,
                self.structure.motors,
                self.command,
                self.motor_state,
                self._ring,
                self._slot,
                self.external,
                self.structure.elements,
                self._memory,
                self.structure.friction,
                self._level,
                self._work,
                self._blend,
            )
            self._blend = 0.0
            self._steps_done = stop
            if stop * self._h_ns >= self._next_change_ns:
                time_ns = self._steps_done * self._h_ns
                self._set_matrices(time_ns / _NS)
                self._next_change_ns = self._change_due(time_ns)

    def observe(self, now_ns: int, noise: Float64) -> list[list[int]]:
        """Advance to ``now_ns`` and return what ``kernel.sample`` gives for every drive.

        ``noise`` (M, 2): counts and thousandths of rated torque.
        """
        structure = self.structure
        if self._next_change_ns <= now_ns:
            self.advance_to(now_ns)
        target = now_ns // self._h_ns
        rest_ns = now_ns - target * self._h_ns
        self._slot = kernel.advance_and_sample(
            self.state,
            max(target - self._steps_done, 0),
            self.h,
            self._phi,
            self._gamma,
            self._ramp,
            structure.motors,
            self.command,
            self.motor_state,
            self._ring,
            self._slot,
            self.external,
            structure.elements,
            self._memory,
            structure.friction,
            self._level,
            self._work,
            self._blend,
            rest_ns / _NS,
            noise,
            self.measured,
        )
        self._steps_done = target
        self._blend = rest_ns / self._h_ns
        values: list[list[int]] = self.measured.tolist()
        return values

    @property
    def positions(self) -> Float64:
        """Coordinates [rad or m]."""
        return self.state[: self.structure.dofs]

    @property
    def velocities(self) -> Float64:
        """Velocities [rad/s or m/s]."""
        return self.state[self.structure.dofs :]


def discretise(
    mass: Float64, damping: Float64, stiffness: Float64, h: float
) -> tuple[Float64, Float64, Float64]:
    """Exact step of M q̈ + C q̇ + K q = f over h, for f held and for f rising from 0 to f.

    Returns Φ (2n, 2n), Γ (2n, n) with x⁺ = Φx + Γf, and the ramp matrix (2n, n).
    Van Loan's augmented matrix exponential.
    """
    n = mass.shape[0]
    inverse = np.linalg.inv(mass)
    augmented = np.zeros((4 * n, 4 * n))
    augmented[:n, n : 2 * n] = np.eye(n)
    augmented[n : 2 * n, :n] = -inverse @ stiffness
    augmented[n : 2 * n, n : 2 * n] = -inverse @ damping
    augmented[n : 2 * n, 2 * n : 3 * n] = inverse
    augmented[2 * n : 3 * n, 3 * n :] = np.eye(n) / h
    step = expm(augmented * h)
    top = step[: 2 * n]
    return top[:, : 2 * n], top[:, 2 * n : 3 * n], top[:, 3 * n :]
