"""Holds run by the master, and the rule that a P hold must satisfy.

With d whole cycles from sample to application and cycle T, a P gain K_R acts d+½ cycles late (the half
is the zero-order hold), which is negative damping of K_R·(d+½)·T. An undamped structure has nothing to
set against it but the viscous friction b of the held motor: stable if and only if K_R·(d+½)·T < b.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from invid.config import AxisConfig
from invid.errors import ConfigError

DELAY_CYCLES = 1
"""d: a sample taken at one SYNC is answered at the next."""

CATCHING_RATIO = 0.7
"""Damping ratio of the PD that follows a path or brings an axis back to rest."""
CENTRING_RATIO = 0.35
"""Damping ratio of the hold that keeps an excited axis in its place. Twice as much takes a third of the
torque limit and half the motion of the modes; runs begin where an axis drifts least. Empirical (case
study)."""
CENTRING_SHARE = 1.0 / 3.0
"""Its natural frequency as a share of the lowest excited line: far enough below to leave the excitation
nearly alone, fast enough to bring the axis back during a rest of a second or two, and stiff enough for
what is not known of a load. Empirical (case study, ``tests/machines/cells.py``)."""


@dataclass(frozen=True)
class Gains:
    """PD hold: torque = −stiffness·(x − x0) − damping·v."""

    stiffness: float
    damping: float


def require_stable_p(axis: str, stiffness: float, friction: float, cycle_s: float) -> None:
    """Raise ConfigError where a P hold would be unstable; says by how much."""
    needed = stiffness * (DELAY_CYCLES + 0.5) * cycle_s
    if needed >= friction:
        raise ConfigError(
            f"axis {axis}: a master P hold of {stiffness:g} is unstable: gain·(d+½)·cycle = {needed:.3g} is "
            f"not below the motor's viscous friction of {friction:.3g} (hold.damping); use mode 'drive' or "
            f"'master_pd', or a gain below {friction / ((DELAY_CYCLES + 0.5) * cycle_s):.3g}"
        )


def least_damping(stiffness: float, cycle_s: float) -> float:
    """D = 1.5·K_R·(d+1)·T, which holds an undamped structure (checked to K_R = 10000 at 1 kHz and 500 Hz)."""
    return 1.5 * stiffness * (DELAY_CYCLES + 1) * cycle_s


def master_hold(axis: AxisConfig, cycle_s: float) -> Gains | None:
    """Gains of an axis held by the master; ``None`` where the drive holds it."""
    hold = axis.hold
    if hold.mode == "drive":
        return None
    if hold.gain <= 0:
        raise ConfigError(
            f"axis {axis.name}: hold mode {hold.mode!r} needs a gain above zero, found {hold.gain:g}"
        )
    if hold.mode == "master_p":
        require_stable_p(axis.name, hold.gain, hold.damping or 0.0, cycle_s)
        return Gains(hold.gain, 0.0)
    damping = least_damping(hold.gain, cycle_s) if hold.damping is None else hold.damping
    return Gains(hold.gain, max(damping, least_damping(hold.gain, cycle_s)))


def centring(inertia: float, lowest_hz: float, cycle_s: float, ratio: float = CENTRING_RATIO) -> Gains:
    """Return a weak PD around the start for an excited axis: a free axis drifts away on the smallest
    offset.
    """
    omega = 2 * math.pi * lowest_hz * CENTRING_SHARE
    stiffness = inertia * omega**2
    damping = 2 * ratio * inertia * omega
    return Gains(stiffness, max(damping, least_damping(stiffness, cycle_s)))


def following(inertia: float, cycle_s: float) -> Gains:
    """PD that follows a slow path: 2 Hz, below the modes of most drives, damped. Empirical."""
    omega = 2 * math.pi * min(2.0, 0.02 / cycle_s)
    return Gains(inertia * omega**2, 2 * CATCHING_RATIO * inertia * omega)
