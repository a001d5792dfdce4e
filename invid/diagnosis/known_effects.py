"""Effects that a model given to the diagnosis already has: part of what is fitted, not to be found again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from invid.diagnosis.sentences import BY_CAUSE
from invid.effects.laws.sign import ROUNDING, DryLaw
from invid.errors import ModelError
from invid.likelihood.placed_effect import Candidate, Term
from invid.model.document import EffectTerm, Model
from invid.model.parameters import ChainStructure
from invid.model.place import Place
from invid.numerics.arrays import Float64, frozen_float
from invid.simulation.laws import EXTRA_MODE_DAMPING

_P = Mapping[str, float]


def _turned(amplitude: str, phase: str) -> Callable[[_P], list[float]]:
    """a·sin(x + φ) as a·cos φ·sin x + a·sin φ·cos x."""
    return lambda p: [p[amplitude] * np.cos(p[phase]), p[amplitude] * np.sin(p[phase])]


_VECTOR: dict[str, Callable[[_P], list[float]]] = {
    "coulomb_friction": lambda p: [p["torque"]],
    "viscous_friction": lambda p: [p["coefficient"]],
    "stribeck_friction": lambda p: [p["coulomb"], p["static"] - p["coulomb"], np.log(p["velocity"])],
    "presliding_friction": lambda p: [p["torque"], np.log(p["torque"] / p["stiffness"])],
    "asymmetric_friction": lambda p: [
        p["coulomb_positive"],
        p["coulomb_negative"],
        p["viscous_positive"],
        p["viscous_negative"],
    ],
    "torque_offset": lambda p: [p["torque"]],
    "cogging": lambda p: [*_turned("torque", "phase")(p), np.log(p["cycles_per_rev"])],
    "gravity": _turned("torque", "angle"),
    "torque_delay": lambda p: [p["delay"]],
    "torque_lag": lambda p: [np.log(p["time_constant"])],
    "torque_gain": lambda p: [p["gain"] - 1.0],
    "torque_saturation": lambda p: [np.log(p["limit"])],
    "encoder_eccentricity": _turned("amplitude", "phase"),
    "spring_damping": lambda p: [p["coefficient"]],
    "cubic_stiffness": lambda p: [p["coefficient"]],
    "backlash": lambda p: [np.log(p["gap"])],
    "spring_hysteresis": lambda p: [p["torque"], np.log(p["torque"] / p["stiffness"])],
    "transmission_error": lambda p: [*_turned("amplitude", "phase")(p), np.log(p["cycles_per_rev"])],
    "extra_mode": lambda p: [
        p["mass"],
        0.5 * np.log(p["stiffness"] / p["mass"]),
        np.log(p["damping_ratio"]),
    ],
    "coupling_stiffness": lambda p: [p["stiffness"]],
    "payload_change": lambda p: [p["mass"], p["time"]],
    "parameter_drift": lambda p: [p["rate"]],
}
"""The contract's parameters as the vector that an effect is fitted with: the inverse of ``Effect.values``."""

_OPTIONAL = {"damping_ratio": EXTRA_MODE_DAMPING}
"""What the contract does not ask for, as the simulation takes it where it is missing."""

_SAMPLES = ("dropped_samples",)
"""Causes that sit in the samples and not in the plant."""


_SPRINGS = (
    "cubic_stiffness",
    "backlash",
    "spring_hysteresis",
    "transmission_error",
    "spring_damping",
    "parameter_drift",
)


def carried(model: Model) -> tuple[EffectTerm, ...]:
    """Effects that count as part of the model: all but the friction that an identification fitted along.

    ``invid identify`` needs friction to get the linear parameters right; whether it is there, and of what
    kind, is for the diagnosis to say.
    """
    if model.fit.get("joint_with_effects"):
        return model.effects
    friction = model.fit.get("friction")
    if not isinstance(friction, Mapping):
        return model.effects
    return tuple(e for e in model.effects if e.cause not in ("coulomb_friction", "viscous_friction"))


def fitted_friction(model: Model, structure: ChainStructure) -> Candidate:
    """The friction that an identification fitted along, as causes at their places; none for other models."""
    kept = {id(e) for e in carried(model)}
    out = Candidate()
    for term in model.effects:
        if id(term) not in kept and min(term.parameters[n].value for n in term.parameters) > 0.0:
            out = out.plus(Term(BY_CAUSE[term.cause], place_of(term, structure)), vector_of(term))
    return out


def place_of(term: EffectTerm, structure: ChainStructure) -> Place:
    """Where an effect of a model sits; ModelError where the model has no such place."""
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
    if effect.cause in _SPRINGS:
        default = "spring 1"
    elif effect.cause in ("gravity", "extra_mode", "payload_change"):
        default = f"mass {size}"
    elif effect.family == "friction" or effect.cause in ("torque_offset", "cogging"):
        default = "mass 1"
    else:
        return Place("axis", axis)
    kind, _, number = (term.element or default).partition(" ")
    most = size if kind == "mass" else size - 1
    if kind not in ("mass", "spring") or not number.isdigit() or not 1 <= int(number) <= most:
        raise ModelError(
            f"effect {term.cause} on {term.axis}: element {term.element!r}; the axis has {size} masses and "
            f"{size - 1} springs"
        )
    return Place(kind, axis, int(number))


def vector_of(term: EffectTerm) -> Float64:
    """The parameters of an effect as they are fitted; ModelError where one is missing or impossible."""
    values = {
        name: _OPTIONAL[name] if name in _OPTIONAL and name not in term.parameters else term.value(name)
        for name in BY_CAUSE[term.cause].parameters
    }
    with np.errstate(all="ignore"):
        x = np.array(_VECTOR[term.cause](values), dtype=float)
    if not np.isfinite(x).all():
        raise ModelError(
            f"effect {term.cause} on {term.axis}: {values} is no such effect (sizes must be above zero)"
        )
    return x


def folded(model: Model) -> Model:
    """The model with its ``spring_damping`` among the dampers, which are the same thing."""
    extra = [e for e in model.effects if e.cause == "spring_damping"]
    if not extra:
        return model
    chains = model.chains
    dampers = [d.copy() for d in chains.dampers]
    structure = ChainStructure(chains.masses_per_branch, chains.axes)
    for term in extra:
        place = place_of(term, structure)
        dampers[place.axis][place.number - 1] += term.value("coefficient")
    kept = tuple(e for e in model.effects if e.cause != "spring_damping")
    return replace(
        model, chains=replace(chains, dampers=tuple(frozen_float(d) for d in dampers)), effects=kept
    )


def given_effects(model: Model, structure: ChainStructure) -> Candidate:
    """The effects of a model as they enter the fit of the linear parameters."""
    out = Candidate()
    for term in carried(model):
        if term.cause in (*_SAMPLES, "spring_damping"):
            continue
        if term.cause not in _VECTOR:
            raise ModelError(
                f"effect {term.cause!r} on {term.axis}: no cause of the catalogue; it knows "
                f"{', '.join(sorted(_VECTOR))}"
            )
        effect = BY_CAUSE[term.cause]
        if isinstance(effect, DryLaw) and ROUNDING in term.parameters:
            effect = effect.rounded(term.value(ROUNDING))
        out = out.plus(Term(effect, place_of(term, structure)), vector_of(term))
    return out
