"""Which parameters of two models belong together, with difference and standard deviation of each pair."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

from invid.comparison.changes import Change, Status
from invid.comparison.joint_test import covariance_of
from invid.model.document import EffectTerm, Estimate, Model, numbers_by_name, stds_by_name, units
from invid.model.named_change import ChangeKind, NamedChange
from invid.wording.statement import Statement


def _estimate(value: float, std: float, unit: str) -> Estimate:
    return Estimate(float(value), float(std) if math.isfinite(std) else None, unit)


def structure(old: Model, new: Model, common: Sequence[str]) -> list[NamedChange]:
    """What differs in axes and numbers of masses."""
    said = []
    for axis in old.axes:
        if axis not in new.axes:
            said.append(NamedChange(ChangeKind.AXIS_GONE, axis))
    for axis in new.axes:
        if axis not in old.axes:
            said.append(NamedChange(ChangeKind.AXIS_NEW, axis))
    for axis in common:
        before = old.chains.masses[old.axes.index(axis)].size
        after = new.chains.masses[new.axes.index(axis)].size
        if before != after:
            counts = Estimate(float(before)), Estimate(float(after))
            said.append(NamedChange(ChangeKind.MASSES, axis, old=counts[0], new=counts[1]))
    return said


def _names(count: int) -> list[str]:
    """Return what a person calls the masses of a branch."""
    if count == 1:
        return ["mass"]
    return ["motor mass", *(f"mass {q + 1}" for q in range(1, count - 1)), "final mass"]


def parameter_changes(old: Model, new: Model, common: Sequence[str], repeatability: float) -> list[Change]:
    """Masses, springs, dampers and couplings of the common axes."""
    unit = units(old.linear)
    sides = [(numbers_by_name(m.axes, m.chains), stds_by_name(m)) for m in (old, new)]
    out: list[Change] = []

    def add(axis: str, name: str, label: str, kind: str, of: str, scale: float | None = None) -> None:
        was, now = (_estimate(values[name], stds[name], unit[of]) for values, stds in sides)
        change = _pair(name, label, axis, kind, (was, now), repeatability)
        out.append(change if scale is None else replace(change, scale=scale))

    for axis in common:
        count, after = (m.chains.masses[m.axes.index(axis)].size for m in (old, new))
        if count != after:
            out.append(_whole_inertia(old, new, axis, unit["mass"], repeatability))
            continue
        for q, label in enumerate(_names(count), 1):
            add(axis, f"{axis}.mass.{q}", f"{axis}: {label}", "mass", "mass")
        out[-1] = replace(out[-1], final=True)
        for kind, of in (("spring", "stiffness"), ("damper", "damping")):
            for q in range(1, count):
                add(axis, f"{axis}.{kind}.{q}", f"{axis}: {kind} {q}", kind, of)
        ground = f"{axis}.ground_spring"
        if any(values[ground] != 0 for values, _ in sides):
            add(axis, ground, f"{axis}: spring to ground", "ground_spring", "stiffness")
    for first, second in combinations(common, 2):
        ends = [float(old.chains.masses[old.axes.index(a)][-1]) for a in (first, second)]
        pair, scale = f"{first}-{second}", math.sqrt(ends[0] * ends[1])
        add(first, f"{pair}.coupling", f"{pair}: coupling", "coupling", "mass", scale)
    return out


def _whole_inertia(old: Model, new: Model, axis: str, unit: str, repeatability: float) -> Change:
    """Return the sum of a branch's masses: the one thing that does not depend on their number."""

    def total(model: Model) -> Estimate:
        i = model.axes.index(axis)
        names = [f"{axis}.mass.{q + 1}" for q in range(model.chains.masses[i].size)]
        covariance = covariance_of(model, names)
        variance = float(covariance.sum())
        std = math.sqrt(variance) if math.isfinite(variance) and variance >= 0 else math.nan
        return _estimate(float(model.chains.masses[i].sum()), std, unit)

    return _pair(
        f"{axis}.inertia", f"{axis}: whole inertia", axis, "inertia", (total(old), total(new)), repeatability
    )


def _pair(  # noqa: PLR0913 - a pair and what its deviation is made of
    name: str,
    label: str,
    axis: str,
    kind: str,
    values: tuple[Estimate, Estimate],
    repeatability: float,
    widths: tuple[float, float] = (1.0, 1.0),
) -> Change:
    """Difference of new and old and its standard deviation; the status is decided later, over all."""
    old, new = values
    difference = new.value - old.value
    if name.endswith((".phase", ".angle")):
        difference = math.remainder(difference, 2 * math.pi)
    change = Change(
        name,
        label,
        axis,
        kind,
        old.unit or new.unit,
        old,
        new,
        Status.CANNOT_TELL,
        difference=difference,
        scale=abs(old.value),
    )
    missing = [w for w, e in (("old", old), ("new", new)) if e.std is None or e.std < 0]
    if missing:
        which = "both" if len(missing) == 2 else missing[0]
        return replace(change, why=Statement(f"why.no_std_{which}"))
    if not math.isfinite(max(widths)):
        return replace(change, why=Statement("why.other_law"))
    variance = sum((w * (e.std or 0.0)) ** 2 for w, e in zip(widths, values, strict=True))
    variance += repeatability**2 * (old.value**2 + new.value**2)
    if variance == 0:
        return replace(change, why=Statement("why.std_zero"))
    return replace(change, std=math.sqrt(variance))


# --- effects ---------------------------------------------------------------------------------------
def name_of(term: EffectTerm) -> str:
    """ "A2.backlash.spring 1": an effect by axis, cause and place."""
    return f"{term.axis}.{'.'.join(p for p in (term.cause, term.element, term.other_axis) if p)}"


def describe(term: EffectTerm) -> str:
    """ "coulomb friction at mass 1" of an effect, without its axis."""
    words = term.cause.replace("_", " ")
    if term.other_axis:
        words += f" to {term.other_axis}"
    return words + (f" at {term.element}" if term.element else "")


def named_effects(model: Model, common: Sequence[str]) -> dict[str, EffectTerm]:
    """The effects of a model on the ``common`` axes by name."""
    return {name_of(t): t for t in model.effects if t.axis in common}


def width(name: str, own: Mapping[str, EffectTerm], other: Mapping[str, EffectTerm]) -> float:
    """How many of its standard deviations an effect of ``own`` counts where friction at its place is named on
    this side alone: √(1 + z²) beside one of z deviations, infinite beside a law of several numbers."""
    term, alone = own[name], 0.0
    for other_name in own.keys() - other.keys():
        t = own[other_name]
        if (t.axis, t.element) == (term.axis, term.element) and is_friction(t) and is_friction(term):
            (size, *more) = t.parameters.values()
            alone += (size.value / size.std) ** 2 if size.std and not more else math.inf
    return math.sqrt(1.0 + alone)


def is_friction(term: EffectTerm) -> bool:
    """Whether an effect is one of the laws of friction."""
    return term.cause.endswith("_friction")


def effects(old: Model, new: Model, common: Sequence[str], repeatability: float) -> list[Change]:
    """Parameters of effects that both models have; what came or went is for ``compare_causes``."""
    before, after = (named_effects(m, common) for m in (old, new))
    changes: list[Change] = []
    for name, term in before.items():
        now = after.get(name)
        if now is None:
            continue
        widths = width(name, before, after), width(name, after, before)
        changes += [
            replace(
                _pair(
                    f"{name}.{parameter}",
                    f"{term.axis}: {describe(term)}, {parameter}",
                    term.axis,
                    "effect",
                    (value, now.parameters[parameter]),
                    repeatability,
                    widths,
                ),
                cause=term.cause,
                element=term.element,
                other_axis=term.other_axis,
            )
            for parameter, value in term.parameters.items()
            if parameter in now.parameters and not _is_chosen(value, now.parameters[parameter])
        ]
    return changes


def _is_chosen(was: Estimate, now: Estimate) -> bool:
    """Return whether a number is the same choice in both models, and no measurement (which spring drifts)."""
    return was.std == now.std == 0.0 and was.value == now.value
