"""Figures of a rigid machine as the literature's tables have them: symmetric friction beside the selected,
and the model simulated beside the record."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from invid.effects.registry import BY_CAUSE
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.model.document import Model
from invid.recording import Recording
from invid.rigid_motion.analysis import analyse
from invid.rigid_motion.fit import fit_terms
from invid.rigid_motion.rows import Rows
from invid.rigid_motion.terms import Base, Term
from invid.simulation.rigid import simulate_motion


def friction_models(recording: Recording) -> Iterator[dict[str, Any]]:
    """Each model's name, what it leaves in the rows fitted, and its value by "axis.term"; selected last."""
    a = analyse(recording)
    design = Rows(a.rows.motions, reversals=True)
    friction = [
        t for t in a.final.terms if not t.is_base and BY_CAUSE[t.cause].family in ("friction", "constant")
    ]
    # As tables in the literature: without the sampling instant of the torque.
    others = [t for t in a.final.terms if t not in friction and t.law is not Base.TIME_OFFSET]
    falling = {t.axis for t in others if t.cause == "gravity"}
    axes = range(recording.axis_count)
    viscous, coulomb = ([Term(part, i) for i in axes] for part in (Part.VISCOUS, Part.DRY))
    offset = [Term(Part.OFFSET, i) for i in axes if i not in falling]
    for name, terms in (
        ("coulomb + viscous + offset", coulomb + viscous + offset),
        ("selected", friction),
    ):
        fit = fit_terms(design, others + terms)
        left = fit.residual[design.train]
        yield {
            "friction": name,
            "fit_rms": float(np.sqrt(np.mean(left**2))),
            "parameters": {
                f"{recording.axes[t.axis]}.{t.cause}": float(fit.of(t)[0][0])
                for t in fit.terms
                if len(t.low) == 1
            },
        }


def simulation_error(model: Model, recording: Recording, key: str, quantity: str) -> tuple[float, float]:
    """Rms error of the first axis' ``quantity`` in one experiment simulated, and that over its size [%]."""
    one = replace(recording, experiments=tuple(e for e in recording.experiments if e.key == key))
    (told,), (said,) = (
        [getattr(e, quantity)[:, 0] for e in r.experiments] for r in (one, simulate_motion(model, one))
    )
    rms = float(np.sqrt(np.mean((said - told) ** 2)))
    size = told if quantity == "torque" else told - told.mean()
    return rms, 100 * rms / float(np.sqrt(np.mean(size**2)))
