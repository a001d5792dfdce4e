"""One number of an effect: name, unit, how it enters the force, bounds and starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.effects.units import unit_of
from invid.errors import InputError


@dataclass(frozen=True)
class Parameter:
    """One number of a law.

    Attributes
    ----------
    name
        As in model.json.
    unit
        Kind of quantity: "torque", "velocity", "torque/velocity^2", "ratio", … (``invid.effects.units``).
    linear
        Whether the force is proportional to it; else it is a shape, searched from ``starts`` on.
    low, high
        Bounds; a linear parameter with ``low`` 0 is positive.
    starts
        Values of a shape to start from, in its unit, where its effect finds none in the data; with
        ``of_motion`` over the rms velocity or position.
    logarithmic
        Whether a shape moves as its logarithm (it is then above zero).
    """

    name: str
    unit: str
    linear: bool = True
    low: float = -np.inf
    high: float = np.inf
    starts: tuple[float, ...] = ()
    of_motion: bool = True
    logarithmic: bool = True

    def __post_init__(self) -> None:
        what = ""
        if not (isinstance(self.name, str) and self.name.isidentifier()):
            what = "its name is one word as 'coefficient'"
        elif not self.low < self.high:
            what = f"low is {self.low}, high is {self.high}; low is below high"
        elif not self.linear and self.logarithmic and min(self.starts, default=1.0) <= 0:
            what = "starts are above zero, or logarithmic=False"
        if what:
            raise InputError(f"Parameter {self.name!r}: {what}")
        unit_of(self.unit, linear=False)
