"""Units that logs come in, as factors to SI; what needs a constant of the machine says so."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

from invid.errors import InputError

Quantity = Literal["time", "position", "velocity", "torque"]

_TURN = 2.0 * math.pi
FACTORS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "position": {
        "rad": 1.0,
        "mrad": 1e-3,
        "deg": math.pi / 180,
        "rev": _TURN,
        "m": 1.0,
        "mm": 1e-3,
        "um": 1e-6,
        "in": 0.0254,
    },
    "velocity": {
        "rad/s": 1.0,
        "deg/s": math.pi / 180,
        "rpm": _TURN / 60,
        "rev/s": _TURN,
        "Hz": _TURN,
        "m/s": 1.0,
        "mm/s": 1e-3,
        "mm/min": 1e-3 / 60,
        "um/s": 1e-6,
    },
    "torque": {
        "N·m": 1.0,
        "mN·m": 1e-3,
        "N·cm": 1e-2,
        "N·mm": 1e-3,
        "kN·m": 1e3,
        "N": 1.0,
        "mN": 1e-3,
        "kN": 1e3,
    },
}
LINEAR = {
    "position": {"m", "mm", "um", "in"},
    "velocity": {"m/s", "mm/s", "mm/min", "um/s"},
    "torque": {"N", "mN", "kN"},
}
"""Units of axes in metres and newtons; the others of these quantities are rotary."""

BY_CONSTANT: dict[str, tuple[str, float]] = {
    "counts": ("per_count", 1.0), "A": ("torque_constant", 1.0), "mA": ("torque_constant", 1e-3),
    "V": ("torque_constant", 1.0), "%": ("rated_torque", 0.01), "permille": ("rated_torque", 0.001),
}  # fmt: skip
"""Units that do not say whether an axis is rotary or linear: a constant of the machine, times this, gives
them their size. But for counts they are units of torque alone."""
BY_TORQUE_CONSTANT = frozenset(unit for unit, (name, _) in BY_CONSTANT.items() if name == "torque_constant")

_SPELLINGS = {
    "nm": "N·m", "n*m": "N·m", "n.m": "N·m", "n m": "N·m", "n-m": "N·m", "newtonmeter": "N·m",
    "newton meter": "N·m", "newton meters": "N·m", "newton-meter": "N·m", "newton metre": "N·m",
    "mnm": "mN·m", "ncm": "N·cm", "nmm": "N·mm", "knm": "kN·m",
    "µs": "us", "μs": "us", "usec": "us", "sec": "s", "second": "s", "seconds": "s", "msec": "ms",
    "millis": "ms", "milliseconds": "ms", "micros": "us", "microseconds": "us", "秒": "s", "毫秒": "ms",
    "degree": "deg", "degrees": "deg", "°": "deg", "°/s": "deg/s", "deg_per_s": "deg/s",
    "1/min": "rpm", "min-1": "rpm", "u/min": "rpm", "radian": "rad", "radians": "rad", "rad_per_s": "rad/s",
    "grad": "deg", "grad/s": "deg/s", "度": "deg", "弧度": "rad", "r/min": "rpm", "转/分": "rpm",
    "µm": "um", "μm": "um", "ampere": "A", "a": "A", "volt": "V", "v": "V",
    "percent": "%", "per mille": "permille", "‰": "permille", "0.1%": "permille", "per_mille": "permille",
    "count": "counts", "inc": "counts", "cnt": "counts", "qc": "counts",
    "cnt/s": "counts", "cnt/sec": "counts", "inc/s": "counts", "counts/s": "counts", "ma": "mA",
    "turn": "rev", "turn/s": "rev/s", "turns/s": "rev/s", "turns": "rev",
}  # fmt: skip


def normal_unit(text: str) -> str:
    """The unit's name in this module; unknown ones come back stripped, unchanged."""
    unit = text.strip()
    for dot in ("⋅", "•"):
        unit = unit.replace(dot, "·")
    if any(unit in table for table in FACTORS.values()):
        return unit
    lowered = unit.lower().replace("·", "")
    if lowered in _SPELLINGS:
        return _SPELLINGS[lowered]
    return lowered if any(lowered in table for table in FACTORS.values()) else unit


def factor(quantity: Quantity, unit: str, constants: Mapping[str, float | None], where: str) -> float:
    """SI value of one ``unit``; InputError names the one of the machine's ``constants`` that is missing."""
    name, known = normal_unit(unit), {**FACTORS[quantity], "raw": 1.0}
    fitting = [u for u in BY_CONSTANT if quantity == "torque" or (u == "counts" and quantity != "time")]
    if name in known:
        return known[name]
    if name not in fitting:
        shown = ", ".join([*known, *fitting])
        raise InputError(f"{where}: unit {unit!r} is no unit of {quantity}; known are {shown}")
    constant, size = BY_CONSTANT[name]
    value = constants.get(constant)
    if value is None:
        raise InputError(f"{where}: unit {unit!r} needs {constant!r} beside it in the map")
    return size * value
