"""What a file of another format does not hold of a model, in sentences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from xml.etree.ElementTree import Comment

import numpy as np
import scipy.linalg

from invid.exchange.linear_plant import LinearPlant
from invid.model.document import EffectTerm
from invid.numerics.arrays import Float64


def effect_losses(
    plant: LinearPlant, own: Callable[[EffectTerm], str | None] = lambda _term: None
) -> list[str]:
    """A sentence for each effect that the matrices do not hold.

    ``own`` says how the format holds such an effect in its own way ("stands as …"); ``None``: it does not.
    """
    lost = []
    for left in plant.nonlinear:
        way = None if left.reason else own(left.term)
        name = effect_name(left.term)
        lost.append(
            f"{name} {way}" if way else f"{name} is left out" + (f": {left.reason}" * bool(left.reason))
        )
    return lost


def effect_name(term: EffectTerm) -> str:
    """ "coulomb_friction on A1 mass 1 (torque 0.1 N·m)"."""
    place = " ".join(x for x in (term.axis, term.element, term.other_axis) if x)
    sizes = ", ".join(f"{k} {p.value:.4g} {p.unit or ''}".strip() for k, p in term.parameters.items())
    return f"{term.cause} on {place} ({sizes})"


def moved_modes(plant: LinearPlant, mass: Float64, stiffness: Float64) -> float:
    """Largest relative shift of a natural frequency with these matrices instead of the plant's."""
    there = np.sqrt(np.maximum(scipy.linalg.eigh(stiffness, mass, eigvals_only=True), 0.0))
    here = plant.modes
    elastic = here > 1e-6 * here[-1]
    shift = np.abs(there[elastic] / here[elastic] - 1.0)
    return float(shift.max(initial=0.0))


def loss_comment(losses: list[str]) -> Any:
    """The losses as an XML comment, which must not hold two hyphens in a row."""
    return Comment(" not in here as it is: " + "; ".join(losses).replace("--", "- -") + " ")
