"""What holds of unknown damping that work while their axis is driven leave open of a motor's own mass.

A hold inside the drive acts half a sample before one that is held over the sample with the command. Recorded
as one torque, the two differ by (z − 1)(P + jωD)θ with z what holding over the sample does: to first order a
viscous friction P·h/2 and a motor mass D·h/2. Where no record shows the hold alone nothing tells them apart.
"""

from __future__ import annotations

import numpy as np

from invid.identification.quantities import Quantities
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.model.plant import Kind
from invid.numerics.arrays import Float64


def open_masses(end: FittedHypothesis) -> Float64:
    """(M,) mass of each motor that its hold leaves open.

    P is as stated, or bounded by the friction that it makes; D is damped near critically, 2·√(P·S) with S the
    axis' whole inertia.
    """
    records = [r for s in end.bench.stacks for r in s.records]
    motors = end.hypothesis.structure.motors
    out = np.zeros(motors)
    mass, structure = end.numbers.plant.of_kind(Kind.MASS), end.hypothesis.structure
    for i in range(motors):
        driven = [r for r in records if r.driven[i]]
        is_told = all(
            r.is_hold_sampled or (r.command is not None and np.isfinite(r.command[0, i])) for r in driven
        )
        if not driven or is_told or any(np.isfinite(r.hold_damping[i]) for r in records):
            continue
        gains = np.array([r.hold[i] for r in driven])
        stated = float(np.nanmax(gains, initial=0.0))
        if not stated and not np.isnan(gains).any():
            continue
        half = 0.5 * driven[0].step
        stiffness = stated or _friction(end, i) / half
        whole = mass[structure.motor[i] : structure.load[i] + 1].sum()
        out[i] = 2.0 * float(np.sqrt(stiffness * whole)) * half
    return out


def _friction(end: FittedHypothesis, motor: int) -> float:
    """Viscous friction of a motor and one standard deviation of it: what a hold can have made of it."""
    known = Quantities.of(end)
    at = known.coefficient((Part.VISCOUS, motor))
    if at is None:
        return 0.0
    return max(float(known.values[at]), 0.0) + float(np.sqrt(known.around.covariance[at, at]))
