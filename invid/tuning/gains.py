"""Velocity and position gains and notch filters: the fastest loops whose margins hold in every draw.

Two numbers an axis are searched: the crossover ω_v of the velocity loop, K_v = ω_v J with J all that the
motor moves, and a corner that K_p and 1/T_i = K_p do not exceed; below it they are ω_v/4 (the symmetric
optimum at moderate damping, Kessler 1958). For each corner ω_v is the largest with max |S| ≤
``SENSITIVITY`` in every draw (Åström and Hägglund, Advanced PID Control, 2006: 1.4 to 2) and with the turns
about −1 of a stable loop; ``closed_loop`` asks for stability once more, exactly. Where a mode ends the
growth a notch there is tried. Of what is permitted the stiffest is taken with which a push on the load
leaves little more motion of the load than with the best (H₂ norm): a motor that is held too hard leaves the
load on its spring undamped (Zhang and Furusho, IEEE Trans. Ind. Electron. 47(3), 2000).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import control
import numpy as np
from scipy.linalg import LinAlgWarning

from invid.exchange.linear_plant import LinearPlant
from invid.numerics.arrays import Complex128, Float64
from invid.tuning.closed_loop import closed_loop
from invid.tuning.margins import DrawnPlants, held_modes
from invid.tuning.servo_loop import DriveTiming, Gains, Notch, controller_response

SENSITIVITY = 1.7
"""Largest |S| in the draws that a design sees."""
PROMISE = 2.0
"""Largest |S| that is promised of draws it has not seen."""
RATIO = 4.0
"""ω_v T_i, and ω_v/K_p."""
CORNERS = (0.25, 0.5, 1.0, 2.0, 4.0, math.inf)
"""Tried for K_p and 1/T_i, as shares of the lowest mode of a load with all motors held: near it a position
loop takes the phase that the load leaves, below and above it does not."""
LOAD_COST = 2.5
"""Empirical: how much more than at best a push may move the load, for the sake of a stiffer motor."""
WORTH = 1.15
"""Empirical: a notch that makes the loop faster by less is left out."""
SWEEPS = 2
"""Rounds over all axes: each is searched with the others as they are then."""
_STEPS = 60
_SLOWER = 0.7 ** np.arange(9)
_NOTCHES = ((0.005, 0.3), (0.01, 0.8), (0.05, 0.3), (0.1, 0.8))
"""Damping of zeros and poles that are tried."""


def gains_at(
    inertia: float, crossover: float, corner: float = math.inf, notches: tuple[Notch, ...] = ()
) -> Gains:
    """Gains for a crossover ω_v of the velocity loop, K_p and 1/T_i at most ``corner`` [rad/s]."""
    slow = min(crossover / RATIO, corner)
    return Gains(crossover * inertia, 1.0 / slow, slow, notches)


def own_inertias(plant: LinearPlant) -> Float64:
    """(M,) all that each motor moves as its commanded torque feels it, with what hangs on springs at it
    (extra modes)."""
    out = np.array([float(m.sum()) for m in plant.chains.masses])
    for number, added in enumerate(plant.laws.extra_masses):
        axis = int(np.searchsorted(plant.chains.motor_dofs, added.at, side="right")) - 1
        out[axis] += plant.mass[plant.chains.dofs + number, plant.chains.dofs + number]
    return out / plant.gain


def design_gains(
    drawn: DrawnPlants, nominal: LinearPlant, notches: int, noise_gain: Float64 | None = None
) -> tuple[Gains, ...]:
    """Gains of every axis with at most ``notches`` notches each.

    ``noise_gain`` (M,): most that a loop may make of its encoder's noise, rms torque per rms position.
    """
    bounds = np.full(len(nominal.motors), math.inf) if noise_gain is None else noise_gain
    inertia = own_inertias(nominal)
    loads = held_modes(nominal, range(len(nominal.motors)))
    slow = 0.005 * float(loads[0]) if loads.size else 1.0
    corners = [share * float(loads[0]) for share in CORNERS] if loads.size else [math.inf]
    gains = [gains_at(j, slow) for j in inertia]
    for _ in range(SWEEPS):
        for i in range(len(gains)):
            plant = drawn.behind_axis(i, gains)
            search = _AxisSearch(plant, drawn, float(inertia[i]), slow, float(bounds[i]))
            filters = search.notches(corners[0], notches)
            permitted = [g for corner in corners for g in search.permitted(corner, filters)]
            gains[i] = _stiffest(i, gains, permitted, nominal, drawn.timing)
    return tuple(gains)


def slower(gains: Gains, factor: float) -> Gains:
    """The same loop at ``factor`` times its speed."""
    return replace(
        gains,
        velocity_gain=gains.velocity_gain * factor,
        integral_time=gains.integral_time / factor,
        position_gain=gains.position_gain * factor,
    )


@dataclass(frozen=True, eq=False)
class _AxisSearch:
    """Loops of one axis on its ``plant`` (D, F) under the other axes' control, no slower than ``slow``
    [rad/s]; ``noise_gain`` as in ``design_gains``."""

    plant: Complex128
    drawn: DrawnPlants
    inertia: float
    slow: float
    noise_gain: float

    def notches(self, corner: float, most: int) -> tuple[Notch, ...]:
        """Notch filters that are worth their phase: each where the growth of the loop ends without it."""
        best, limit = self.fastest(corner, ())
        chosen: tuple[Notch, ...] = ()
        for _ in range(most):
            filters = [(*chosen, Notch(limit, zero, pole)) for zero, pole in _NOTCHES]
            speed, next_limit, notched = max(
                ((*self.fastest(corner, f), f) for f in filters), key=lambda tried: tried[0]
            )
            if speed < WORTH * best:
                break
            best, limit, chosen = speed, next_limit, notched
        return chosen

    def fastest(self, corner: float, filters: tuple[Notch, ...]) -> tuple[float, float]:
        """The fastest permitted crossover [rad/s], and where the next one fails [Hz]."""
        limit = 0.25 / self.drawn.timing.cycle
        for speed in np.geomspace(self.slow, 0.5 / self.drawn.timing.cycle, _STEPS)[::-1]:
            fails = self._fails(gains_at(self.inertia, float(speed), corner, filters))
            if fails is None:
                return float(speed), limit
            limit = fails
        return self.slow, limit

    def permitted(self, corner: float, filters: tuple[Notch, ...]) -> list[Gains]:
        """The fastest permitted loop and slower ones that are permitted, too."""
        best, _ = self.fastest(corner, filters)
        tried = [gains_at(self.inertia, best * float(f), corner, filters) for f in _SLOWER]
        slowest = gains_at(self.inertia, self.slow, corner, filters)
        return [*(g for g in tried if self._fails(g) is None), slowest]

    def _fails(self, gains: Gains) -> float | None:
        """Where these gains leave too little margin or turn wrongly [Hz]; ``None`` where they hold in all
        draws."""
        for rows in (slice(0, 1), slice(1, None)):  # one draw refuses most of what fails
            omega = self.drawn.omega[rows]
            own = controller_response(gains, self.drawn.timing, omega)
            seen = 1.0 + self.plant[rows] * own
            size = np.abs(seen)
            if size.min() < 1.0 / SENSITIVITY or not _is_stable(seen):
                return float(omega.flat[int(size.argmin())]) / (2 * np.pi)
            power = np.abs(own / seen) ** 2
            mean = np.trapezoid(power, omega, axis=1) * self.drawn.timing.cycle / np.pi
            if mean.max() > self.noise_gain**2:
                return float(omega.flat[int(power.argmax())]) / (2 * np.pi)
        return None


def _is_stable(loop: Complex128) -> bool:
    """Whether 1 + L (D, F) turns as that of a stable loop does (Nyquist): followed from high frequencies,
    where it is one, it ends with the phase that two integrators of the plant and the controller have at low
    ones, between −270° and 0; each pole to the right is a full turn more."""
    angle = np.unwrap(np.angle(loop), axis=1)
    start = angle[:, 0] - 2 * np.pi * np.round(angle[:, -1] / (2 * np.pi))
    return bool(((start > -1.6 * np.pi) & (start < 0.2 * np.pi)).all())


def _stiffest(
    axis: int, gains: Sequence[Gains], tried: Sequence[Gains], nominal: LinearPlant, timing: DriveTiming
) -> Gains:
    """The stiffest of the loops whose load is moved by a push little more than by the best for the load."""
    sizes = []
    for own in tried:
        loop = closed_loop(nominal, (*gains[:axis], own, *gains[axis + 1 :]), timing)
        if loop.is_stable:
            sizes.append((_h2(loop.load_compliance[axis, axis]), own))
    if not sizes:
        return gains[axis]
    best = min(size for size, _ in sizes)
    return max((g for size, g in sizes if size <= LOAD_COST * best), key=lambda g: g.as_pid()[0])


def _h2(system: control.StateSpace) -> float:
    """Rms of the response to a unit impulse."""
    with warnings.catch_warnings():  # of loops that hardly decay, which lose anyway
        warnings.simplefilter("ignore", LinAlgWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        spread = control.dlyap(system.A, system.B @ system.B.T)
    return math.sqrt(max(float((system.C @ spread @ system.C.T)[0, 0]), 0.0))
