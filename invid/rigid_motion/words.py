"""One sentence for each cause, for the person who has to do something about it."""

from __future__ import annotations

from invid.model.diagnosis_document import Alternative
from invid.model.document import EffectTerm

_ADVICE = {
    "asymmetric_friction": "look for wear, preload or a seal that acts in one direction",
    "stribeck_friction": "look at the lubrication: it sticks before it slides",
    "load_dependent_friction": "look at the bearings, the preload and the gear's efficiency under load",
    "gravity": "give the controller the load's weight",
    "cubic_stiffness": "the spring is not linear: identify at the amplitude it is used at",
}
_NAMES = {
    "load_dependent_friction": "friction that grows with the load on the joint",
    "coulomb_friction": "Coulomb friction",
    "viscous_friction": "viscous friction",
    "stribeck_friction": "Stribeck friction",
    "asymmetric_friction": "Coulomb and viscous friction, different in the two directions",
    "torque_offset": "a constant torque",
    "torque_delay": "the torque that acts lags the record",
    "gravity": "gravity",
    "cubic_stiffness": "a spring force with the cube of the deflection",
    "quadratic_stiffness": "a spring force with the square of the deflection",
}


def sentence_of(
    effect: EffectTerm, before: float, after: float, unit: str, rivals: tuple[Alternative, ...]
) -> str:
    """Cause, size, gain; and what else it may be."""
    sizes = ", ".join(
        f"{name.replace('_', ' ')} {p.value:.4g}"
        + (f" ± {p.std:.2g}" if p.std is not None else "")
        + (f" {p.unit}" if p.unit else "")
        for name, p in effect.parameters.items()
        if name not in ("exponent", "inertia_counts")
    )
    name = _NAMES.get(effect.cause, effect.cause.replace("_", " "))
    if effect.cause == "load_dependent_friction":
        name += ", weight and inertia" if effect.value("inertia_counts") else ", its weight"
    if effect.cause == "gravity" and effect.other_axis is not None:
        name = f"gravity of the link that {effect.other_axis} carries, felt on both"
    gain = f"without it {before:.3g} {unit} is missing, with it {after:.3g} {unit}"
    text = f"{effect.axis}: {name} ({sizes}); {gain}"
    if rivals:
        return (
            text
            + "; the data cannot tell it from "
            + ", ".join(sorted({_NAMES.get(r.cause, r.cause) for r in rivals}))
        )
    advice = _ADVICE.get(effect.cause)
    return text + (f"; {advice}" if advice else "")
