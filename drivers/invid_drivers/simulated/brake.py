"""What holds a motor whose drive gives no torque: its brake, and a prop under a load.

Both are dry friction at the motor, in the plant's table of commands.
"""

from __future__ import annotations

from collections.abc import Callable

from invid.numerics.arrays import Float64
from invid_drivers.simulated import kernel

Schedule = Callable[[int, Callable[[int], None]], None]
"""(delay [ns], callback with the time): call back once, the plant brought up to that time."""


class Brake:
    """Holding brake and prop of one motor.

    Parameters
    ----------
    command
        The motor's row of the plant's table.
    torque
        What the brake holds [N·m or N]; 0: there is none.
    delay_ns
        From the loss of the drive's torque to the brake's closing: the axis is free meanwhile.
    prop
        What carries the load until the drive is enabled for the first time [N·m or N]; 0: nothing does.
    """

    def __init__(
        self, command: Float64, schedule: Schedule, *, torque: float, delay_ns: int, prop: float
    ) -> None:
        self._command, self._schedule = command, schedule
        self._torque, self._delay_ns, self._prop = torque, delay_ns, prop
        self._stuck = False
        self._energised = False
        self._closed = True
        self._propped = prop > 0.0
        self._show()

    @property
    def stuck(self) -> bool:
        """True: it does not open."""
        return self._stuck

    @stuck.setter
    def stuck(self, stuck: bool) -> None:
        self._stuck = stuck
        self._show()

    def follow(self, energised: bool) -> None:
        """Open or close as the drive gives torque, or gives none any more."""
        if energised is self._energised:
            return
        self._energised = energised
        if energised:
            self._closed = self._propped = False
        elif self._delay_ns:
            self._schedule(self._delay_ns, self._close)
        else:
            self._closed = True
        self._show()

    def _close(self, _now_ns: int) -> None:
        self._closed = not self._energised
        self._show()

    def _show(self) -> None:
        held = self._torque if self._closed or self._stuck else 0.0
        self._command[kernel.BRAKE] = max(held, self._prop if self._propped else 0.0)
