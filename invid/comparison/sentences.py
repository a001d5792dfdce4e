"""What a change in a model means to the person who stands at the robot, as typed statements."""

from __future__ import annotations

import math
from collections.abc import Sequence

from invid.comparison.changes import CauseStatus, Change, Comparison
from invid.comparison.named import named_change
from invid.model.named_change import ChangeKind
from invid.wording.clauses import label, shape_statement
from invid.wording.figures import differing_number, percent
from invid.wording.statement import Figure, Listed, Statement, Value, say

PRACTICAL = 0.02
"""Below it a change gets no interpretation: a tool change of interest exceeds about 2 % (a convention)."""
ALIKE = 3.0
"""Ratio of bounds up to which one figure stands for all kinds of parameters (a convention)."""
HELD = say(Statement("told.held"))


def statements(
    c: Comparison, *, joint_alpha: float, causes: Sequence[Statement] = ()
) -> tuple[Statement, ...]:
    """Return what changed, what did not, what cannot be told; each as a technician would want to hear it.

    ``causes``: what is to be said of the causes, whose sizes are left out of the rest.
    """
    told = {f"{x.name}.{x.parameter}" for x in c.causes}
    everything = c.parameters + tuple(x for x in c.effects if x.name not in told)
    changed = [x for x in everything if x.status == "changed"]
    unchanged = [x for x in everything if x.status == "unchanged"]
    separate = [x for x in everything if x.rivals]
    open_ones = [x for x in everything if x.status == "cannot_tell" and not x.rivals]
    said = interpret(changed, c.parameters)
    said += [Statement("told.one_of", {"labels": _listing(group)}) for group in rival_groups(separate)]
    moved = any(x.status is not CauseStatus.UNCHANGED for x in c.causes)
    said += [*(shape_statement(x) for x in c.shape), *(causes if moved else ())]
    spread_out = is_spread_out(c, joint_alpha)
    if spread_out:
        said.append(Statement("told.somewhere", {"p": Figure(f"{c.joint_p:.1g}")}))
    other = bool(changed or c.structure or separate or moved)
    if unchanged and spread_out:
        values: dict[str, Value] = {"count": _count(len(unchanged)), "within": within(unchanged)}
        said.append(Statement("told.some_unchanged", values))
    elif unchanged and not open_ones:
        said.append(Statement("told.nothing_else" if other else "told.nothing"))
        code = "told.all_one" if len(unchanged) == 1 else "told.all"
        code += "_other" if other or c.causes else ""
        said.append(Statement(code, {"n": len(unchanged), "within": within(unchanged)}))
    elif unchanged:
        values = {"count": _count(len(unchanged)), "within": within(unchanged)}
        said.append(Statement("told.nothing_else_known" if other else "told.nothing_known", values))
    if open_ones:
        values = {"labels": _listing(open_ones), "why": _reasons(open_ones)}
        said.append(Statement("told.cannot_tell", values))
    if causes and not moved:
        said += causes
    means = tuple(
        Statement(f"told.{side}_runs", {"n": n})
        for side, n in zip(("old", "new"), c.runs, strict=True)
        if n > 1
    )
    if means:
        said.append(Statement("told.means_of_runs", {"sides": Listed(means)}))
    if any(_sharper(x) for x in changed):
        said.append(Statement("told.held"))
    return tuple(said)


def is_spread_out(c: Comparison, joint_alpha: float) -> bool:
    """Return whether something changed jointly, and no parameter stands out."""
    found = any(x.status == "changed" or x.rivals for x in c.parameters + c.effects)
    return c.joint_p is not None and c.joint_p < joint_alpha and not found


def _sharper(c: Change) -> bool:
    """Return whether the change differs from new − old by more than its deviation: a reader will subtract."""
    if c.old is None or c.new is None or c.difference is None or c.std is None:
        return False
    return abs(c.difference - (c.new.value - c.old.value)) > c.std


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


def _count(count: int) -> Statement:
    return Statement("told.count_one" if count == 1 else "told.count", {"n": count})


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


def interpret(changed: Sequence[Change], every: Sequence[Change]) -> list[Statement]:
    """Return one sentence a change, or one for changes that have one reason.

    A change that is significant but certainly too small to matter gets no interpretation.
    """
    said: list[Statement] = []
    left = list(changed)
    for axis, (factor, own) in scaled_axes(changed, every).items():
        said.append(Statement("told.scale", {"axis": axis, "factor": Figure(f"{factor:.4g}")}))
        left = [c for c in left if c not in own]
    large = [c for c in left if not is_small(c)]
    loads = sum(c.final for c in large)
    least = Statement("told.small", {"least": Figure(f"{100 * PRACTICAL:.3g} %")})
    said += [_numbers(c, _meaning(c, loads)) for c in large]
    said += [_numbers(c, least) for c in left if is_small(c)]
    return said


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


def _numbers(c: Change, means: Statement | None) -> Statement:
    values: dict[str, Value] = {"label": label(named_change(c))}
    if c.old is not None and c.new is not None and c.difference is not None and c.std is not None:
        # The change may be better known than the two values, whose errors go together.
        spread = max(c.std, math.hypot(c.old.std or 0.0, c.new.std or 0.0))
        unit = f" {c.unit}" if c.unit else ""
        sign = "+" if c.difference >= 0 else "−"
        size = differing_number(abs(c.difference), c.std)
        values["old"] = Figure(differing_number(c.old.value, spread))
        values["new"] = Figure(f"{differing_number(c.new.value, spread)}{unit}")
        values["by"] = Figure(f"{sign}{size} ± {differing_number(c.std, c.std)}")
    if means is None:
        return Statement("told.changed_alone", values)
    return Statement("told.changed", {**values, "means": means})


def _meaning(c: Change, loads: int) -> Statement | None:
    direction = "more" if (c.difference or 0.0) > 0 else "less"
    kind = named_change(c).kind
    codes = {
        ChangeKind.LOAD: f"tool_{direction}" if loads > 1 else "tool",
        ChangeKind.MOTOR_MASS: "motor",
        ChangeKind.MASS: "structure",
        ChangeKind.INERTIA: "structure",
        ChangeKind.SPRING: "stiffer" if direction == "more" else "softer",
        ChangeKind.DAMPER: f"damping_{direction}",
        ChangeKind.COUPLING: "pose",
    }
    code = codes.get(kind)
    return None if code is None else Statement(f"consistent.{code}")


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
