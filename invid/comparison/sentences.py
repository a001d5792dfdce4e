"""What a change in a model means to the person who stands at the robot, in sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

from invid.clauses import label, row_sentence
from invid.comparison.changes import Change, Comparison, Status
from invid.model.document import Estimate
from invid.model.named_change import ChangeKind, NamedChange
from invid.wording.figures import percent
from invid.wording.sentence import Figure, capital, joined, listed, marked, sentence

PRACTICAL = 0.02
"""Below it a change gets no interpretation: a tool change of interest exceeds about 2 % (a convention)."""
ALIKE = 3.0
"""Ratio of bounds up to which one figure stands for all kinds of parameters (a convention)."""


def named_changes(c: Comparison, joint_alpha: float) -> tuple[NamedChange, ...]:
    """Return what changed beyond its uncertainty: what matters first, then by kind, then by size.

    Parameters of causes are told with their cause. Where nothing at all can be told, one entry says so.
    """
    if not c.told:
        return (NamedChange(ChangeKind.UNTOLD, matters=False),)
    rows = _rows(c)
    found: list[NamedChange] = [*c.shape, *(x for x in c.causes if x.status.is_change)]
    changed = [x for x in rows if x.status.is_change]
    for axis in dict.fromkeys(x.axis for x in changed):
        factor = _common_factor([x for x in rows if x.axis == axis and x.family in _SCALED])
        own = [x for x in changed if x.axis == axis and x.family in ("mass", "spring", "damper")]
        if factor is not None and len(own) >= 3:
            found.append(NamedChange(ChangeKind.SCALE, axis, new=Estimate(factor), share=factor - 1.0))
            changed = [x for x in changed if x not in own]
    found += changed
    left = {x.name: x for x in rows if x.rivals}
    while left:
        names = [next(iter(left))]
        for name in names:
            names += [r for r in left[name].rivals if r in left and r not in names]
        group = tuple(left.pop(name) for name in names)
        found.append(NamedChange(ChangeKind.ONE_OF, group[0].axis, among=group))
    if is_spread_out(c, joint_alpha):
        found.append(NamedChange(ChangeKind.UNLOCATED))
    order = list(ChangeKind)
    return tuple(sorted(found, key=lambda x: (not x.matters, order.index(x.kind), -abs(x.share or 0.0))))


_SCALED = ("mass", "spring", "inertia")
_NOTHING = {
    (False, False): sentence("Nothing changed."),
    (True, False): sentence("Nothing else changed."),
    (False, True): sentence("Nothing changed as far as the data tell."),
    (True, True): sentence("Nothing else changed as far as the data tell."),
}
"""By whether something was said, and whether something is open."""
_KINDS = {
    "mass": sentence("masses"),
    "inertia": sentence("whole inertias"),
    "spring": sentence("springs"),
    "ground_spring": sentence("springs to ground"),
    "damper": sentence("dampers"),
    "coupling": sentence("couplings"),
    "effect": sentence("causes"),
}


def _rows(c: Comparison) -> list[Change]:
    """All numbers that are not told as the size of a cause."""
    sizes = {f"{x.name}.{x.parameter}" for x in c.causes}
    return [x for x in c.parameters + c.effects if x.name not in sizes]


def sentences(c: Comparison, joint_alpha: float) -> tuple[str, ...]:
    """Return what changed, a sentence a row, then what did not and what cannot be told."""
    everything = _rows(c)
    unchanged = [x for x in everything if x.status is Status.UNCHANGED]
    open_ones = [x for x in everything if x.status is Status.CANNOT_TELL and not x.rivals]
    said = [row_sentence(row) for row in c.named]
    if unchanged and not is_spread_out(c, joint_alpha):
        said.append(_NOTHING[bool(said), bool(open_ones)])
    if len(unchanged) == 1:
        said.append(sentence("1 parameter is the same {within}.", within=_within(unchanged)))
    elif unchanged:
        n, within = len(unchanged), _within(unchanged)
        said.append(sentence("{n} parameters are the same {within}.", n=n, within=within))
    if open_ones:
        labels, why = _listing(open_ones), _reasons(open_ones)
        said.append(sentence("Cannot tell for {labels}: {why}.", labels=labels, why=why))
    same = [x for x in c.causes if x.status is Status.UNCHANGED]
    if same:
        bound, labels = Figure(percent(max(x.bound or 0.0 for x in same))), listed(_labels(same))
        one = marked("{labels} is unchanged within ±{bound}.")
        more = marked("{labels} are unchanged within ±{bound}.")
        said.append(sentence(one if len(same) == 1 else more, labels=labels, bound=bound))
    said += [
        sentence("{label}: cannot tell whether it changed: {why}.", label=label(x), why=x.why)
        for x in c.causes
        if x.status is Status.CANNOT_TELL
    ]
    sides = marked("the old values of {n} runs"), marked("the new values of {n} runs")
    means = [sentence(side, n=n) for side, n in zip(sides, c.runs, strict=True) if n > 1]
    if means:
        said.append(sentence("Compared are means: {sides}.", sides=listed(means)))
    return tuple(map(capital, said))


def is_spread_out(c: Comparison, joint_alpha: float) -> bool:
    """Return whether something changed jointly, and no parameter stands out."""
    found = any(x.status.is_change or x.rivals for x in c.parameters + c.effects)
    return c.joint_p is not None and c.joint_p < joint_alpha and not found


def _within(unchanged: Sequence[Change]) -> str:
    """Return "within ±0.2 %", or for each kind its own where one would hide what the others can tell."""
    worst: dict[str, float] = {}
    for x in unchanged:
        worst[x.family] = max(worst.get(x.family, 0.0), x.bound or 0.0)
    figures = {k: Figure(f"±{100 * b:.2g} %") for k, b in worst.items()}
    if max(worst.values()) <= ALIKE * min(worst.values()):
        return sentence("within {bounds}", bounds=figures[max(worst, key=lambda k: worst[k])])
    bounds = [sentence("{bound} ({kind})", bound=f, kind=_KINDS.get(k, k)) for k, f in figures.items()]
    return sentence("within {bounds}", bounds=joined(bounds))


def _labels(changes: Sequence[Change]) -> list[str]:
    return [label(x, plain=True) for x in changes]


def _listing(changes: Sequence[Change], most: int = 6) -> str:
    shown = joined(_labels(changes[:most]))
    more = len(changes) - most
    return shown if more <= 0 else sentence("{labels} and {n} more", labels=shown, n=more)


def _reasons(changes: Sequence[Change]) -> str:
    said: list[str] = sorted({x.why for x in changes if x.bound is None and x.why})
    bounds = [x.bound for x in changes if x.bound is not None]
    if bounds:
        low, high = bound_phrase(min(bounds)), bound_phrase(max(bounds))
        one = sentence("a change of up to {bound} would not be seen", bound=low)
        several = sentence("changes of up to {low} to {high} would not be seen", low=low, high=high)
        said.append(one if low == high else several)
    return joined(said, "; ")


def bound_phrase(fraction: float) -> str:
    """Return a bound in per cent, or "any size" where it says nothing."""
    text = percent(fraction)
    return sentence("any size") if text == "any size" else Figure(text)


def _common_factor(changes: Sequence[Change]) -> float | None:
    """Ratio new/old where all of one axis share it (chi-square of the log ratios below 3 per item)."""
    ratios, weights = [], []
    for c in changes:
        if c.std is None or c.old is None or c.new is None or c.old.value <= 0 or c.new.value <= 0:
            return None
        ratios.append(math.log(c.new.value / c.old.value))
        weights.append((c.old.value / c.std) ** 2)
    if len(ratios) < 3:
        return None
    mean = sum(r * w for r, w in zip(ratios, weights, strict=True)) / sum(weights)
    misfit = sum(w * (r - mean) ** 2 for r, w in zip(ratios, weights, strict=True))
    sure = abs(mean) * math.sqrt(sum(weights)) > 5
    return math.exp(mean) if sure and misfit < 3 * (len(ratios) - 1) else None


def table(changes: Sequence[Change]) -> str:
    """Return every parameter, one line each."""
    lines = [f"{'parameter':<36} {'old':>12} {'new':>12} {'difference':>12} {'± std':>10}  verdict"]
    for c in changes:
        numbers = (c.old.value if c.old else None, c.new.value if c.new else None, c.difference, c.std)
        shown = " ".join(
            f"{'–' if n is None else f'{n:.5g}':>{w}}" for n, w in zip(numbers, (12, 12, 12, 10), strict=True)
        )
        is_bounded = c.status is Status.UNCHANGED and c.bound is not None
        bound = f" within ±{100 * (c.bound or 0.0):.2g} %" if is_bounded else ""
        why = f": {c.why}" if c.why else ""
        lines.append(f"{c.label:<36} {shown}  {str(c.status).replace('_', ' ')}{bound}{why}")
    return "\n".join(lines)
