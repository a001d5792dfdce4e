"""Velocity and position gains and notch filters: the fastest loops whose margins hold in every draw.

One number a axis is searched, the crossover ω_v of the velocity loop; the rest follows from it as in the
symmetric optimum at moderate damping (Kessler 1958): K_v = ω_v J, T_i = 4/ω_v, K_p = ω_v/4, J all that the
motor moves. ω_v grows from far below the lowest mode for as long as max |S| ≤ ``SENSITIVITY`` in every draw
(Åström and Hägglund, Advanced PID Control, 2006: 1.4 to 2); since a loop turns unstable only where |S| has no
bound, every permitted loop is stable, and ``closed_loop`` asks once more, exactly. Where a mode ends the
growth a notch there is tried. Of what is permitted, that ω_v is taken with which a push on the load leaves
the least motion of the load (H₂ norm): a motor that is held too hard leaves the load on its spring undamped
(Zhang and Furusho, IEEE Trans. Ind. Electron. 47(3), 2000).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import control
import numpy as np

from invid.exchange.linear_plant import LinearPlant
from invid.numerics.arrays import Complex128, Float64
from invid.tuning.margins import DrawnPlants, held_modes
from invid.tuning.servo_loop import DriveTiming, Gains, Notch, closed_loop, controller_response

SENSITIVITY = 1.7
"""Largest |S| in the draws that a design sees."""
PROMISE = 2.0
"""Largest |S| that is promised of draws it has not seen."""
RATIO = 4.0
"""ω_v T_i, and ω_v/K_p."""
CORNERS = (0.25, 0.5, 1.0, 2.0)
"""Tried for K_p and 1/T_i, as shares of the lowest mode of a load with all motors held: above it a position
loop takes the phase that the load leaves."""
LOAD_COST = 1.5
"""Empirical: how much more than at best a push may move the load, for the sake of a stiffer motor."""
WORTH = 1.15
"""Empirical: a notch that makes the loop faster by less is left out."""
SWEEPS = 2
"""Rounds over all axes: each is searched with the others as they are then."""
_STEPS = 90
_SLOWER = 0.7 ** np.arange(9)
_ZERO_DAMPING = (0.05, 0.15)
_POLE_DAMPING = (0.3, 0.6, 1.0)


def gains_at(
    inertia: float, crossover: float, corner: float = math.inf, notches: tuple[Notch, ...] = ()
) -> Gains:
    """Gains for a crossover ω_v of the velocity loop, K_p and 1/T_i at most ``corner`` [rad/s]."""
    slow = min(crossover / RATIO, corner)
    return Gains(crossover * inertia, 1.0 / slow, slow, notches)


def symmetric_optimum(inertia: float, timing: DriveTiming, delay: float, lag: float) -> Gains:
    """Hand rule: the symmetric optimum with a = 2 on a rigid inertia, ω_v = 1/(2 T_Σ), T_i = 4 T_Σ, and
    K_p = ω_v/4."""
    total = timing.total(delay, lag)
    return Gains(inertia / (2.0 * total), 4.0 * total, 1.0 / (8.0 * total))


def own_inertias(plant: LinearPlant) -> Float64:
    """(M,) all that each motor moves as its commanded torque feels it, with what hangs on springs at it
    (extra modes)."""
    out = np.array([float(m.sum()) for m in plant.chains.masses])
    for number, added in enumerate(plant.laws.extra_masses):
        axis = int(np.searchsorted(plant.chains.motor_dofs, added.at, side="right")) - 1
        out[axis] += plant.mass[plant.chains.dofs + number, plant.chains.dofs + number]
    return out / plant.gain


def design_gains(drawn: DrawnPlants, nominal: LinearPlant, notches: int) -> tuple[Gains, ...]:
    """Gains of every axis with at most ``notches`` notches each."""
    inertia = own_inertias(nominal)
    loads = held_modes(nominal, range(len(nominal.motors)))
    slow = 0.02 * float(loads[0]) if loads.size else 1.0
    corners = [share * float(loads[0]) for share in CORNERS] if loads.size else [math.inf]
    gains = [gains_at(j, slow) for j in inertia]
    for _ in range(SWEEPS):
        for i in range(len(gains)):
            plant = drawn.behind_axis(i, gains)
            fastest = [_fastest(plant, drawn, (float(inertia[i]), slow, c), notches) for c in corners]
            gains[i] = _stiffest(i, gains, fastest, nominal, drawn.timing)
    return tuple(gains)


def slower(gains: Gains, factor: float) -> Gains:
    """The same loop at ``factor`` times its speed."""
    return replace(
        gains,
        velocity_gain=gains.velocity_gain * factor,
        integral_time=gains.integral_time / factor,
        position_gain=gains.position_gain * factor,
    )


def _fastest(
    plant: Complex128, drawn: DrawnPlants, search: tuple[float, float, float], notches: int
) -> list[Gains]:
    """The fastest permitted loop, notch by notch, and slower ones; ``search``: inertia, slowest crossover and
    corner."""
    inertia, slow, corner = search
    speeds = np.geomspace(slow, 0.5 / drawn.timing.cycle, _STEPS)

    def permitted(filters: tuple[Notch, ...]) -> tuple[float, float]:
        """The fastest crossover up to which all margins hold, and where the next one fails [Hz]."""
        best = float(speeds[0])
        for speed in speeds:
            gains = gains_at(inertia, float(speed), corner, filters)
            size = np.abs(1.0 + plant * controller_response(gains, drawn.timing, drawn.omega))
            if size.min() < 1.0 / SENSITIVITY:
                return best, float(drawn.omega.flat[int(size.argmin())]) / (2 * np.pi)
            best = float(speed)
        return best, 0.25 / drawn.timing.cycle

    best, limit = permitted(())
    chosen: tuple[Notch, ...] = ()
    for _ in range(notches):
        filters = [(*chosen, Notch(limit, z, p)) for z in _ZERO_DAMPING for p in _POLE_DAMPING]
        tried = [(*permitted(f), f) for f in filters]
        speed, next_limit, notched = max(tried, key=lambda t: t[0])
        if speed < WORTH * best:
            break
        best, limit, chosen = speed, next_limit, notched
    return [gains_at(inertia, best * float(f), corner, chosen) for f in _SLOWER if best * f >= slow]


def _stiffest(
    axis: int, gains: Sequence[Gains], tried: list[list[Gains]], nominal: LinearPlant, timing: DriveTiming
) -> Gains:
    """The stiffest of the loops whose load is moved by a push little more than by the best for the load."""
    sizes = []
    for own in (g for row in tried for g in row):
        loop = closed_loop(nominal, (*gains[:axis], own, *gains[axis + 1 :]), timing)
        if loop.is_stable:
            sizes.append((_h2(loop.load_compliance[axis, axis]), own))
    if not sizes:
        return gains[axis]
    best = min(size for size, _ in sizes)
    return max((g for size, g in sizes if size <= LOAD_COST * best), key=lambda g: g.as_pid()[0])


def _h2(system: control.StateSpace) -> float:
    """Rms of the response to a unit impulse."""
    spread = control.dlyap(system.A, system.B @ system.B.T)
    return math.sqrt(max(float((system.C @ spread @ system.C.T)[0, 0]), 0.0))
