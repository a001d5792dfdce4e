"""What a change in a model means to the person who stands at the robot, as typed statements."""

from __future__ import annotations

import math
from collections.abc import Sequence

from invid.comparison.changes import CauseStatus, Change, Comparison
from invid.comparison.named import named_cause, named_change
from invid.wording.clauses import label, row_statement
from invid.wording.figures import percent
from invid.wording.statement import Figure, Listed, Statement, Value

PRACTICAL = 0.02
"""Below it a change gets no interpretation: a tool change of interest exceeds about 2 % (a convention)."""
ALIKE = 3.0
"""Ratio of bounds up to which one figure stands for all kinds of parameters (a convention)."""


def statements(c: Comparison, *, joint_alpha: float) -> tuple[Statement, ...]:
    """Return what changed, a sentence a row, then what did not and what cannot be told."""
    sizes = {f"{x.name}.{x.parameter}" for x in c.causes}
    everything = [*c.parameters, *(x for x in c.effects if x.name not in sizes)]
    unchanged = [x for x in everything if x.status == "unchanged"]
    open_ones = [x for x in everything if x.status == "cannot_tell" and not x.rivals]
    said = [row_statement(row) for row in c.named]
    if unchanged and not is_spread_out(c, joint_alpha):
        said.append(Statement("told.nothing" + "_else" * bool(said) + "_known" * bool(open_ones)))
    if unchanged:
        count = len(unchanged)
        code = "told.unchanged_one" if count == 1 else "told.unchanged"
        said.append(Statement(code, {"n": count, "within": within(unchanged)}))
    if open_ones:
        values: dict[str, Value] = {"labels": _listing(open_ones), "why": _reasons(open_ones)}
        said.append(Statement("told.cannot_tell", values))
    same = [x for x in c.causes if x.status is CauseStatus.UNCHANGED]
    if same:
        labels = Listed(tuple(label(named_cause(x), plain=True) for x in same))
        bound = Figure(percent(max(x.bound or 0.0 for x in same)))
        code = "told.causes_same_one" if len(same) == 1 else "told.causes_same"
        said.append(Statement(code, {"labels": labels, "bound": bound}))
    said += [
        Statement("told.cause_open", {"label": label(named_cause(x)), "why": x.why or ""})
        for x in c.causes
        if x.status is CauseStatus.CANNOT_TELL
    ]
    means = tuple(
        Statement(f"told.{side}_runs", {"n": n})
        for side, n in zip(("old", "new"), c.runs, strict=True)
        if n > 1
    )
    return (*said, Statement("told.means_of_runs", {"sides": Listed(means)})) if means else tuple(said)


def is_spread_out(c: Comparison, joint_alpha: float) -> bool:
    """Return whether something changed jointly, and no parameter stands out."""
    found = any(x.status == "changed" or x.rivals for x in c.parameters + c.effects)
    return c.joint_p is not None and c.joint_p < joint_alpha and not found


def rival_groups(separate: Sequence[Change]) -> list[list[Change]]:
    """Return groups of parameters of which one or another changed."""
    groups = []
    left = {x.name: x for x in separate}
    while left:
        group = [next(iter(left))]
        for name in group:
            group += [r for r in left[name].rivals if r in left and r not in group]
        groups.append([left.pop(name) for name in group])
    return groups


def within(unchanged: Sequence[Change]) -> Statement:
    """Return "within ±0.2 %", or for each kind its own where one would hide what the others can tell."""
    worst: dict[str, float] = {}
    for x in unchanged:
        worst[x.kind] = max(worst.get(x.kind, 0.0), x.bound or 0.0)
    if max(worst.values()) <= ALIKE * min(worst.values()):
        return Statement("told.within", {"bounds": Figure(f"±{100 * max(worst.values()):.2g} %")})
    bounds = tuple(
        Statement(
            "told.within_kind",
            {"bound": Figure(f"±{100 * b:.2g} %"), "kind": Statement(f"kinds.{k}", english=k)},
        )
        for k, b in worst.items()
    )
    return Statement("told.within", {"bounds": Listed(bounds, "comma")})


def _listing(changes: Sequence[Change], most: int = 6) -> Value:
    shown = Listed(tuple(label(named_change(x), plain=True) for x in changes[:most]), "comma")
    if len(changes) <= most:
        return shown
    return Statement("told.and_more", {"labels": shown, "n": len(changes) - most})


def _reasons(changes: Sequence[Change]) -> Listed:
    kinds = {x.reason: x.why for x in changes if x.why is not None and x.why.code != "why.unseen"}
    bounds = [x.bound for x in changes if x.bound is not None]
    said: list[Value] = [kinds[text] for text in sorted(kinds)]
    if bounds:
        low, high = bound_phrase(min(bounds)), bound_phrase(max(bounds))
        if low != high:
            said.append(Statement("why.unseen_range", {"low": low, "high": high}))
        else:
            said.append(Statement("why.unseen", {"bound": low}))
    return Listed(tuple(said), "semicolon")


def bound_phrase(fraction: float) -> Value:
    """Return a bound in per cent, or "any size" where it says nothing."""
    text = percent(fraction)
    return Statement("why.any_size") if text == "any size" else Figure(text)


def is_small(change: Change) -> bool:
    """Return whether a change is significant but certainly too small to matter."""
    return change.bound is not None and change.bound <= PRACTICAL


def scaled_axes(changed: Sequence[Change], every: Sequence[Change]) -> dict[str, tuple[float, list[Change]]]:
    """Return the axes of which all masses and springs changed by one factor, with it and those changes."""
    found: dict[str, tuple[float, list[Change]]] = {}
    for axis in dict.fromkeys(c.axis for c in changed):
        factor = _common_factor(
            [c for c in every if c.axis == axis and c.kind in ("mass", "spring", "inertia")]
        )
        own = [c for c in changed if c.axis == axis and c.kind in ("mass", "spring", "damper")]
        if factor is not None and len(own) >= 3:
            found[axis] = factor, own
    return found


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
    words = {"changed": "changed", "unchanged": "unchanged", "cannot_tell": "cannot tell"}
    lines = [f"{'parameter':<36} {'old':>12} {'new':>12} {'difference':>12} {'± std':>10}  verdict"]
    for c in changes:
        numbers = [c.old.value if c.old else None, c.new.value if c.new else None, c.difference, c.std]
        shown = [("–" if n is None else f"{n:.5g}") for n in numbers]
        bound = f" within ±{100 * c.bound:.2g} %" if c.status == "unchanged" and c.bound is not None else ""
        why = f": {c.reason}" if c.reason else ""
        lines.append(
            f"{c.label:<36} {shown[0]:>12} {shown[1]:>12} {shown[2]:>12} {shown[3]:>10}  "
            f"{words[str(c.status)]}{bound}{why}"
        )
    return "\n".join(lines)
