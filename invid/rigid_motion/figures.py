"""Figures of a rigid model beside a record: torque errors, and what its motion does not show."""

from __future__ import annotations

from typing import Any

import numpy as np

from invid.numerics.arrays import Float64
from invid.rigid_motion.analysis import Analysis
from invid.rigid_motion.fit import load_terms, missing_torque, unseen
from invid.rigid_motion.terms import LEAST_TRAVEL, LOADS


def figures_of(a: Analysis) -> dict[str, Any]:
    """Entries for ``details`` of a diagnosis."""
    rows, every, final = a.rows, a.rows.every, a.final
    told = unseen(every, final.terms, final.value, final.folds)
    parts = (
        ("fit", rows, final.residual, rows.train),
        ("held_out", every, missing_torque(rows, final), every.judged),
        ("held_out_with_one_force_while_standing", every, told, every.judged),
    )

    def errors(*axes: int) -> dict[str, float]:
        chosen = ((n, left, r.torque, at & np.isin(r.axis, axes)) for n, r, left, at in parts)
        return {n: _relative_error(left[at], torque[at]) for n, left, torque, at in chosen}

    return {
        "relative_torque_error_percent": {n: errors(i) for i, n in enumerate(a.recording.axes)},
        "relative_torque_error_percent_all_axes": errors(*range(rows.axes)),
        "not_shown": _axes_not_shown(a),
    }


def _relative_error(residual: Float64, torque: Float64) -> float:
    return 100 * float(np.linalg.norm(residual)) / max(float(np.linalg.norm(torque)), 1e-300)


def _axes_not_shown(a: Analysis) -> list[str]:
    missing = []
    for i, name in enumerate(a.recording.axes):
        carries = any(t.cause == "gravity" and i in (t.axis, t.other) for t in a.final.terms)
        varies = any(t.axis == i and t.law is LOADS[0] for t in load_terms(a.rows, a.final))
        for is_hidden, what in (
            (not a.reach.both_ways[i], "asymmetric friction (the axis moves one way only)"),
            (
                not a.recording.linear and a.reach.travel[i] <= LEAST_TRAVEL,
                "gravity (the axis turns by less than 0.2 rad)",
            ),
            (
                carries and not varies,
                "friction that depends on the load (its weight hardly varies over this motion, and such "
                "friction is then Coulomb friction)",
            ),
            (i not in a.springs, "stiffness of the transmission (no resonance in the band)"),
        ):
            missing += [f"{name}: {what}"] if is_hidden else []
    return missing
