"""Choose the one action that follows a run that ended while it moved.

An error of the command line names every way out; a person in front of the robot needs the one that comes
first, and none that contradicts what was already done.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from invid.errors import BusError, DriveError, InvidError
from invid.wording.sentence import sentence
from invid_service.words import ACTIONS, HALTS

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


_TOO_FAR = ("gentler", "page"), ("lower_amplitude", "experiments[].amplitude")
_ACTIONS: dict[str, tuple[tuple[str, str], ...]] = {
    "position_window": _TOO_FAR,
    "velocity": _TOO_FAR,
    "stands": (("free_axis", "machine"), ("as_planned", "page")),  # never less torque
    "torque": (("rated_torque", "rated_torque"),),
    "scales": (("scales", "drive"),),
    "signs": (("signs", "drive"),),
    "torque_scale": (("torque_scale", "drive"),),
    "disobeys": (("sign_turned", "drive"),),
    "torque_turned": (("sign_turned", "drive"),),
    "torque_hidden": (("torque_hidden", "drive"),),
    "no_torque": (("no_torque", "drive"),),
    "halted": (("clear_axis", "machine"),),
    "leapt": (("check_encoder", "machine"),),
    "hold_unstable": (("hold", "hold.mode"),),
    "not_held": (("see_load", "drive"),),
    "yields": (("see_signs", "drive"),),
    "computer_late": (("free_computer", "computer"),),
    "no_answer": (("check_cable", "machine"),),
    "drive_left": (("read_drive", "drive"),),
    "drive_fault": (("read_drive", "drive"),),
    "bus": (("check_bus", "machine"),),
    "asked": (("start_again", "page"),),
}
"""What stopped a motion -> code of the action, and where; the second of two after a run that had less than
the planned torque. Their words are ``ACTIONS``."""
STOPS = tuple(_ACTIONS)
"""Codes of what stops a motion; ``HALTS`` has words for each."""
_OF_AXIS = {"rated_torque": ("rated_torque_Nm", "rated_force_N"), "hold.mode": ("hold.mode", "hold.mode")}
"""Fields of an axis in the cell's config, of a rotary one and a linear one."""


def stopped_by(error: InvidError, run: Run) -> dict[str, Any] | None:
    """Return the facts of a run that ``error`` ended, ``None`` where nothing had moved yet."""
    if error.moment is None:
        return None
    moment = error.moment.to_json()
    axis = error.axis or moment["axis"]
    code = error.code or _kind(error)
    return {
        "code": code,
        "what": sentence(HALTS[code]) if code in HALTS else "",
        "phase": moment["phase"],
        "axis": axis,
        "reason": error.reason or str(error),
        "action": action_for(code, Run(run.mode, run.amplitude, run.linear, axis)),
        "trace": moment["trace"],
    }


def without_trace(phase: str, axis: str | None, reason: str) -> dict[str, Any]:
    """Return the facts of a run whose process could not tell: somebody has to look."""
    action = action_for("", Run("", "", linear=False, axis=axis))
    return {
        "code": "",
        "what": "",
        "phase": phase,
        "axis": axis,
        "reason": reason,
        "action": action,
        "trace": EMPTY,
    }


def action_for(code: str, run: Run) -> dict[str, str]:
    """Return the one action after a stop of this kind."""
    action, where = _ACTIONS.get(code, (("look", "machine"),))[-1 if run.lowered else 0]
    if where in _OF_AXIS:
        where = f"axes[{run.axis or ''}].{_OF_AXIS[where][run.linear]}"
    return {"code": action, "text": sentence(ACTIONS[action]), "where": where}


def _kind(error: InvidError) -> str:
    if isinstance(error, DriveError):
        return "drive_fault"
    return "bus" if isinstance(error, BusError) else ""
