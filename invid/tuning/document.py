"""The tuning as a document: JSON, and a table of values with their units; ``axis_loop`` reads it."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

from invid.model.document import (
    effect_to_json,
    model_to_json,
)
from invid.tuning.axis_loop import FORMAT, FORMAT_VERSION, AxisLoop
from invid.tuning.tune import AxisTuning, Repair, Tuning
from invid.wording.statement import LANGUAGES, say


class Value(NamedTuple):
    """One number for a person: ``axis``, ``name``, ``before``, ``after``, ``unit``."""

    axis: str
    name: str
    before: float | None
    after: float | None
    unit: str


def values_of(tuning: Tuning) -> Iterator[Value]:
    """All values of all axes, in one order."""
    torque, angle = ("N", "m") if tuning.model.linear else ("N·m", "rad")
    for a in tuning.axes:

        def row(name: str, before: float | None, after: float | None, unit: str, axis: str = a.axis) -> Value:
            return Value(axis, name, before, after, unit)

        old, new = a.before, a.after
        yield row("inertia", None, a.total.value, a.total.unit or "")
        yield row("motor inertia", None, a.motor.value, a.motor.unit or "")
        yield row("antiresonance", None, a.antiresonance, "Hz")
        yield row("resonance", None, a.resonance, "Hz")
        yield row("position gain", old.gains.position_gain, new.gains.position_gain, "1/s")
        yield row("velocity gain", old.gains.velocity_gain, new.gains.velocity_gain, f"{torque}·s/{angle}")
        yield row("integral time", old.gains.integral_time, new.gains.integral_time, "s")
        for k, notch in enumerate(new.gains.notches, 1):
            yield row(f"notch {k} frequency", None, notch.frequency, "Hz")
            yield row(f"notch {k} zero damping", None, notch.zero_damping, "")
            yield row(f"notch {k} pole damping", None, notch.pole_damping, "")
        for name, key, unit in (
            ("inertia feedforward", "inertia", a.total.unit or ""),
            ("viscous feedforward", "viscous", f"{torque}·s/{angle}"),
            ("dry friction feedforward", "dry", torque),
            ("breakaway torque", "breakaway", torque),
            ("constant feedforward", "offset", torque),
            ("weight feedforward", "weight", torque),
            ("weight feedforward angle", "angle", angle),
        ):
            before, after = (float(getattr(side.feedforward, key)) for side in (old, new))
            if before or after:
                yield row(name, before, after, unit)
        if new.shaper is not None:
            yield row("shaper frequency", None, new.shaper.frequency, "Hz")
            yield row("shaper damping ratio", None, new.shaper.damping, "")
        if a.backlash:
            yield row("free play", None, a.backlash, angle)


def tuning_table(tuning: Tuning) -> str:
    """CSV of ``values_of``."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(Value._fields)
    for v in values_of(tuning):
        numbers = ("" if x is None or math.isinf(x) else f"{x:.9g}" for x in (v.before, v.after))
        writer.writerow([v.axis, v.name, *numbers, v.unit])
    return stream.getvalue()


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
        "axes": [_axis_to_json(a) for a in tuning.axes],
        "model": model_to_json(tuning.model),
        "repairs": [_repair_to_json(r, angle) for r in tuning.repairs],
        "remarks": list(tuning.remarks),
        "said": {lang: [say(s, lang) for s in tuning.statements] for lang in LANGUAGES},
    }
    clean: dict[str, Any] = finite(document)
    return clean


def finite(value: Any) -> Any:
    """Plain values with ``None`` for numbers that are none."""
    if isinstance(value, Mapping):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [finite(v) for v in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


def _axis_to_json(a: AxisTuning) -> dict[str, Any]:
    def spread(name: str) -> list[float]:
        sizes = [getattr(m, name) for m in a.moves_drawn]
        return [min(sizes), max(sizes)]

    def side(loop: AxisLoop, margins: Any, move: Any) -> dict[str, Any]:
        return {
            "gains": asdict(loop.gains),
            "feedforward": asdict(loop.feedforward),
            "shaper": None if loop.shaper is None else asdict(loop.shaper),
            "margins": asdict(margins),
            "move": asdict(move),
        }

    return {
        "axis": a.axis,
        "inertia": asdict(a.total),
        "motor_inertia": asdict(a.motor),
        "antiresonance_hz": a.antiresonance,
        "resonance_hz": a.resonance,
        "backlash": a.backlash,
        "rated_torque": a.rated_torque,
        "spread": {name: spread(name) for name in ("following", "at_load", "settling", "overshoot")},
        "before": side(a.before, a.margins_before, a.move_before),
        "after": side(a.after, a.margins_after, a.move_after),
    }


def _repair_to_json(r: Repair, unit: str) -> dict[str, Any]:
    return {
        "effect": effect_to_json(r.effect),
        "axis": r.axis,
        "following": {"with": r.following[0], "without": r.following[1]},
        "at_load": {"with": r.at_load[0], "without": r.at_load[1]},
        "sentence": repair_sentence(r, unit),
    }


def repair_sentence(r: Repair, unit: str) -> str:
    """ "without backlash on A1 the error of the load falls from 2.4 to 1.5 mrad"."""
    which = max(
        (("following error", r.following), ("error of the load", r.at_load)), key=lambda w: w[1][0] - w[1][1]
    )
    name, (now, then) = which
    if not all(map(math.isfinite, (now, then))):
        return f"what {r.effect.cause} on {r.effect.axis} costs cannot be told: the move does not end"
    place = f"{r.effect.cause} on {r.effect.axis}"
    if now - then < 0.01 * now:
        return f"without {place} the new values would do no better"
    return f"without {place} the {name} falls from {1e3 * now:.3g} to {1e3 * then:.3g} m{unit}"
