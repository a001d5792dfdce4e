"""What a column means, by its name: rows of names that tools use, of words that people use, of units."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

from invid.recording.units import BY_CONSTANT, BY_TORQUE_CONSTANT, FACTORS, normal_unit


@dataclass(frozen=True)
class Meaning:
    """A column: its quantity (None: neither time, motion nor torque), unit where something says it, and
    place."""

    quantity: str | None
    unit: str = ""
    demanded: bool = False
    side: str = ""
    """Of the transmission, where the name says it: motor or load."""
    joint: str = ""
    rank: int = 0
    """Of several columns of one quantity the higher is taken."""


@dataclass(frozen=True)
class _Row:
    """Names of one tool, by pattern."""

    tool: str
    pattern: str
    meaning: Meaning


_NONE = Meaning(None)
_ELMO, _ODRIVE, _MOTEUS, _VESC, _HEBI, _RTDE = (
    "Elmo recorder",
    "ODrive",
    "moteus",
    "VESC Tool",
    "HEBI",
    "UR RTDE",
)
_MARKS = {
    # Names that only this tool uses: its other names are trusted where one of these is there.
    _ELMO: r"(active current|total current command)( \[a(mp)?\])?$",
    _MOTEUS: r"(.*\.)?q_current(_a)?$",
    _ODRIVE: r".*\b(pos_estimate|vel_estimate|pos_vel_mapper\.\w+|iq_measured|iq_setpoint)$",
    _VESC: r"(ms_today|tachometer_abs|amp_hours_used)$",
    _HEBI: r"(hwrxtime|motorposition|motorvelocity|effortcmd)$",
    _RTDE: r"(actual_qd?_\d|target_moment_\d)$",
}
_ROWS = tuple(
    _Row(tool, pattern, meaning)
    for tool, pattern, meaning in (
        # Recorder signal names of Elmo's Gold and Platinum lines, as programs that talk to them list them.
        (_ELMO, r"(reactive current|(position|velocity) error)( \[.*\])?$", _NONE),
        (_ELMO, r"active current( \[a(mp)?\])?$", Meaning("torque", "A")),
        (_ELMO, r"(total )?current command( \[a(mp)?\])?$", Meaning("torque", "A", demanded=True)),
        # moteus' registers, in revolutions.
        (_MOTEUS, r"(.*\.)?position$", Meaning("position", "rev")),
        (_MOTEUS, r"(.*\.)?velocity$", Meaning("velocity", "rev/s")),
        (_MOTEUS, r"(.*\.)?torque$", Meaning("torque", "N·m")),
        (_MOTEUS, r"(.*\.)?q_current(_a)?$", Meaning("torque", "A")),
        (_MOTEUS, r"(.*\.)?(abs_position|d_current(_a)?|voltage|.*temperature|fault|mode|power)$", _NONE),
        # ODrive's object paths; turns since firmware 0.5.1.
        (_ODRIVE, r".*\bpos_estimate_counts$", Meaning("position", "counts")),
        (_ODRIVE, r".*\b(pos_estimate|pos_rel|pos_abs)$", Meaning("position", "rev")),
        (_ODRIVE, r".*\b(vel_estimate|vel)$", Meaning("velocity", "rev/s")),
        (_ODRIVE, r".*\biq_measured$", Meaning("torque", "A")),
        (_ODRIVE, r".*\biq_setpoint$", Meaning("torque", "A", demanded=True)),
        (_ODRIVE, r".*\bid_(measured|setpoint)$", _NONE),
        (_ODRIVE, r".*\btorque_estimate$", Meaning("torque", "N·m")),
        (
            _ODRIVE,
            r".*\b(input_torque|(effective_)?torque_setpoint)$",
            Meaning("torque", "N·m", demanded=True),
        ),
        # VESC Tool's log of real-time data: position in degrees, speed in electrical turns a minute.
        (_VESC, r"ms_today$", Meaning("time", "ms")),
        (_VESC, r"encoder_position$", Meaning("position", "deg")),
        (_VESC, r"q_axis_current$", Meaning("torque", "A", rank=1)),
        (_VESC, r"current_motor$", Meaning("torque", "A")),
        (
            _VESC,
            r"(current_in|d_axis_current|erpm|tachometer.*|.*_voltage|duty_cycle|.*_used|.*charged.*)$",
            _NONE,
        ),
        # HEBI's log: effort is measured behind the spring, the motor's own torque is its current.
        (_HEBI, r"(hw(rx|tx)time|pctx?time|time)$", Meaning("time", "s")),
        (_HEBI, r"position$", Meaning("position", "rad", side="load")),
        (_HEBI, r"velocity$", Meaning("velocity", "rad/s", side="load")),
        (_HEBI, r"effort$", Meaning("torque", "N·m", side="load")),
        (_HEBI, r"effortcmd$", Meaning("torque", "N·m", demanded=True)),
        (_HEBI, r"motorposition$", Meaning("position", "rad", side="motor", rank=1)),
        (_HEBI, r"motorvelocity$", Meaning("velocity", "rad/s", side="motor")),
        (_HEBI, r"motor(winding)?current$", Meaning("torque", "A", side="motor", rank=1)),
        # Universal Robots' RTDE.
        (_RTDE, r"actual_q_\d$", Meaning("position", "rad")),
        (_RTDE, r"actual_qd_\d$", Meaning("velocity", "rad/s")),
        (_RTDE, r"actual_current_\d$", Meaning("torque", "A")),
        (_RTDE, r"target_moment_\d$", Meaning("torque", "N·m", demanded=True)),
    )
)
_OBJECTS = {
    0x6064: Meaning("position", "counts"), 0x606C: Meaning("velocity", "counts"),
    0x6077: Meaning("torque", "permille", rank=1), 0x6078: Meaning("torque", "permille"),
    0x6071: Meaning("torque", "permille", demanded=True),
    0x6074: Meaning("torque", "permille", demanded=True),
    0x607A: Meaning("position", "counts", demanded=True),
    0x6062: Meaning("position", "counts", demanded=True),
}  # fmt: skip
"""CiA 402; the objects of a node's further axes lie 0x800 higher each."""
WORDS = {
    "time": (
        r"(time|t|ts|timestamps?|zeit|zeitstempel|clock|stamps?|datetime|date|utc|epoch|elapsed|millis|micros|"
        r"tiempo|temps)$|.*(时间|時間|時刻|время)"
    ),
    "demand": (
        r"(ref|cmd|command|demand|target|setpoint|set|des|desired|soll|goal|consigne|action)|"
        r".*(给定|指令|目标|目標|设定)"
    ),
    "velocity": (
        r"(vel|speed|omega|dq|qd|qvel|rpm|vitesse)|.*(drehzahl|geschwindigkeit|速度|转速|回転数|속도|скорость)"
    ),
    "torque": (
        r"(tau|torque|trq|force|iq|current|effort|vir|couple|par$|corriente|courant|coppia)|"
        r".*(moment|strom|力矩|扭矩|转矩|电流|トルク|電流|토크|момент)"
    ),
    "position": (
        r"(pos|theta|angle|phi|enc|q|qm|joint|ángulo|lage(?!r))|.*(position|winkel|位置|角度|위치|각도|положение|угол)"
    ),
    "acceleration": r"(acc|accel|acceleration|beschleunigung|jerk|gyro|ax|ay|az|gx|gy|gz)|.*beschleunigung",
    "spectrum": r"(freq|frequency|frequenz|psd|spectrum|fft|coherence|magnitude|phase|mag|gain)",
    "error": r"(err|error|dev|deviation|schleppfehler|regelabweichung)$",
    "temperature": r"(temp|温)",
}
"""How words of a name begin; a compound's last part says what it is."""
_ASIDE = {"act", "actual", "meas", "measured", "msr", "joint", "joints", "state", "states", "data", "value"}
_LOWER = {"ref", "qg", "rel", "ff", "calc", "model", "ext", "external"}
_UPPER = {"act", "actual", "meas", "measured", "mot", "motor", "m", "qm", "msr", "feedback"}
_SIDES = {
    "motor": {"mot", "motor", "m", "rotor", "drive"},
    "load": {"load", "link", "abtrieb", "lastseitig", "arm", "se", "second", "secondary", "out"},
}
_VOLTS = {"voltage", "volt", "volts", "spannung", "pwm", "duty"}
_UNITS = {u for table in FACTORS.values() for u in table} | set(BY_CONSTANT)
EPISODE = re.compile(
    r"(.*[._/ ])?(episode|trial|trajectory|traj|segment|sweep|repetition|lap|run)([._ "
    r"]?(index|idx|id|number|no|nr))?$",
    re.IGNORECASE,
)
"""Columns that say to which of several records a row belongs."""


def tool_of(names: Iterable[str]) -> str:
    """The tool whose names these are; empty where none is plain."""
    lowered = [n.strip().lower() for n in names]
    return next((t for t, mark in _MARKS.items() if any(re.match(mark, n) for n in lowered)), "")


def meanings(names: Sequence[str], units: Mapping[str, str]) -> dict[str, Meaning]:
    """What each column means; ``units`` as the file states them."""
    tool = tool_of(names)
    own = {n: _meaning(n, units.get(n, ""), tool) for n in names}
    stems: dict[str, set[str]] = {}
    for name, m in own.items():
        if m.quantity in ("torque", "position", "velocity") and not _entry_of(name):
            stems.setdefault(_stem(name), set()).add("torque" if m.quantity == "torque" else "motion")
    whole = {stem for stem, kinds in stems.items() if stem and len(kinds) == 2}
    joints = whole if len(whole) > 1 else set()
    return {n: replace(m, joint=m.joint or _joint_of(n, joints)) for n, m in own.items()}


def _meaning(name: str, stated: str, tool: str) -> Meaning:
    if (found := re.fullmatch(r"n(\d+)_([6-9][0-9A-F]{3})", name)) is not None:
        axis, index = divmod(int(found[2], 16) - 0x6000, 0x800)
        return replace(_OBJECTS.get(index + 0x6000, _NONE), joint=f"node {found[1]} axis {axis + 1}")
    if (layout := re.fullmatch(r"n(\d+)_(position|velocity|torque|torque_demand)", name)) is not None:
        kind = layout[2].removesuffix("_demand")
        return Meaning(kind, normal_unit(stated), kind != layout[2], joint=layout[1])
    unit = normal_unit(stated or unit_in_name(name) or "")
    if set(words_of(name)) & _VOLTS and not tool:
        # What drives a motor where nothing is called torque; a supply's voltage goes one way only.
        return Meaning("torque", "V", demanded=True, rank=-6)
    row = next((r for r in _ROWS if r.tool == tool and re.match(r.pattern, name.strip().lower())), None)
    if row is not None:
        return row.meaning if not stated else replace(row.meaning, unit=unit)
    words = words_of(name)
    quantity = _quantity(words) or ("time" if unit in FACTORS["time"] else None)
    if quantity in FACTORS and unit not in FACTORS[quantity] and not _is_by_machine(unit, quantity):
        unit = ""
    rank = 1 if set(words) & _UPPER else -1 if set(words) & _LOWER else 0
    # A torque beats a current or a voltage, then the words.
    by_constant = quantity == "torque" and (unit in BY_TORQUE_CONSTANT or (not unit and is_current(name)))
    sides = {s for s, said in _SIDES.items() if said & set(words)}
    return Meaning(
        quantity, unit, _is_demand(words, name), next(iter(sides)) if len(sides) == 1 else "",
        rank=rank + (0 if by_constant else 3) - (5 if words in (["u"], ["y"]) else 0),
    )  # fmt: skip


def _is_by_machine(unit: str, quantity: str) -> bool:
    return unit in BY_CONSTANT and (unit == "counts") == (quantity != "torque") and quantity != "time"


def words_of(name: str) -> list[str]:
    """The words of a name in lower case, without what stands in brackets unless that says more."""
    entry = _entry_of(name)
    bare = re.sub(r"[\[(].*?[\])]", " ", name) + (f" {entry}" if re.search("[./]", entry) else "")
    bare = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])", " ", bare)  # ActPosition is two words
    return [w for w in re.split(r"[\W\d_]+", bare.lower()) if w]


def _quantity(words: Sequence[str]) -> str | None:
    if words and (
        re.match(WORDS["time"], words[-1]) or words[:2] == ["time", "of"] or words[0] in _TIME_FIRST
    ):
        return "time"
    if "from" in words and "time" in words:
        return None  # time_from_start of a trajectory's point
    if any(re.match(WORDS[aside], w) for aside in ("temperature", "error") for w in words):
        return None
    # The q-axis of a motor is its current, not a joint's coordinate.
    words = [w for w, after in zip_longest(words, words[1:]) if (w, after) != ("q", "axis")]
    for quantity in ("acceleration", "velocity", "torque", "position", "spectrum"):
        if any(re.match(WORDS[quantity], w) for w in words if len(w) > 1 or w == "q"):
            return quantity
    # As system identification calls input and output.
    return {"u": "torque", "y": "position"}.get(words[0]) if len(words) == 1 else None


_TIME_FIRST = ("ms", "us", "ns", "millis", "micros", "nanos")


def _is_demand(words: Sequence[str], name: str) -> bool:
    """Whether a name says what was asked for; ``tau_J_d`` and ``q_d`` are Franka's, ``output.effort``
    ROS's."""
    if any(re.match(WORDS["demand"], w) for w in words) or words[-1:] in (["d"], ["sp"]):
        return True
    return re.search(r"(^|[./])(output|command_interface)\.", name) is not None


def is_current(name: str) -> bool:
    """Whether a name is that of a current."""
    return any(
        re.match(r"(iq|currents?|amps?|courant|corriente)$|.*(strom|电流|電流)$", w) for w in words_of(name)
    )


def unit_in_name(name: str) -> str | None:
    """The unit that a name ends in, in brackets or without."""
    bracket = re.findall(r"[\[(]\s*([^\])]+?)\s*[\])]", name)
    candidates = [b for b in bracket if not b.isdigit() and b != _entry_of(name)]
    bare = re.sub(r"[\[(].*?[\])]", "", name).rstrip()
    if (per := re.search(r"_(deg|rad)_per_s$", bare.lower())) is not None:
        candidates.append(f"{per[1]}/s")
    elif (over := re.fullmatch(r"[^/]+/([^/]+)", bare)) is not None:
        candidates += [over[1]] if normal_unit(over[1]) in _UNITS else []
    else:
        is_time = any(re.match(WORDS["time"], w) for w in words_of(bare)[-1:])
        last = re.split(r"[_ ]", bare)[-1] if re.search(r"[_ ]", bare) or is_time else ""
        last = {"ticks": "counts", "nm": "N·m"}.get(last.lower(), last)
        # 'in' and 'min' are words before they are inches and minutes, and so is a capital after a blank.
        if normal_unit(last) in _UNITS - {"in", "min"} and ("_" in bare or len(last) > 1 or last.islower()):
            candidates.append(last)
        elif words_of(bare)[:1] and words_of(bare)[0] in _TIME_FIRST:
            candidates.append(words_of(bare)[0])
    return candidates[0] if candidates else None


def _entry_of(name: str) -> str:
    """The name or number of a list's entry, ``position[elbow]``; a unit stands in brackets too."""
    bracket = re.findall(r"\S\[([^\]\[]+)\]$", name)
    # A list of a topic's messages has no unit, whatever its joints are called; nor is one written [a].
    is_topic = re.match(r"/\S+\.\w+\[", name) is not None or bracket[:1] in (["a"], ["v"])
    return str(bracket[0]) if bracket and (is_topic or normal_unit(bracket[0]) not in _UNITS) else ""


def _joint_of(name: str, joints: set[str]) -> str:
    """What of a column's name tells its axis from others: a name in brackets, else a joint's and a number."""
    entry = _entry_of(name)
    if re.search("[./]", entry):  # state_interface.elbow/position
        return _stem(re.sub(r"^\w+_interface\.", "", entry)) or entry
    if entry:
        return entry
    digits = re.findall(r"(\d+)\D*$", name)
    return " ".join([*([_stem(name)] if _stem(name) in joints else []), *digits])


def _stem(name: str) -> str:
    """What a name says beside quantity, unit and source: ``elbow`` of ``elbow_pos_deg``."""
    aside = [WORDS[q] for q in ("velocity", "torque", "position", "demand")]
    words = [w for w in words_of(name) if not any(re.match(a, w) for a in aside) and w not in _ASIDE]
    return " ".join(w for w in words if normal_unit(w) not in _UNITS)
