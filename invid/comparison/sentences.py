"""What a change in a model means to the person who stands at the robot."""

from __future__ import annotations

import math
from collections.abc import Sequence

from invid.comparison.changes import CauseStatus, Change, Comparison

PRACTICAL = 0.02
"""Below it a change gets no interpretation: a tool change of interest exceeds about 2 % (a convention)."""
ALIKE = 3.0
"""Ratio of bounds up to which one figure stands for all kinds of parameters (a convention)."""
HELD = (
    "A change in brackets that is not new − old is the change with all other parameters held equal: the "
    "errors of the values go together, so it is better known than they are."
)


def differing_number(value: float, std: float) -> str:
    """A number with as many decimals as its standard deviation has meaning (one digit of it)."""
    if not (std > 0 and math.isfinite(std)):
        return f"{value:.6g}"
    first = math.floor(math.log10(std))
    if std / 10**first >= 9.5:  # would round up into the next decade
        first += 1
    decimals = max(0, -first)
    if decimals > 12 or abs(value) >= 1e9:
        return f"{value:.6g}"
    return f"{value:.{decimals}f}"


def sentences(c: Comparison, *, joint_alpha: float, causes: Sequence[str] = ()) -> tuple[str, ...]:
    """What changed, what did not, what cannot be told; each as a technician would want to hear it.

    ``causes``: what is to be said of the causes, whose sizes are left out of the rest.
    """
    told = {f"{x.name}.{x.parameter}" for x in c.causes}
    everything = c.parameters + tuple(x for x in c.effects if x.name not in told)
    changed = [x for x in everything if x.status == "changed"]
    unchanged = [x for x in everything if x.status == "unchanged"]
    separate = [x for x in everything if x.rivals]
    open_ones = [x for x in everything if x.status == "cannot_tell" and not x.rivals]
    said = interpret(changed, c.parameters) + _one_of(separate)
    moved = any(x.status is not CauseStatus.UNCHANGED for x in c.causes)
    said += [*c.structure, *(causes if moved else ())]
    spread_out = c.joint_p is not None and c.joint_p < joint_alpha and not changed and not separate
    if spread_out:
        said.append(
            f"Something changed (joint test, p = {c.joint_p:.1g}), but the data cannot tell which parameter: "
            "the uncertainties of several go together. A longer measurement would."
        )
    else_ = "else " if changed or c.structure or separate or moved else ""
    if unchanged and spread_out:
        said.append(f"{_count(len(unchanged))} unchanged {within(unchanged)}.")
    elif unchanged and not open_ones:
        said.append(f"Nothing {else_}changed.")
        said.append(f"{_all(len(unchanged), bool(else_ or c.causes))} {within(unchanged)}.")
    elif unchanged:
        said.append(
            f"Nothing {else_}changed as far as the data tell: {_count(len(unchanged))} unchanged "
            f"{within(unchanged)}."
        )
    if open_ones:
        said.append(f"Cannot tell for {_listing([x.label for x in open_ones])}: {_reasons(open_ones)}.")
    if causes and not moved:
        said += causes
    means = [
        f"the {side} values of {n} runs" for side, n in zip(("old", "new"), c.runs, strict=True) if n > 1
    ]
    if means:
        said.append(f"Compared are means: {' and '.join(means)}.")
    if any(_sharper(x) for x in changed):
        said.append(HELD)
    return tuple(said)


def _sharper(c: Change) -> bool:
    """Whether the change differs from new − old by more than its deviation: a reader will subtract."""
    if c.old is None or c.new is None or c.difference is None or c.std is None:
        return False
    return abs(c.difference - (c.new.value - c.old.value)) > c.std


def _one_of(separate: Sequence[Change]) -> list[str]:
    """One sentence for every group of parameters of which one or another changed."""
    said: list[str] = []
    left = {x.name: x for x in separate}
    while left:
        group = [next(iter(left))]
        for name in group:
            group += [r for r in left[name].rivals if r in left and r not in group]
        labels = [left.pop(name).label for name in group]
        said.append(f"One of these changed, the data do not tell which: {_listing(labels)}.")
    return said


_KINDS = {
    "mass": "masses",
    "inertia": "whole inertias",
    "spring": "springs",
    "ground_spring": "springs to ground",
    "damper": "dampers",
    "coupling": "couplings",
    "effect": "causes",
}


def within(unchanged: Sequence[Change]) -> str:
    """ "within ±0.2 %", or for each kind its own where one would hide what the others can tell."""
    worst: dict[str, float] = {}
    for x in unchanged:
        worst[x.kind] = max(worst.get(x.kind, 0.0), x.bound or 0.0)
    if max(worst.values()) <= ALIKE * min(worst.values()):
        return f"within ±{100 * max(worst.values()):.2g} %"
    return "within " + ", ".join(f"±{100 * b:.2g} % ({_KINDS.get(k, k)})" for k, b in worst.items())


def _all(count: int, other: bool) -> str:
    word = "other " if other else ""
    return (
        f"The one {word}parameter is the same" if count == 1 else f"All {count} {word}parameters are the same"
    )


def _count(count: int) -> str:
    return "1 parameter is" if count == 1 else f"{count} parameters are"


def _listing(labels: Sequence[str], most: int = 6) -> str:
    shown = ", ".join(x.replace(": ", " ") for x in labels[:most])
    return shown if len(labels) <= most else f"{shown} and {len(labels) - most} more"


def _reasons(changes: Sequence[Change]) -> str:
    kinds = {x.reason for x in changes if not x.reason.startswith("a change of up to")}
    bounds = [x.bound for x in changes if x.bound is not None]
    said = sorted(k for k in kinds if k)
    if bounds:
        low, high = percent(min(bounds)), percent(max(bounds))
        said.append(
            f"changes of up to {low} to {high} would not be seen"
            if low != high
            else f"a change of up to {low} would not be seen"
        )
    return "; ".join(said)


def percent(fraction: float) -> str:
    """A bound in per cent, two digits; "any size" where it says nothing."""
    value = 100 * fraction
    return f"{value:.2g} %" if value < 99.5 else f"{value:.0f} %" if value < 1e4 else "any size"


def interpret(changed: Sequence[Change], every: Sequence[Change]) -> list[str]:
    """One sentence a change, or one for changes that have one reason.

    A change that is significant but certainly too small to matter gets no interpretation.
    """
    said: list[str] = []
    left = list(changed)
    for axis in dict.fromkeys(c.axis for c in changed):
        factor = _common_factor(
            [c for c in every if c.axis == axis and c.kind in ("mass", "spring", "inertia")]
        )
        own = [c for c in left if c.axis == axis and c.kind in ("mass", "spring", "damper")]
        if factor is None or len(own) < 3:
            continue
        said.append(
            f"{axis}: all masses and springs changed by the same factor {factor:.4g}: consistent with "
            "another torque scale of this drive (rated torque, current calibration), not with a mechanical "
            "change."
        )
        left = [c for c in left if c not in own]
    small = [c for c in left if c.bound is not None and c.bound <= PRACTICAL]
    large = [c for c in left if c not in small]
    final_masses = [c for c in large if c.final]
    said += [f"{_numbers(c)}{_meaning(c, len(final_masses))}" for c in large]
    said += [f"{_numbers(c)}: beyond its uncertainty, but below {100 * PRACTICAL:.3g} %." for c in small]
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


def _numbers(c: Change) -> str:
    if c.old is None or c.new is None or c.difference is None or c.std is None:
        return c.label
    # The change may be better known than the two values, whose errors go together.
    spread = max(c.std, math.hypot(c.old.std or 0.0, c.new.std or 0.0))
    old, new = differing_number(c.old.value, spread), differing_number(c.new.value, spread)
    unit = f" {c.unit}" if c.unit else ""
    sign = "+" if c.difference >= 0 else "−"
    size = differing_number(abs(c.difference), c.std)
    return f"{c.label} {old} → {new}{unit} ({sign}{size} ± {differing_number(c.std, c.std)})"


def _meaning(c: Change, final_masses: int) -> str:
    more = (c.difference or 0.0) > 0
    if c.kind == "mass" and c.final:
        if final_masses > 1:
            return f": {'more' if more else 'less'} load on several axes, consistent with a tool change."
        return ": consistent with a tool change."
    if c.kind == "mass" and c.label.endswith("motor mass"):
        return ": consistent with another motor, brake or coupling on the motor's side."
    if c.kind in ("mass", "inertia"):
        return ": consistent with a change of load or structure between motor and tool."
    if c.kind == "spring":
        if more:
            return ": stiffer; consistent with a tightened belt or an exchanged gear."
        return ": softer; check belt tension, screws and the gear for wear."
    if c.kind == "damper":
        return f": {'more' if more else 'less'} damping; consistent with lubrication or temperature."
    if c.kind == "coupling":
        return ": consistent with another load or pose."
    return "."


def table(changes: Sequence[Change]) -> str:
    """Every parameter, one line each."""
    words = {"changed": "changed", "unchanged": "unchanged", "cannot_tell": "cannot tell"}
    lines = [f"{'parameter':<36} {'old':>12} {'new':>12} {'difference':>12} {'± std':>10}  verdict"]
    for c in changes:
        numbers = [c.old.value if c.old else None, c.new.value if c.new else None, c.difference, c.std]
        shown = [("–" if n is None else f"{n:.5g}") for n in numbers]
        within = f" within ±{100 * c.bound:.2g} %" if c.status == "unchanged" and c.bound is not None else ""
        why = f": {c.reason}" if c.reason else ""
        lines.append(
            f"{c.label:<36} {shown[0]:>12} {shown[1]:>12} {shown[2]:>12} {shown[3]:>10}  "
            f"{words[str(c.status)]}{within}{why}"
        )
    return "\n".join(lines)
