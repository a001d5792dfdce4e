"""Figures of a rigid model beside a record: torque errors, a ladder of friction models, a simulation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from invid.effects.registry import BY_CAUSE
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.model.document import Model
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.rigid_motion.analysis import Analysis
from invid.rigid_motion.fit import fit_terms, load_terms
from invid.rigid_motion.model import model_of
from invid.rigid_motion.rows import Rows
from invid.rigid_motion.terms import LEAST_TRAVEL, LOADS, Base, Term
from invid.simulation.rigid import errors_of


def figures_of(a: Analysis, extended: Model) -> dict[str, Any]:
    """Entries for ``details`` of a diagnosis."""
    design, rows = a.rows, a.rows.judged
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


def root_mean_square(values: Float64) -> float:
    """Root mean square; 0 of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _relative_error(residual: Float64, torque: Float64, rows: np.typing.NDArray[np.bool_]) -> float:
    size = root_mean_square(torque[rows])
    return 100 * root_mean_square(residual[rows]) / size if size > 0 else 0.0


def _friction_models(a: Analysis) -> list[dict[str, Any]]:
    """Friction models of increasing size on every axis, whatever was selected, to compare with tables."""
    design = Rows(a.rows.motions, reversals=True)
    rows, train = design.judged, design.train
    axes, found = range(a.recording.axis_count), [t for t in a.final.terms if not t.is_base]
    friction = [t for t in found if BY_CAUSE[t.cause].family in ("friction", "constant")]
    # As tables in the literature: without the sampling instant of the torque.
    others = [t for t in a.final.terms if t not in friction and t.law is not Base.TIME_OFFSET]
    falling = {t.axis for t in others if t.cause == "gravity"}
    viscous, coulomb = ([Term(part, i) for i in axes] for part in (Part.VISCOUS, Part.DRY))
    offset = [Term(Part.OFFSET, i) for i in axes if i not in falling]
    models: list[tuple[str, list[Term]]] = [
        ("no friction", []),
        ("viscous", viscous + offset),
        ("coulomb + viscous", coulomb + viscous),
        ("coulomb + viscous + offset", coulomb + viscous + offset),
        ("selected", friction),
    ]
    table = []
    for name, terms in models:
        result = fit_terms(design, others + terms)
        parameters = {}
        for term in result.terms:
            value, std = result.of(term)
            label = f"{a.recording.axes[term.axis]}.{term.cause}"
            parameters[label] = {
                n: {"value": float(v), "std": float(s)}
                for n, v, s in zip(_names(term), value, std, strict=True)
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


def _names(term: Term) -> tuple[str, ...]:
    """Names of a term's coefficients."""
    match term.law:
        case Base.INERTIA:
            return ("mass",)
        case Base.CONFIGURATION:
            return ("cosine", "sine")
        case Base.GROUND_SPRING:
            return ("stiffness",)
        case Base():
            return (term.law.value,)
        case Part():
            return (BY_CAUSE[term.cause].main,)
        case _:
            return tuple(f"part {k + 1}" for k in range(len(term.low)))


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


def _simulation_figures(a: Analysis, extended: Model) -> list[dict[str, Any]]:
    """Errors of the simulated model beside the record, and those of the best linear model."""
    if budget.is_left_out("the model simulated over time"):
        return []
    found = errors_of(extended, a.recording)
    if not found:
        return []
    count = a.recording.axis_count
    linear = [t for t in a.final.terms if isinstance(t.law, Base)]
    linear += [Term(part, i) for part in (Part.VISCOUS, Part.OFFSET) for i in range(count)]
    plain = model_of(replace(a, final=fit_terms(a.rows, linear)))
    for entry, before in zip(found, errors_of(plain, a.recording), strict=True):
        entry["linear_model"] = {k: before[k] for k in ("position", "torque", "failed") if k in before}
    return found
