"""What the commands said beside what is true."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from machines.draw import Machine

SURE = 0.9


@dataclass
class Score:
    """One diagnosis judged."""

    right: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    """Named, not there, confidence below SURE."""
    wrong_sure: list[str] = field(default_factory=list)
    errors: dict[str, float] = field(default_factory=dict)
    """Relative error of each parameter of what was named rightly, of its cause's own size."""


def score(machine: Machine, diagnosis: dict[str, Any]) -> Score:
    """Causes by axis; parameters relative to their true values."""
    result = Score()
    for i, true in enumerate(machine.truth):
        mine = [f for f in diagnosis["findings"] if f["axis"] == f"J{i + 1}"]
        named = {f["cause"]: f for f in mine}
        accepted = _same(set(true), named)
        for cause, finding in named.items():
            label = f"{cause}@J{i + 1}"
            if cause in accepted:
                result.right.append(label)
                if cause in true:
                    known = {
                        k: v for k, v in true[cause].items() if k != "angle" or not machine.velocity_only
                    }
                    result.errors |= _errors(label, known, finding["parameters"])
            else:
                (result.wrong_sure if finding["confidence"] >= SURE else result.wrong).append(label)
        result.missed += [f"{c}@J{i + 1}" for c in _unsaid(set(true), set(named))]
    return result


def _same(true: set[str], named: dict[str, Any]) -> set[str]:
    """Causes that say the same about the machine as the true ones do."""
    accepted = set(true)
    if "asymmetric_friction" in true and "asymmetric_friction" not in named:
        accepted |= {"coulomb_friction", "viscous_friction", "torque_offset"}
    if "stribeck_friction" in true:
        accepted.add("coulomb_friction")
    if "gravity" in true and "gravity" not in named:
        accepted.add("torque_offset")
    return accepted


def _unsaid(true: set[str], named: set[str]) -> set[str]:
    unsaid = true - named
    if "asymmetric_friction" in unsaid and {"coulomb_friction", "torque_offset"} <= named:
        unsaid.discard("asymmetric_friction")
    return unsaid


def _errors(label: str, true: dict[str, float], found: dict[str, Any]) -> dict[str, float]:
    errors = {}
    sizes = [abs(v) for n, v in true.items() if not n.startswith("viscous")]
    for name, value in true.items():
        if name == "angle":
            away = (found[name]["value"] - value + math.pi) % (2 * math.pi) - math.pi
            errors[f"{label}.{name}"] = abs(away)
        elif name in found and value:
            scale = max(sizes) if name.startswith("coulomb_") else abs(value)
            errors[f"{label}.{name}"] = abs(found[name]["value"] - value) / scale
    return errors
