"""An invid model as a simulator: what a colleague identified last year, say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from invid.errors import InputError
from invid.model.diagnosis_document import load_model
from invid.model.document import Model
from invid.numerics.arrays import Float64
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.simulation.run import simulate
from invid.simulators.guided import Guided

FACTOR = 2.0
"""The tie's natural frequency over the band's top: its damper sees a speed from five samples, whose error
grows with the tie."""


class InvidSimulator:
    """Integrated over time by ``invid.simulate``, whose tie to the measured motion is the guide."""

    engine = "invid"
    step = 0.0

    def __init__(self, path: Path, model: Model) -> None:
        self.path = str(path)
        # What its own recording's samples were like says nothing of this one.
        self.model = replace(model, fit={})

    def prepared(self, records: Sequence[Guided]) -> list[str]:
        """See ``Simulator.prepared``."""
        return []

    def claimed(self) -> Model | None:
        """The model."""
        return self.model

    def guide(self, given: Guided) -> tuple[Float64, Float64]:
        """See ``Simulator.guide``; the simulation finds its own start."""
        count, mass = given.torque.shape[0], np.array([m[0] for m in self.model.chains.masses])
        stiffness = mass * (2 * np.pi * FACTOR * given.high) ** 2
        experiment = Experiment(
            key=given.key, kind=Kind.OTHER, role=Role.VALIDATE, excited_axis=-1, hold_gain=stiffness,
            period_samples=0, frequencies_hz=np.zeros(0), sample_rate_hz=1.0 / given.interval,
            time=np.arange(count, dtype=np.float64) * given.interval,
            position=given.position, torque=given.torque,
        )  # fmt: skip
        unit = ("m", "N") if self.model.linear else ("rad", "N·m")
        recording = Recording("", self.model.axes, *unit, "", (experiment,))
        answer = simulate(self.model, recording).experiments[0]
        return answer.torque - given.torque, answer.position

    def corrected(self, model: Model, to: Path) -> tuple[InvidSimulator, Sequence[str]]:
        """The extended model itself: it holds everything."""
        model.save(to)
        return InvidSimulator(to, model), []


def opened(path: Path, axes: tuple[str, ...]) -> InvidSimulator:
    """The simulator; InputError for a model of other axes, or of a rigid machine in large motion."""
    model = load_model(path)
    if model.axes != axes:
        raise InputError(
            f"{path}: its axes are {', '.join(model.axes)}, the recording's {', '.join(axes)}; they must be "
            "the same in the same order"
        )
    if model.method == "trajectory":
        raise InputError(f"{path}: a model of a rigid machine in large motion; --model compares two of these")
    return InvidSimulator(path, model)
