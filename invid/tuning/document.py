"""The tuning as a document: JSON, and a table of values with their units; ``axis_loop`` reads it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from operator import attrgetter
from typing import Any, NamedTuple

from invid.model.document import (
    csv_text,
    model_to_json,
    with_numbers,
)
from invid.tuning.axis_loop import FORMAT, FORMAT_VERSION
from invid.tuning.tune import Tuning


class Value(NamedTuple):
    """One number for a person: ``axis``, ``name``, ``before``, ``after``, ``unit``."""

    axis: str
    name: str
    before: float | None
    after: float | None
    unit: str


_OF_AXIS = (
    ("inertia", "inertia.value", "{inertia}"),
    ("motor inertia", "motor_inertia.value", "{inertia}"),
    ("antiresonance", "antiresonance_hz", "Hz"),
    ("resonance", "resonance_hz", "Hz"),
)
_OF_LOOP = (
    ("position gain", "gains.position_gain", "1/s"),
    ("velocity gain", "gains.velocity_gain", "{damping}"),
    ("integral time", "gains.integral_time", "s"),
)
_OF_NOTCH = (
    ("frequency", "frequency", "Hz"),
    ("zero damping", "zero_damping", ""),
    ("pole damping", "pole_damping", ""),
)
_FEEDFORWARD = (
    ("inertia feedforward", "feedforward.inertia", "{inertia}"),
    ("viscous feedforward", "feedforward.viscous", "{damping}"),
    ("dry friction feedforward", "feedforward.dry", "{torque}"),
    ("breakaway torque", "feedforward.breakaway", "{torque}"),
    ("constant feedforward", "feedforward.offset", "{torque}"),
    ("weight feedforward", "feedforward.weight", "{torque}"),
    ("weight feedforward angle", "feedforward.angle", "{angle}"),
)
_OF_SHAPER = (("shaper frequency", "frequency", "Hz"), ("shaper damping ratio", "damping", ""))


def values_of(tuning: Tuning) -> Iterator[Value]:
    """All values of all axes, in one order."""
    torque, angle, inertia = ("N", "m", "kg") if tuning.model.linear else ("N·m", "rad", "kg·m²")
    units = {"torque": torque, "angle": angle, "inertia": inertia, "damping": f"{torque}·s/{angle}"}
    for a in tuning.axes:
        rows = [(name, None, attrgetter(path)(a), unit) for name, path, unit in _OF_AXIS]
        rows += [(n, attrgetter(p)(a.before), attrgetter(p)(a.after), unit) for n, p, unit in _OF_LOOP]
        for k, notch in enumerate(a.after.gains.notches, 1):
            rows += [(f"notch {k} {n}", None, getattr(notch, key), unit) for n, key, unit in _OF_NOTCH]
        forward = [(n, attrgetter(p)(a.before), attrgetter(p)(a.after), unit) for n, p, unit in _FEEDFORWARD]
        rows += [row for row in forward if row[1] or row[2]]
        rows += [
            (n, None, getattr(a.after.shaper, p), u) for n, p, u in _OF_SHAPER if a.after.shaper is not None
        ]
        rows += [("free play", None, a.backlash, "{angle}")] if a.backlash else []
        yield from (Value(a.axis, *row[:3], row[3].format(**units)) for row in rows)


def tuning_table(tuning: Tuning) -> str:
    """CSV of ``values_of``."""
    return csv_text(Value._fields, values_of(tuning))


def tuning_to_json(tuning: Tuning) -> dict[str, Any]:
    """The ``invid-tuning`` document."""
    angle = "m" if tuning.model.linear else "rad"
    timing = tuning.settings.timing
    document = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "robot": tuning.model.robot,
        "units": {"angle": angle, "torque": "N" if tuning.model.linear else "N·m"},
        "law": "u = N(z) K_v (1 + T/(T_i (1 - 1/z))) (K_p (r - q) + dr/dt - v) + feedforward",
        "cycle_s": timing.cycle,
        "dead_cycles": timing.dead_cycles,
        "draws": tuning.settings.draws,
        "before": tuning.before_source,
        "axes": [asdict(a) for a in tuning.axes],
        "model": model_to_json(tuning.model),
        "remarks": list(tuning.remarks),
    }
    plain: dict[str, Any] = with_numbers(document)
    return plain
