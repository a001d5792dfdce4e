"""Figures of a rigid model beside a record: torque errors, a ladder of friction models, a simulation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from invid.model.document import Model
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.rigid_motion.analysis import Analysis
from invid.rigid_motion.load_friction import load_terms
from invid.rigid_motion.model import model_of
from invid.rigid_motion.regression import Design, Fit, fit_terms
from invid.rigid_motion.regressors import Regressor
from invid.rigid_motion.selection import judged_rows, root_mean_square
from invid.simulation.rigid import errors_of


def figures_of(a: Analysis, extended: Model) -> dict[str, Any]:
    """Entries for ``details`` of a diagnosis."""
    design, rows = a.design, judged_rows(a.design)
    train = design.train
    relative = {}
    for i, name in enumerate(a.recording.axes):
        mine = design.axis == i
        relative[name] = {
            "fit": _relative_error(a.final.residual, design.torque, train & mine),
            "held_out": _relative_error(a.final.held_out, design.torque, rows & mine),
            "fit_rms": root_mean_square(a.final.residual[train & mine]),
        }
    return {
        "relative_torque_error_percent": relative,
        "relative_torque_error_percent_all_axes": {
            "fit": _relative_error(a.final.residual, design.torque, train),
            "held_out": _relative_error(a.final.held_out, design.torque, rows),
        },
        "band_hz": [float(f) for f in a.band.rows_hz],
        "independent_rows": a.final.effective,
        "ladder": _friction_models(a),
        "not_shown": _axes_not_shown(a),
        "simulation": _simulation_figures(a, extended),
    }


def _relative_error(residual: Float64, torque: Float64, rows: np.typing.NDArray[np.bool_]) -> float:
    size = root_mean_square(torque[rows])
    return 100 * root_mean_square(residual[rows]) / size if size > 0 else 0.0


def _friction_models(a: Analysis) -> list[dict[str, Any]]:
    """Friction models of increasing size on every axis, whatever was selected, to compare with tables."""
    design = Design(a.motions, reversals=True)
    rows = judged_rows(design)
    train = design.train
    friction = {
        "viscous_friction",
        "coulomb_friction",
        "stribeck_friction",
        "asymmetric_friction",
        "torque_offset",
    }
    # As tables in the literature: without the sampling instant of the torque.
    others = [t for t in a.final.terms if t.cause not in friction and t.cause != "time_offset"]
    reductions = {t.axis for t in others if t.cause == "gravity"}
    count = a.recording.axis_count
    viscous = [Regressor("viscous_friction", i, ("coefficient",)) for i in range(count)]
    coulomb = [Regressor("coulomb_friction", i, ("torque",)) for i in range(count)]
    offset = [Regressor("torque_offset", i, ("torque",)) for i in range(count) if i not in reductions]
    models: list[tuple[str, list[Regressor]]] = [
        ("no friction", []),
        ("viscous", viscous + offset),
        ("coulomb + viscous", coulomb + viscous),
        ("coulomb + viscous + offset", coulomb + viscous + offset),
        ("selected", [t for t in a.final.terms if t.cause in friction]),
    ]
    table = []
    for name, terms in models:
        result: Fit = fit_terms(design, others + terms)
        parameters = {}
        for term in result.terms:
            value, std = result.of(term)
            label = f"{a.recording.axes[term.axis]}.{term.cause}"
            parameters[label] = {
                n: {"value": float(v), "std": float(s)}
                for n, v, s in zip(term.names, value, std, strict=True)
            }
        table.append(
            {
                "friction": name,
                "relative_error_percent": _relative_error(result.residual, design.torque, train),
                "held_out_percent": _relative_error(result.held_out, design.torque, rows),
                "fit_rms": root_mean_square(result.residual[train]),
                "held_out_rms": root_mean_square(result.held_out[rows]),
                "parameters": parameters,
            }
        )
    return table


def _axes_not_shown(a: Analysis) -> list[str]:
    missing = []
    for i, name in enumerate(a.recording.axes):
        if not a.reach.both_ways[i]:
            missing.append(f"{name}: asymmetric friction (the axis moves one way only)")
        if not a.recording.linear and a.reach.travel[i] <= 0.2:
            missing.append(f"{name}: gravity (the axis turns by less than 0.2 rad)")
        own = [t for t in load_terms(a.final, a.design) if t.axis == i and not t.exponent]
        if any(t.cause == "gravity" and i in (t.axis, t.other) for t in a.final.terms) and not own:
            missing.append(
                f"{name}: friction that depends on the load (its weight hardly varies over this motion, "
                "and such friction is then Coulomb friction)"
            )
        if i not in a.springs:
            missing.append(f"{name}: stiffness of the transmission (no resonance in the band)")
    return missing


def _simulation_figures(a: Analysis, extended: Model) -> list[dict[str, Any]]:
    """Errors of the simulated model beside the record, and those of the best linear model."""
    if budget.is_left_out("the model simulated over time"):
        return []
    found = errors_of(extended, a.recording)
    if not found:
        return []
    count = a.recording.axis_count
    linear = [t for t in a.final.terms if t.base or t.cause == "torque_delay"]
    linear += [Regressor("viscous_friction", i, ("coefficient",)) for i in range(count)]
    linear += [Regressor("torque_offset", i, ("torque",)) for i in range(count)]
    plain = model_of(replace(a, final=fit_terms(a.design, linear)))
    for entry, before in zip(found, errors_of(plain, a.recording), strict=True):
        entry["linear_model"] = {k: before[k] for k in ("position", "torque", "failed") if k in before}
    return found
