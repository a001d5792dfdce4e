"""The mechanics behind the simulated drives: coupled chains, friction, effects, and the inner loops.

``Plant`` owns the compiled kernel's tables. Drives write commands into ``command`` and read what they
would measure from ``measure``; time goes forward only through ``advance_to``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from invid.numerics.arrays import Float64
from invid.simulation.laws import compiled_laws
from invid.simulation.plant import Step, discretise
from invid_drivers.simulated import kernel
from invid_drivers.simulated.structure import Structure

_NS = 1_000_000_000
_PARTS_KEPT = 64
"""Parts of a sub-step whose matrices are kept: the bus repeats a handful of instants a cycle."""


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
        self._h_ns = max(1, round(substep_s * _NS))
        self.h = self._h_ns / _NS
        n, motors = structure.dofs, structure.motors.size
        self.state = np.zeros(2 * n)
        self.external = np.zeros(n)
        self.command, self.motor_state = kernel.empty_tables(motors)
        self.measured = np.zeros((motors, 4), dtype=np.int64)
        self.exact_instants = True
        """Step to every instant asked for. In real time, where instants never repeat and each new part
        of a sub-step would cost a matrix exponential, False: whole sub-steps only, what is measured
        is extrapolated and a command's impulse is kept."""
        self._laws = compiled_laws(structure.forces, np.zeros((1, 2)))
        self._work = np.zeros((3, 2 * n))
        self._ring = np.zeros((motors, 4))
        self._slot = 0
        self._blend = 0.0
        self._time_ns = 0
        self._parts: dict[int, Step] = {}
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
        self._matrices = self.structure.matrices(time_s)
        self._parts.clear()
        self._whole = self._part(self._h_ns)

    def _part(self, length_ns: int) -> Step:
        """The step of one sub-step or a part of it, kept because bus timing repeats."""
        found = self._parts.get(length_ns)
        if found is None:
            if len(self._parts) >= _PARTS_KEPT:
                self._parts.clear()
            found = self._parts[length_ns] = discretise(self._matrices, length_ns / _NS)
        return found

    def _change_due(self, now_ns: int) -> int:
        """When the matrices are next due for renewal [ns]."""
        due = [c for c in (round(t * _NS) for t in self.structure.changes) if c > now_ns]
        if self.structure.renew_s:
            due.append(now_ns + round(self.structure.renew_s * _NS))
        return min(due, default=1 << 62)

    def advance_to(self, now_ns: int) -> None:
        """Integrate up to ``now_ns``."""
        while self._next_change_ns <= now_ns:
            change_ns = self._next_change_ns
            self._step_to(change_ns)
            self._set_matrices(change_ns / _NS)
            self._next_change_ns = self._change_due(change_ns)
        self._step_to(now_ns)

    def _step_to(self, now_ns: int) -> None:
        whole, rest_ns = divmod(now_ns - self._time_ns, self._h_ns)
        if whole > 0:
            self._run(whole, self.h, self._whole)
            self._time_ns += whole * self._h_ns
        if rest_ns and whole >= 0 and self.exact_instants:
            self._run(1, rest_ns / _NS, self._part(rest_ns))
            self._time_ns = now_ns

    def _run(self, steps: int, h: float, step: Step) -> None:
        self._slot = kernel.march(*self._march(steps, h, step))
        self._blend = 0.0

    def _march(self, steps: int, h: float, step: Step) -> tuple[Any, ...]:
        """The arguments of ``kernel.march``."""
        return (
            self.state, steps, h, step.compiled, self._laws, self.structure.motors, self.command,
            self.motor_state, self._ring, self._slot, self.external, self._work, self._blend,
        )  # fmt: skip

    def observe(self, now_ns: int, noise: Float64) -> list[list[int]]:
        """Advance to ``now_ns`` and return what ``kernel.sample`` gives for every drive.

        ``noise`` (M, 2): counts and thousandths of rated torque.
        """
        whole, rest_ns = divmod(now_ns - self._time_ns, self._h_ns)
        if self._next_change_ns <= now_ns or (rest_ns and self.exact_instants):
            self.advance_to(now_ns)
            whole, rest_ns = divmod(now_ns - self._time_ns, self._h_ns)
        self._slot = kernel.march_and_sample(
            rest_ns / _NS if whole >= 0 else 0.0,
            noise,
            self.measured,
            *self._march(max(whole, 0), self.h, self._whole),
        )
        if whole >= 0:
            self._time_ns += whole * self._h_ns
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
