"""Effects of a model that is given to the diagnosis: part of the fit, not to be found again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from invid.effects.effect import Effect
from invid.effects.registry import BY_CAUSE, LARGE_MOTION, effect_of, effects
from invid.errors import ModelError
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm, Model
from invid.model.parameters import ChainStructure
from invid.model.place import Place
from invid.numerics.arrays import Float64, frozen_float

NORMAL_FRICTION = ("coulomb_friction", "viscous_friction")
"""Friction that an identification fits along (``invid.identification.model_facts``)."""


def effects_in_model(model: Model) -> tuple[EffectTerm, ...]:
    """Effects that count as part of the model: all but the friction that an identification fitted along.

    ``invid identify`` needs friction to get the linear parameters right; whether it is there, and of which
    kind, is for the diagnosis to decide.
    """
    if model.fit.get("joint_with_effects"):
        return model.effects
    friction = model.fit.get("friction")
    if not isinstance(friction, Mapping):
        return model.effects
    return tuple(e for e in model.effects if e.cause not in NORMAL_FRICTION)


def fitted_friction(model: Model, structure: ChainStructure) -> Candidate:
    """The friction that an identification fitted along, as effects at their places; none for other models."""
    kept = {id(e) for e in effects_in_model(model)}
    out = Candidate()
    for term in model.effects:
        if id(term) not in kept and min(term.parameters[n].value for n in term.parameters) > 0.0:
            out = out.plus(
                PlacedEffect(BY_CAUSE[term.cause], effect_place(term, structure)), effect_vector(term)
            )
    return out


def effect_place(term: EffectTerm, structure: ChainStructure) -> Place:
    """The place of an effect of a model; ModelError where the model has no such place."""
    axes = list(structure.axes)
    effect = BY_CAUSE[term.cause]
    axis = axes.index(term.axis)
    if term.other_axis is not None:
        if term.other_axis not in axes or term.other_axis == term.axis:
            raise ModelError(
                f"effect {term.cause} on {term.axis}: no other axis {term.other_axis!r} in {axes}"
            )
        pair = sorted((axis, axes.index(term.other_axis)))
        return Place("pair", pair[0], other=pair[1])
    size = structure.sizes[axis]
    if effect.home == "axis":
        return Place("axis", axis)
    if effect.home == "base":
        return Place("base", 0)
    default = {"spring": "spring 1", "end": f"mass {size}", "motor": "mass 1"}[effect.home]
    kind, _, number = (term.element or default).partition(" ")
    most = size if kind == "mass" else size - 1
    if kind not in ("mass", "spring") or not number.isdigit() or not 1 <= int(number) <= most:
        raise ModelError(
            f"effect {term.cause} on {term.axis}: element {term.element!r}; the axis has {size} masses and "
            f"{size - 1} springs"
        )
    return Place(kind, axis, int(number))


def effect_vector(term: EffectTerm, chains: CoupledChains | None = None) -> Float64:
    """(k,) parameters of an effect as they are fitted; ModelError where one is missing or impossible."""
    effect: Effect = BY_CAUSE[term.cause].known(term)
    if chains is not None:
        effect = effect.of_machine(chains)
    values = {
        name: effect.optional[name]
        if name in effect.optional and name not in term.parameters
        else term.value(name)
        for name in effect.parameters
    }
    with np.errstate(all="ignore"):
        x = np.array(effect.vector(values), dtype=float)
    if not np.isfinite(x).all():
        raise ModelError(
            f"effect {term.cause} on {term.axis}: {values} is no such effect (sizes must be above zero)"
        )
    return x


def merge_spring_damping(model: Model) -> Model:
    """The model with its ``spring_damping`` effects added to the dampers of its chains, which are the same
    thing."""
    extra = [e for e in model.effects if (law := effect_of(e.cause)) is not None and law.in_chain]
    if not extra:
        return model
    chains = model.chains
    dampers = [d.copy() for d in chains.dampers]
    structure = ChainStructure(chains.masses_per_branch, chains.axes)
    for term in extra:
        place = effect_place(term, structure)
        dampers[place.axis][place.number - 1] += term.value("coefficient")
    kept = tuple(e for e in model.effects if e not in extra)
    return replace(
        model, chains=replace(chains, dampers=tuple(frozen_float(d) for d in dampers)), effects=kept
    )


def known_effects_candidate(model: Model, structure: ChainStructure) -> Candidate:
    """The effects of a model as they enter the fit; ModelError for a cause that is not in the catalogue."""
    out = Candidate()
    for term in effects_in_model(model):
        effect = effect_of(term.cause)
        if effect is not None and (effect.in_samples or effect.in_chain):
            continue
        if effect is None or effect in LARGE_MOTION:
            raise ModelError(
                f"effect {term.cause!r} on {term.axis}: no cause of the catalogue; it knows "
                f"{', '.join(sorted(e.cause for e in effects()))}; one from a file of its own needs "
                "that file (--effects FILE.py)"
            )
        law = effect.known(term).of_structure(structure)
        out = out.plus(PlacedEffect(law, effect_place(term, structure)), effect_vector(term, model.chains))
    return out
