"""Figures of a rigid model beside a record: torque errors, and what its motion does not show."""

from __future__ import annotations

from typing import Any

import numpy as np

from invid.numerics.arrays import Bool, Float64
from invid.rigid_motion.analysis import Analysis
from invid.rigid_motion.fit import load_terms
from invid.rigid_motion.rows import Rows
from invid.rigid_motion.terms import LEAST_TRAVEL, LOADS


def figures_of(a: Analysis) -> dict[str, Any]:
    """Entries for ``details`` of a diagnosis."""
    rows = a.rows

    def errors(mine: Bool) -> dict[str, float]:
        parts = (("fit", a.final.residual, rows.train), ("held_out", a.final.held_out, rows.judged))
        return {n: _relative_error(left[at & mine], rows.torque[at & mine]) for n, left, at in parts}

    whole = Rows([m.whole() for m in rows.motions])
    left = whole.torque - whole.matrix(a.final.terms) @ a.final.value
    every = {
        name: _relative_error(
            left[whole.judged & (whole.axis == i)], whole.torque[whole.judged & (whole.axis == i)]
        )
        for i, name in enumerate(a.recording.axes)
    }
    return {
        "relative_torque_error_percent_every_row": every,
        "relative_torque_error_percent": {n: errors(rows.axis == i) for i, n in enumerate(a.recording.axes)},
        "relative_torque_error_percent_all_axes": errors(rows.axis >= 0),
        "not_shown": _axes_not_shown(a),
    }


def _relative_error(residual: Float64, torque: Float64) -> float:
    size = float(np.linalg.norm(torque))
    return 100 * float(np.linalg.norm(residual)) / size if size > 0 else 0.0


def _axes_not_shown(a: Analysis) -> list[str]:
    missing = []
    for i, name in enumerate(a.recording.axes):
        if not a.reach.both_ways[i]:
            missing.append(f"{name}: asymmetric friction (the axis moves one way only)")
        if not a.recording.linear and a.reach.travel[i] <= LEAST_TRAVEL:
            missing.append(f"{name}: gravity (the axis turns by less than 0.2 rad)")
        own = [t for t in load_terms(a.rows, a.final) if t.axis == i and t.law is LOADS[0]]
        if any(t.cause == "gravity" and i in (t.axis, t.other) for t in a.final.terms) and not own:
            missing.append(
                f"{name}: friction that depends on the load (its weight hardly varies over this motion, "
                "and such friction is then Coulomb friction)"
            )
        if i not in a.springs:
            missing.append(f"{name}: stiffness of the transmission (no resonance in the band)")
    return missing
