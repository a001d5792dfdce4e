"""Choose the one action that follows a run that ended while it moved.

An error of the command line names every way out; a person in front of the robot needs the one that comes
first, and none that contradicts what was already done.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from invid.errors import BusError, DriveError, InvidError

EMPTY: dict[str, Any] = {"time_s": [], "position": {}, "torque": {}}


@dataclass(frozen=True)
class Run:
    """Facts of the run that the action depends on, beside the stop itself."""

    mode: str
    amplitude: str
    """planned or gentler"""
    linear: bool
    axis: str | None

    @property
    def lowered(self) -> bool:
        """True where it had less than the planned torque."""
        return self.mode == "test" or self.amplitude == "gentler"

    def key(self, name: str) -> str:
        """Return the path of a field of the axis in the cell's config."""
        return f"axes[{self.axis}].{name}" if self.axis else f"axes[].{name}"


def _action(code: str, text: str, where: str) -> dict[str, str]:
    return {"code": code, "text": text, "where": where}


def _less(run: Run) -> dict[str, str]:
    """Return the action after it moved too far or too fast: less torque."""
    if run.lowered:
        return _action(
            "lower_amplitude",
            "It went too far with less than the planned torque already: halve the amplitude of the "
            "experiments in the cell's config, then start again.",
            "experiments[].amplitude",
        )
    return _action("gentler", "Start again with “gentler”: half of the torque, half of the motion.", "page")


def _stands(run: Run) -> dict[str, str]:
    """Return the action where nothing moved under the torque that was tried: not less torque."""
    name = run.axis or "the axis"
    if run.lowered:
        return _action(
            "as_planned",
            f"Start again as planned: with the small torques of this run friction alone may hold {name}.",
            "page",
        )
    return _action(
        "free_axis",
        f"See that the brake of {name} opens, and turn {name} by hand with its drive off. If it turns "
        f"freely, friction is above what it is shaken with: raise {run.key('limits.' + _torque(run))} in the "
        "cell's config, as far as motor and gear allow.",
        "machine",
    )


def _torque(run: Run) -> str:
    return "force_N" if run.linear else "torque_Nm"


def _inertia(run: Run) -> str:
    return "mass_kg" if run.linear else "inertia_kgm2"


_SIGN_TURNED = _action(
    "sign_turned",
    "Find out what has turned in motor, encoder or drive before anything moves again.",
    "drive",
)
"""Where torque and motion agreed and no longer do."""
_ACTIONS: dict[str, Callable[[Run], dict[str, str]]] = {
    "position_window": _less,
    "velocity": _less,
    "stands": _stands,
    "torque": lambda run: _action(
        "rated_torque",
        f"Compare {run.key('rated_' + _torque(run))} in the cell's config with the motor's plate: the drive "
        "gives more torque than it is asked for.",
        run.key("rated_" + _torque(run)),
    ),
    "scales": lambda run: _action(
        "scales",
        "Compare the drive's rated torque (0x6076) with the motor's plate and its counts of a turn (0x608F, "
        f"0x6091) with encoder and gear. If both are right, correct {run.key(_inertia(run))}.",
        "drive",
    ),
    "signs": lambda run: _action(
        "signs",
        "Torque and encoder disagree in sign: have two motor phases swapped, or the encoder inverted in the "
        "drive.",
        "drive",
    ),
    "torque_scale": lambda run: _action(
        "torque_scale",
        "Compare the drive's rated torque (0x6076) and rated current (0x6075) with the motor's plate: one of "
        "them is wrong.",
        "drive",
    ),
    "disobeys": lambda run: _SIGN_TURNED,
    "torque_turned": lambda run: _SIGN_TURNED,
    "torque_hidden": lambda run: _action(
        "torque_hidden",
        "Let the drive show its torque in 0x6077: without it nothing can be identified.",
        "drive",
    ),
    "no_torque": lambda run: _action(
        "no_torque", "The drive gives no torque: look at safe torque off and at its current limit.", "drive"
    ),
    "halted": lambda run: _action(
        "clear_axis",
        f"See whether {run.axis or 'the axis'} has hit something, its brake has closed or its encoder hangs.",
        "machine",
    ),
    "leapt": lambda run: _action(
        "check_encoder",
        f"Look at the encoder of {run.axis or 'the axis'}, its cable and its shield.",
        "machine",
    ),
    "hold_unstable": lambda run: _action(
        "hold", "Set the hold of the held axes to “drive” in the cell's config.", run.key("hold.mode")
    ),
    "not_held": lambda run: _action(
        "see_load",
        f"See what moves {run.axis or 'the axis'} at rest: a load beyond the drive's torque limit, or a "
        "wrong sign in the drive.",
        "drive",
    ),
    "yields": lambda run: _action(
        "see_signs",
        f"See whether somebody pushed {run.axis or 'the axis'}; else compare the signs of torque and encoder "
        "in its drive.",
        "drive",
    ),
    "computer_late": lambda run: _action(
        "free_computer", "Stop other programs on the service's computer, then start again.", "computer"
    ),
    "no_answer": lambda run: _action(
        "check_cable", f"Check the cable and the supply of {run.axis or 'the drive'}.", "machine"
    ),
    "drive_left": lambda run: _action(
        "read_drive", f"Read the error on the drive of {run.axis or 'the axis'} and reset it there.", "drive"
    ),
    "drive_fault": lambda run: _action(
        "read_drive", f"Read the error on the drive of {run.axis or 'the axis'} and reset it there.", "drive"
    ),
    "bus": lambda run: _action(
        "check_bus", "Check the CAN adapter, its cable and its termination.", "machine"
    ),
    "asked": lambda run: _action("start_again", "Start again when the cell is clear.", "page"),
}
STOPS = tuple(_ACTIONS)
"""Codes of what stops a motion; the page has words for each."""
_OTHERWISE = _action("look", "Look at the robot and clear what is named above, then start again.", "machine")


def stopped_by(error: InvidError, run: Run) -> dict[str, Any] | None:
    """Return the facts of a run that ``error`` ended, ``None`` where nothing had moved yet."""
    if error.moment is None:
        return None
    moment = error.moment.to_json()
    axis = error.axis or moment["axis"]
    code = error.code or _kind(error)
    return {
        "code": code,
        "phase": moment["phase"],
        "axis": axis,
        "reason": error.reason or str(error),
        "action": action_for(code, Run(run.mode, run.amplitude, run.linear, axis)),
        "trace": moment["trace"],
    }


def without_trace(phase: str, axis: str | None, reason: str) -> dict[str, Any]:
    """Return the facts of a run whose process could not tell: somebody has to look."""
    return {
        "code": "",
        "phase": phase,
        "axis": axis,
        "reason": reason,
        "action": _OTHERWISE,
        "trace": EMPTY,
    }


def action_for(code: str, run: Run) -> Mapping[str, str]:
    """Return the one action after a stop of this kind."""
    made = _ACTIONS.get(code)
    return _OTHERWISE if made is None else made(run)


def _kind(error: InvidError) -> str:
    if isinstance(error, DriveError):
        return "drive_fault"
    return "bus" if isinstance(error, BusError) else ""
