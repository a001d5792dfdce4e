"""State space as a MAT file: A, B, C, D with the parameters' covariance (MATLAB, Octave, python-control).

States are the coordinates, their rates, and the acting torque of each axis whose torque lags.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from scipy.io import savemat

from invid.exchange.linear_plant import LinearPlant, ParameterSpread, derivatives, effect_losses
from invid.numerics.arrays import Float64


@dataclass(frozen=True, eq=False)
class StateSpace:
    """ẋ = A x + B u, y = C x + D u: u motor torques (M,), y motor positions (M,)."""

    a: Float64
    b: Float64
    c: Float64
    d: Float64
    states: tuple[str, ...]


def state_space(plant: LinearPlant) -> StateSpace:
    """The plant in state space, SI units."""
    n, count = plant.mass.shape[0], len(plant.motors)
    lagged = [i for i in range(count) if plant.lag[i] > 0.0]
    direct = [i for i in range(count) if i not in lagged]
    a = np.zeros((2 * n + len(lagged),) * 2)
    b = np.zeros((2 * n + len(lagged), count))
    a[: 2 * n, : 2 * n] = plant.matrices.rates
    push = np.linalg.solve(plant.mass, np.eye(n)[:, list(plant.motors)])
    b[n : 2 * n, direct] = push[:, direct] * plant.gain[direct]
    for k, i in enumerate(lagged):
        a[n : 2 * n, 2 * n + k] = push[:, i]
        a[2 * n + k, 2 * n + k] = -1.0 / plant.lag[i]
        b[2 * n + k, i] = plant.gain[i] / plant.lag[i]
    c = np.zeros((count, a.shape[0]))
    c[np.arange(count), list(plant.motors)] = 1.0
    states = (
        *(f"{name}.position" for name in plant.coordinates),
        *(f"{name}.velocity" for name in plant.coordinates),
        *(f"{plant.axes[i]}.acting_torque" for i in lagged),
    )
    return StateSpace(a, b, c, np.zeros((count, count)), states)


def content(plant: LinearPlant, spread: ParameterSpread, *, robot: str, losses: list[str]) -> bytes:
    """The MAT file (version 5)."""
    system = state_space(plant)
    mass, damping, stiffness = derivatives(plant, spread.names)
    torque, position = ("N", "m") if plant.linear_axes else ("N·m", "rad")
    variables: dict[str, Any] = {
        "format": "invid-statespace",
        "format_version": 1.0,
        "robot": robot,
        "A": system.a,
        "B": system.b,
        "C": system.c,
        "D": system.d,
        "inputs": _cells([f"{axis}.torque" for axis in plant.axes]),
        "outputs": _cells([f"{axis}.position" for axis in plant.axes]),
        "states": _cells(system.states),
        "input_unit": torque,
        "output_unit": position,
        "input_delay": plant.delay,
        "parameters": _cells(spread.names),
        "values": spread.values,
        "covariance": spread.covariance,
        "mass_matrix": plant.mass,
        "damping_matrix": plant.damping,
        "stiffness_matrix": plant.stiffness,
        "mass_derivative": mass,
        "damping_derivative": damping,
        "stiffness_derivative": stiffness,
        "losses": _cells(losses),
    }
    file = BytesIO()
    savemat(file, variables, oned_as="column", do_compression=True)
    return file.getvalue()


def _cells(texts: list[str] | tuple[str, ...]) -> np.ndarray[Any, np.dtype[np.object_]]:
    out = np.empty(len(texts), dtype=object)
    out[:] = list(texts)
    return out


losses = effect_losses
"""What is not linear is not held."""
