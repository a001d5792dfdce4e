"""The model inside the FMU. It is copied there with ``plant.json`` and runs without invid; it needs numpy.

Co-simulation holds the torque over each communication step; the step is exact (matrix exponential), whatever
its length. In model exchange the importing tool integrates and nothing is held.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt
from pythonfmu3 import (
    Float64,
    Fmi3Causality,
    Fmi3Initial,
    Fmi3Slave,
    Fmi3Status,
    Fmi3StepResult,
    Fmi3Variability,
    ModelExchange,
    Unit,
)

Array = npt.NDArray[np.float64]
UNITS = {
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "N": {"kg": 1, "m": 1, "s": -2},
    "rad": {"rad": 1},
    "m": {"m": 1},
    "rad/s": {"rad": 1, "s": -1},
    "m/s": {"m": 1, "s": -1},
}


class InvidPlant(Fmi3Slave, ModelExchange):  # type: ignore[misc]
    """Motor torques in, motor positions and velocities out; the linear model's numbers as parameters."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        plant = json.loads((Path(self.resources) / "plant.json").read_text(encoding="utf-8"))
        self.plant = plant
        self.description = plant["description"]
        self.motors, self.lag = plant["motors"], np.array(plant["lag"])
        self.gain = np.array(plant["gain"])
        self.parameters: dict[str, float] = dict(zip(plant["parameters"], plant["values"], strict=True))
        self.torque = np.zeros(len(self.motors))
        self.state = np.zeros(2 * len(plant["mass_matrix"]) + int(np.count_nonzero(self.lag)))
        self.steps: dict[float, tuple[Array, Array]] = {}
        self.system: Array | None = None
        self.time = 0.0
        self.register_variable(
            Float64(
                "time",
                causality=Fmi3Causality.independent,
                variability=Fmi3Variability.continuous,
                getter=lambda: self.time,
            ),
            nested=False,
        )
        self.register_units([Unit(name=u, **UNITS[u]) for u in plant["units"].values()])
        for i, axis in enumerate(plant["axes"]):
            self._torque(i, f"{axis}.torque")
        for name in plant["parameters"]:
            self._parameter(name)
        self._states()

    def _torque(self, i: int, name: str) -> None:
        def put(value: float) -> None:
            self.torque[i] = value

        self.register_variable(
            Float64(
                name,
                causality=Fmi3Causality.input,
                unit=self.plant["units"]["torque"],
                getter=lambda: float(self.torque[i]),
                setter=put,
            ),
            nested=False,
        )

    def _states(self) -> None:
        """Every state with its derivative; those of the motors are the outputs."""
        names = dict(zip(self.motors, self.plant["axes"], strict=True))
        for what in ("position", "velocity"):
            for k, coordinate in enumerate(self.plant["coordinates"]):
                place = k + (what == "velocity") * len(self.plant["coordinates"])
                if k in names:
                    self._state(f"{names[k]}.{what}", what, place, Fmi3Causality.output)
                else:
                    self._state(f"{coordinate}.{what}", what, place, Fmi3Causality.local)
        lagged = (axis for axis, lag in zip(self.plant["axes"], self.lag, strict=True) if lag > 0)
        for k, axis in enumerate(lagged, start=2 * len(self.plant["coordinates"])):
            self._state(f"{axis}.acting_torque", "torque", k, Fmi3Causality.local)

    def _state(self, name: str, what: str, place: int, causality: Fmi3Causality) -> None:
        def put(value: float) -> None:
            self.state[place] = value

        continuous = {"variability": Fmi3Variability.continuous}
        reference = len(self.vars)
        self.register_variable(
            Float64(
                name,
                causality=causality,
                initial=Fmi3Initial.exact,
                unit=self.plant["units"][what],
                getter=lambda: float(self.state[place]),
                setter=put,
                **continuous,
            ),
            nested=False,
        )
        self.register_variable(
            Float64(
                f"der({name})",
                causality=Fmi3Causality.local,
                derivative=reference,
                getter=lambda: self.get_continuous_state_derivatives()[place],
                **continuous,
            ),
            nested=False,
        )

    def get_continuous_state_derivatives(self) -> list[float]:
        """ẋ = A x + B u, for model exchange."""
        if self.system is None:
            self.system = self._system()
        rates: Array = self.system[: len(self.state)] @ np.concatenate([self.state, self.torque])
        return [float(rate) for rate in rates]

    def _parameter(self, name: str) -> None:
        def put(value: float) -> None:
            self.parameters[name] = value
            self.steps.clear()
            self.system = None

        self.register_variable(
            Float64(
                name,
                causality=Fmi3Causality.parameter,
                variability=Fmi3Variability.tunable,
                getter=lambda: self.parameters[name],
                setter=put,
            ),
            nested=False,
        )

    def to_xml(self, model_options: dict[str, str] | None = None) -> Element:
        """The model description; axes may be called anything, which "structured" names may not."""
        root: Element = super().to_xml(model_options or {})
        root.set("variableNamingConvention", "flat")
        return root

    def do_step(self, current_time: float, step_size: float) -> Fmi3StepResult:
        """One communication step."""
        if step_size not in self.steps:
            try:
                self.steps[step_size] = self._step(step_size)
            except (np.linalg.LinAlgError, ValueError) as error:
                self.log(f"no plant has these parameters: {error}", Fmi3Status.error)
                return Fmi3StepResult(status=Fmi3Status.error)
        transition, drive = self.steps[step_size]
        self.state = transition @ self.state + drive @ self.torque
        self.time = current_time + step_size
        return Fmi3StepResult(status=Fmi3Status.ok)

    def _matrix(self, kind: str) -> Array:
        matrix = np.array(self.plant[f"{kind}_matrix"])
        change = self.plant[f"{kind}_derivative"]
        for name, start in zip(self.plant["parameters"], self.plant["values"], strict=True):
            for row, column, value in change.get(name, ()):
                matrix[row, column] += value * (self.parameters[name] - start)
        return matrix

    def _step(self, step: float) -> tuple[Array, Array]:
        """x⁺ = transition·x + drive·u over ``step`` [s]."""
        power, size = exponential(self._system() * step), len(self.state)
        return power[:size, :size], power[:size, size:]

    def _system(self) -> Array:
        """[[A, B], [0, 0]]."""
        mass, damping, stiffness = (self._matrix(kind) for kind in ("mass", "damping", "stiffness"))
        np.linalg.cholesky(mass)  # LinAlgError where it is not positive definite
        n, count = len(mass), len(self.motors)
        lagged = [i for i in range(count) if self.lag[i] > 0]
        direct = [i for i in range(count) if i not in lagged]
        size = 2 * n + len(lagged)
        system = np.zeros((size + count,) * 2)
        system[:n, n : 2 * n] = np.eye(n)
        system[n : 2 * n, :n] = -np.linalg.solve(mass, stiffness)
        system[n : 2 * n, n : 2 * n] = -np.linalg.solve(mass, damping)
        push = np.linalg.solve(mass, np.eye(n)[:, self.motors])
        for i in direct:
            system[n : 2 * n, size + i] = push[:, i] * self.gain[i]
        for k, i in enumerate(lagged):
            system[n : 2 * n, 2 * n + k] = push[:, i]
            system[2 * n + k, 2 * n + k] = -1.0 / self.lag[i]
            system[2 * n + k, size + i] = self.gain[i] / self.lag[i]
        return system


def exponential(matrix: Array) -> Array:
    """exp(matrix): scaled below a quarter, Taylor to the 12th order (1e-17), squared back."""
    norm = np.abs(matrix).sum(axis=0).max()
    squarings = max(0, int(np.ceil(np.log2(max(norm, 1e-300) / 0.25))))
    small = matrix / 2.0**squarings
    total: Array = np.eye(len(matrix))
    term: Array = total
    for order in range(1, 13):
        term = term @ small / order
        total = total + term
    for _ in range(squarings):
        total = total @ total
    return total
