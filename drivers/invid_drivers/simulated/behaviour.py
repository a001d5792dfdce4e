"""Where simulated drives that all follow CiA 402 differ from each other."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Behaviour:
    """What one drive does its own way; the defaults are the kindest."""

    gains: tuple[float, float]
    """Stiffness and damping of its position loop [N·m/rad, N·m·s/rad, or N/m, N·s/m]."""
    cycle_s: float
    """Of the bus: it interpolates targets over so long [s]."""
    delay_cycles: int = 0
    """From a command to its torque."""
    lag_cycles: int = 0
    """From a torque to 0x6077 showing it."""
    limits_in_torque_mode: bool = True
    """Whether 0x6072, 0x607D and 0x607F count in the torque modes too; in position mode and on ramps they
    always do."""
    enable_ns: int = 0
    """From the command to enable to torque: the motor is magnetised, a relay closes."""
    mode_change_ns: int = 0
    """From 0x6060 to the new mode acting; the old one acts meanwhile."""
    mode_display_ns: int = 0
    """From the mode acting to 0x6061 showing it."""
    mode_shown_enabled: bool = False
    """Whether 0x6061 is 0 until the drive is enabled."""
    mode_from_switched_on: bool = False
    """Whether 0x6060 is only taken in switched on and above."""
    sync_timeout_ns: int = 0
    """Longest gap between two SYNCs in a cyclic mode before error 0x8700; 0: any."""
    ramp_counts: float = 1.0
    """Counts/s² in one unit of 0x6084 and 0x6085."""
    own_ramp: int = 0
    """Ramp of a drive that lacks 0x6084 or 0x6085, in their unit."""
