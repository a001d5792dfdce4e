"""Names that drive tools give their channels, with the unit that the tool's own documents state.

Sources: recorder signal names of Elmo's Gold and Platinum lines as programs that talk to them list them
("Active Current [A]", "Position [cnt]", "Velocity [cnt/s]"); ODrive's object paths and their units (turns
since firmware 0.5.1); moteus' registers, in revolutions; EPOS Studio's recorder names its units in the file
and needs no row here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Named:
    """One kind of channel; ``demand``: what was asked for; ``None`` as quantity: never motion nor torque."""

    tool: str
    pattern: str
    quantity: str | None
    unit: str = ""
    demand: bool = False


_ELMO, _ODRIVE, _MOTEUS = "Elmo recorder", "ODrive", "moteus"
_ROWS = (
    Named(_ELMO, r"reactive current( \[a(mp)?\])?$", None),
    Named(_ELMO, r"active current( \[a(mp)?\])?$", "torque", "A"),
    Named(_ELMO, r"(total )?current command( \[a(mp)?\])?$", "torque", "A", demand=True),
    Named(_ELMO, r"position error( \[.*\])?$", None),
    Named(_ELMO, r"velocity error( \[.*\])?$", None),
    Named(_MOTEUS, r"(.*\.)?position$", "position", "rev"),
    Named(_MOTEUS, r"(.*\.)?abs_position$", None),
    Named(_MOTEUS, r"(.*\.)?velocity$", "velocity", "rev/s"),
    Named(_MOTEUS, r"(.*\.)?torque$", "torque", "N·m"),
    Named(_MOTEUS, r"(.*\.)?q_current(_a)?$", "torque", "A"),
    Named(_MOTEUS, r"(.*\.)?(d_current(_a)?|voltage|temperature|fault|mode|power|motor_temperature)$", None),
    Named(_ODRIVE, r".*\bpos_estimate_counts$", "position", "counts"),
    Named(_ODRIVE, r".*\bpos_estimate$", "position", "rev"),
    Named(_ODRIVE, r".*\bpos_(rel|abs)$", "position", "rev"),
    Named(_ODRIVE, r".*\bvel_estimate$", "velocity", "rev/s"),
    Named(_ODRIVE, r".*\bvel$", "velocity", "rev/s"),
    Named(_ODRIVE, r".*\biq_measured$", "torque", "A"),
    Named(_ODRIVE, r".*\biq_setpoint$", "torque", "A", demand=True),
    Named(_ODRIVE, r".*\bid_(measured|setpoint)$", None),
    Named(_ODRIVE, r".*\btorque_estimate$", "torque", "N·m"),
    Named(
        _ODRIVE,
        r".*\b(input_torque|torque_setpoint|effective_torque_setpoint)$",
        "torque",
        "N·m",
        demand=True,
    ),
)
_MARKS = {
    _ELMO: re.compile(r"(active current|total current command)( \[a(mp)?\])?$"),
    _MOTEUS: re.compile(r"(.*\.)?q_current(_a)?$"),
    _ODRIVE: re.compile(r".*\b(pos_estimate|vel_estimate|pos_vel_mapper\.\w+|iq_measured|iq_setpoint)$"),
}
"""A channel that only this tool names so: its other names are trusted where one of these is there."""


def tool_of(names: Iterable[str]) -> str | None:
    """The tool whose names these are; ``None`` where none is plain."""
    lowered = [n.strip().lower() for n in names]
    return next((t for t, mark in _MARKS.items() if any(mark.match(n) for n in lowered)), None)


def named_by(tool: str | None, name: str) -> Named | None:
    """What the tool means by the name."""
    lowered = name.strip().lower()
    return next((r for r in _ROWS if r.tool == tool and re.match(r.pattern, lowered)), None)
