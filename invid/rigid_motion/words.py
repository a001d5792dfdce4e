"""One sentence for each cause, for the person who has to do something about it."""

from __future__ import annotations

from invid.effects.registry import effect_of
from invid.model.diagnosis_document import Alternative
from invid.model.document import EffectTerm


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
    law = effect_of(effect.cause)
    name = _title(effect.cause)
    if effect.cause == "load_dependent_friction":
        name += ", weight and inertia" if effect.value("inertia_counts") else ", its weight"
    if effect.cause == "gravity" and effect.other_axis is not None:
        name = f"gravity of the link that {effect.other_axis} carries, felt on both"
    gain = f"without it {before:.3g} {unit} is missing, with it {after:.3g} {unit}"
    text = f"{effect.axis}: {name} ({sizes}); {gain}"
    if rivals:
        return text + "; the data cannot tell it from " + ", ".join(sorted({_title(r.cause) for r in rivals}))
    return text if law is None else f"{text}. {law.check}"


def _title(cause: str) -> str:
    effect = effect_of(cause)
    return cause.replace("_", " ") if effect is None else effect.title
