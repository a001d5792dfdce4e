"""Sentences about findings for the person who has to act on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import floor, log10

from invid.effects.registry import BY_CAUSE
from invid.model.diagnosis_document import SURE, Alternative, RuledOut
from invid.model.document import EffectTerm, Estimate

SHOWS_BELOW = ("torque_saturation", "base_compliance")
"""Causes that show the more the smaller their parameter is."""
LEAST_NAMED = 0.005
"""Share of what the model missed from which a finding is said to explain it; below, it would round to 0 %."""


def format_estimate(estimate: Estimate) -> str:
    """Value ± one standard deviation with as many digits as the standard deviation warrants."""
    unit = f" {estimate.unit}" if estimate.unit and estimate.unit != "1" else ""
    if estimate.std is None or not estimate.std > 0:
        return f"{estimate.value:.4g}{unit}"
    digits = max(0, min(8, 1 - floor(log10(estimate.std))))
    if abs(estimate.value) >= 1e5 or abs(estimate.value) < 1e-3:
        more = floor(log10(max(abs(estimate.value), estimate.std))) - floor(log10(estimate.std))
        return f"{estimate.value:.{min(more + 2, 9)}g} ± {estimate.std:.2g}{unit}"
    return f"{estimate.value:.{digits}f} ± {estimate.std:.{digits}f}{unit}"


def place_phrase(term: EffectTerm, sizes: Sequence[int], axes: Sequence[str]) -> str:
    """The place in words: "at the motor", "at the load", "in spring 2"; empty where an axis has one mass."""
    if term.other_axis is not None and term.cause == "gravity":
        return f" of the link that {term.other_axis} carries, felt on both,"
    if term.other_axis is not None:
        return f" to axis {term.other_axis}"
    if term.element is None:
        return ""
    kind, _, q = term.element.partition(" ")
    if term.element == "spring 0":
        return " in the spring to ground"
    if kind == "spring":
        return f" in {term.element}, counted from the motor"
    count = sizes[list(axes).index(term.axis)]
    if q == "1":
        return " at the motor" if count > 1 else ""
    return " at the load" if int(q) == count else f" at {term.element}"


def ruled_out_sentence(found: RuledOut, sizes: Sequence[int], axes: Sequence[str]) -> str:
    """ "No free play in the transmission above 0.12 mrad on A2 in spring 1.", or why it could not be seen."""
    effect = BY_CAUSE[found.cause]
    thing = effect.title.partition(" (")[0].removeprefix("a ").removeprefix("an ")
    term = EffectTerm(found.cause, found.axis, {}, found.element, found.other_axis)
    phrase = place_phrase(term, sizes, axes).rstrip(",").replace(", counted from the motor", "")
    place = "" if effect.home == "base" else f" on {found.axis}{phrase}"
    if found.limit is None:
        return f"{thing[:1].upper()}{thing[1:]}{place} could not have been seen: {found.why}."
    value, unit = found.limit, found.unit or "1"
    if unit in ("rad", "s", "m") and value < 0.1:
        value, unit = 1e3 * value, f"m{unit}"
    size = f"{value:.2g}" + ("" if unit == "1" else f" {unit}")
    beyond = "below" if found.cause in SHOWS_BELOW else "above"
    return f"No {thing} {beyond} {size}{place}."


def _rival_text(rival: Alternative, term: EffectTerm) -> str:
    """Title of an alternative; only its place where the cause is the same."""
    if rival.axis != term.axis:
        return f"{BY_CAUSE[rival.cause].title} on {rival.axis}"
    if rival.cause == term.cause and rival.other_axis != term.other_axis:
        if rival.other_axis is None:
            return f"the same on {rival.axis} alone"
        return f"the same{place_phrase(replace(term, other_axis=rival.other_axis), (), ())}".rstrip(",")
    if rival.cause == term.cause and rival.element is not None:
        return f"the same at {rival.element}"
    return BY_CAUSE[rival.cause].title


def separating_text(causes: Sequence[str]) -> str:
    """What tells causes apart, that of the first one first; where they need different experiments, either."""
    experiments = {e.kind: e.text for e in (BY_CAUSE[c].separating for c in reversed(causes))}
    first = BY_CAUSE[causes[0]].separating
    others = [t for k, t in sorted(experiments.items()) if k != first.kind]
    return "; or ".join([first.text, *others[:1]])


def finding_sentence(
    term: EffectTerm,
    fraction: float,
    confidence: float,
    rivals: Sequence[Alternative],
    sizes: Sequence[int],
    axes: Sequence[str],
) -> str:
    """Cause, place, size and gain of a finding; what to check, or of a doubtful one what would make sure."""
    effect = BY_CAUSE[term.cause].known(term)
    main = term.parameters.get(effect.main)
    size = effect.size_text(format_estimate(main)) if main is not None else ""
    if main is not None and main.unit == "s":
        thousand = replace(
            main, value=1e3 * main.value, std=None if main.std is None else 1e3 * main.std, unit="ms"
        )
        size = f" ({format_estimate(thousand)})"
    text = f"Axis {term.axis}: {effect.title}{size}{place_phrase(term, sizes, axes)} "
    if fraction >= LEAST_NAMED:
        text += f"explains {100 * fraction:.0f} % of what the model missed."
    else:
        text += "is there as well: beyond the noise, though less than a per cent of what the model missed."
    if rivals:
        others = sorted({_rival_text(r, term) for r in rivals})
        tells = separating_text([term.cause, *sorted({r.cause for r in rivals})])
        return f"{text} The data cannot tell it from {', '.join(others)}: {tells}."
    if confidence < SURE:
        return f"{text} This is likely, not certain; to be sure: {effect.separating.text}."
    return f"{text} {effect.check}"
