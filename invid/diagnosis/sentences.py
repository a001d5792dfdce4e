"""Sentences about findings for the person who has to act on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import floor, log10

from invid.clauses import element_phrase
from invid.effects.registry import BY_CAUSE
from invid.model.diagnosis_document import SURE, Alternative, RuledOut
from invid.model.document import EffectTerm, Estimate
from invid.wording.sentence import Figure, capital, joined, marked, sentence

SHOWS_BELOW = ("torque_saturation", "base_compliance")
"""Causes that show the more the smaller their parameter is."""
LEAST_NAMED = 0.005
"""Share of what the model missed from which a finding is said to explain it; below, it would round to 0 %."""


def format_estimate(estimate: Estimate) -> str:
    """Value ± one standard deviation with as many digits as the standard deviation warrants."""
    unit = f" {estimate.unit}" if estimate.unit and estimate.unit != "1" else ""
    if estimate.std is None or not estimate.std > 0:
        return Figure(f"{estimate.value:.4g}{unit}")
    digits = max(0, min(8, 1 - floor(log10(estimate.std))))
    if abs(estimate.value) >= 1e5 or abs(estimate.value) < 1e-3:
        more = floor(log10(max(abs(estimate.value), estimate.std))) - floor(log10(estimate.std))
        return Figure(f"{estimate.value:.{min(more + 2, 9)}g} ± {estimate.std:.2g}{unit}")
    return Figure(f"{estimate.value:.{digits}f} ± {estimate.std:.{digits}f}{unit}")


def place_phrase(term: EffectTerm, sizes: Sequence[int], axes: Sequence[str]) -> str:
    """The place in words: "at the motor", "at the load", "in spring 2"; empty where an axis has one mass."""
    if term.other_axis is not None and term.cause == "gravity":
        return sentence(" of the link that {axis} carries, felt on both", axis=term.other_axis)
    if term.other_axis is not None:
        return sentence(" to axis {axis}", axis=term.other_axis)
    if term.element is None:
        return ""
    kind, _, q = term.element.partition(" ")
    if term.element == "spring 0":
        return sentence(" in the spring to ground")
    if kind == "spring":
        return sentence(" in spring {number}, counted from the motor", number=q)
    count = sizes[list(axes).index(term.axis)]
    if q == "1":
        return sentence(" at the motor") if count > 1 else ""
    return sentence(" at the load") if int(q) == count else sentence(" at mass {number}", number=q)


def ruled_out_sentence(found: RuledOut, sizes: Sequence[int], axes: Sequence[str]) -> str:
    """ "No free play in the transmission above 0.12 mrad on A2 in spring 1.", or why it could not be seen."""
    effect = BY_CAUSE[found.cause]
    name = effect.title.partition(" (")[0]
    thing = sentence(name.removeprefix("a ").removeprefix("an "))
    kind, _, number = (found.element or "").partition(" ")
    place = ""
    if effect.home != "base":
        term = EffectTerm(found.cause, found.axis, {}, found.element, found.other_axis)
        is_spring = found.other_axis is None and kind == "spring" and number != "0"
        spring = sentence(" in spring {number}", number=number) if is_spring else ""
        phrase = spring or place_phrase(term, sizes, axes)
        place = sentence(" on {axis}{phrase}", axis=found.axis, phrase=phrase)
    if found.limit is None:
        why = found.why or ""
        return capital(
            sentence("{thing}{place} could not have been seen: {why}.", thing=thing, place=place, why=why)
        )
    value, unit = found.limit, found.unit or "1"
    if unit in ("rad", "s", "m") and value < 0.1:
        value, unit = 1e3 * value, f"m{unit}"
    size = Figure(f"{value:.2g}" + ("" if unit == "1" else f" {unit}"))
    beyond = marked("No {thing} above {size}{place}.")
    if found.cause in SHOWS_BELOW:
        beyond = marked("No {thing} below {size}{place}.")
    return sentence(beyond, thing=thing, size=size, place=place)


def _rival_text(rival: Alternative, term: EffectTerm) -> str:
    """Title of an alternative; only its place where the cause is the same."""
    title = sentence(BY_CAUSE[rival.cause].title)
    if rival.axis != term.axis:
        return sentence("{what} on {axes}", what=title, axes=rival.axis)
    if rival.cause == term.cause and rival.other_axis != term.other_axis:
        if rival.other_axis is None:
            return sentence("the same on {axis} alone", axis=rival.axis)
        place = place_phrase(replace(term, other_axis=rival.other_axis), (), ())
        return sentence("the same{place}", place=place)
    if rival.cause == term.cause and rival.element is not None:
        return sentence("the same at {place}", place=element_phrase(rival.element))
    return title


def separating_text(causes: Sequence[str]) -> str:
    """What tells causes apart, that of the first one first; where they need different experiments, either."""
    experiments = {e.kind: e.text for e in (BY_CAUSE[c].separating for c in reversed(causes))}
    first = BY_CAUSE[causes[0]].separating
    others = [t for k, t in sorted(experiments.items()) if k != first.kind]
    if not others:
        return sentence(first.text)
    return sentence("{one}; or {other}", one=sentence(first.text), other=sentence(others[0]))


def finding_sentence(
    term: EffectTerm,
    fraction: float,
    confidence: float,
    rivals: Sequence[Alternative],
    sizes: Sequence[int],
    axes: Sequence[str],
) -> str:
    """Cause, place, size and gain of a finding; of a doubtful one what would make sure."""
    effect = BY_CAUSE[term.cause].known(term)
    main = term.parameters.get(effect.main)
    size = effect.size_text(format_estimate(main)) if main is not None else ""
    if main is not None and main.unit == "s":
        thousand = replace(
            main, value=1e3 * main.value, std=None if main.std is None else 1e3 * main.std, unit="ms"
        )
        size = sentence(" ({size})", size=format_estimate(thousand))
    explains = marked("Axis {axis}: {cause}{size}{place} explains {share} % of what the model missed.")
    beside = marked(
        "Axis {axis}: {cause}{size}{place} is there as well: beyond the noise, though less than "
        "a per cent of "
        "what the model missed."
    )
    place = place_phrase(term, sizes, axes)
    text = sentence(
        explains if fraction >= LEAST_NAMED else beside,
        axis=term.axis,
        cause=effect.title_text,
        size=size,
        place=place if term.other_axis is None or term.cause != "gravity" else joined([place, ""], ","),
        share=f"{100 * fraction:.0f}",
    )
    if rivals:
        others = joined(sorted({_rival_text(r, term) for r in rivals}))
        tells = separating_text([term.cause, *sorted({r.cause for r in rivals})])
        return joined(
            [text, sentence("The data cannot tell it from {others}: {tells}.", others=others, tells=tells)],
            " ",
        )
    if confidence < SURE:
        tells = sentence(effect.separating.text)
        sure = sentence("This is likely, not certain; to be sure: {tells}.", tells=tells)
        return joined([text, sure], " ")
    return text
