"""All numbers of a model as one vector: those of its chains and of its effects, by name; pairs and means."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from invid.comparison.changes import Change
from invid.model.document import (
    EffectTerm,
    Estimate,
    Model,
    linear_parameters,
    std_by_name,
    stds_by_name,
    units,
    with_parameters,
)
from invid.model.named_change import ChangeKind
from invid.numerics.arrays import Float64, frozen_float
from invid.wording.sentence import sentence


def name_of(term: EffectTerm) -> str:
    """ "A2.backlash.spring 1": an effect by axis, cause and place."""
    return f"{term.axis}.{'.'.join(p for p in (term.cause, term.element, term.other_axis) if p)}"


def change_of(term: EffectTerm, kind: ChangeKind) -> Change:
    """What may have changed of an effect, without its sizes."""
    return Change(
        kind,
        term.axis,
        name_of(term),
        other_axis=term.other_axis,
        cause=term.cause,
        element=term.element,
    )


def terms_by_name(model: Model, axes: Sequence[str]) -> dict[str, EffectTerm]:
    """The effects of a model on ``axes`` by name."""
    return {name_of(t): t for t in model.effects if t.axis in axes}


def other_friction(
    term: EffectTerm, own: Mapping[str, EffectTerm], other: Mapping[str, EffectTerm]
) -> list[EffectTerm]:
    """Laws of friction of ``own`` at the place of a law of friction, that ``other`` does not have."""
    found = [t for n, t in own.items() if n not in other and t.cause.endswith("_friction")]
    is_friction = term.cause.endswith("_friction")
    return [t for t in found if is_friction and (t.axis, t.element) == (term.axis, term.element)]


def friction_widths(
    name: str, sides: tuple[Mapping[str, EffectTerm], Mapping[str, EffectTerm]]
) -> tuple[float, float]:
    """How many of its deviations an effect counts in either model, where friction at its place is named there
    alone: √(1 + z²) beside a law of z deviations, infinite beside one of several numbers."""
    old, new = sides
    out = []
    for own, other in ((old, new), (new, old)):
        alone = 0.0
        for term in other_friction(own[name], own, other):
            size, *more = term.parameters.values()
            alone += (size.value / size.std) ** 2 if size.std and not more else math.inf
        out.append(math.sqrt(1.0 + alone))
    return out[0], out[1]


def numbers_of(model: Model, axes: Sequence[str] = ()) -> dict[str, Change]:
    """Every number of a model by its name, as ``new`` of what may have changed.

    ``axes``: the order in which couplings name their two; default the model's own.
    """
    order = [*axes, *model.axes]
    found: dict[str, Change] = {}
    for own in linear_parameters(model):
        p = own._replace(axes=tuple(sorted(own.axes, key=order.index)))
        kind, axis = ChangeKind(p.kind), p.axes[0]
        if kind is ChangeKind.MASS and p.number == mass_count(model, axis):
            kind = ChangeKind.LOAD
        elif kind is ChangeKind.MASS and p.number == 1:
            kind = ChangeKind.MOTOR_MASS
        size = Estimate(p.value, p.std if math.isfinite(p.std) else None, p.unit)
        other = p.axes[1] if len(p.axes) > 1 else None
        found[p.name] = Change(kind, axis, p.name, p.number or None, other, new=size, unit=p.unit)
    for term in model.effects:
        whole = change_of(term, ChangeKind.EFFECT)
        for parameter, size in term.parameters.items():
            name = f"{whole.name}.{parameter}"
            found[name] = replace(whole, name=name, parameter=parameter, new=size, unit=size.unit)
    return found


def mass_count(model: Model, axis: str) -> int:
    """How many masses an axis has."""
    return model.chains.masses[model.axes.index(axis)].size


def apart(name: str, was: float, now: float) -> float:
    """now − was, the short way round for angles."""
    return math.remainder(now - was, 2 * math.pi) if name.endswith((".phase", ".angle")) else now - was


def paired_numbers(old: Model, new: Model, common: Sequence[str], relative: float = 0.0) -> list[Change]:
    """Numbers of the ``common`` axes that both models have, with difference and standard deviation.

    Of an axis whose number of masses changed its whole inertia stands for its own numbers, the one thing that
    does not depend on their number. ``relative``: standard deviation of an unchanged robot beside the fits'.
    """
    before, after = numbers_of(old), numbers_of(new, old.axes)
    terms = terms_by_name(old, common), terms_by_name(new, common)
    other = [a for a in common if mass_count(old, a) != mass_count(new, a)]
    out = []
    for name, row in (before | after).items():
        is_shared = (name in before and name in after) or row.kind is ChangeKind.GROUND_SPRING
        is_own = row.axis not in other or row.kind in (ChangeKind.COUPLING, ChangeKind.EFFECT)
        if is_shared and is_own and {row.axis, row.other_axis or row.axis} <= {*common}:
            was, now = (side[name].new if name in side else Estimate(0.0) for side in (before, after))
            if row.cause and was and now and was.std == now.std == 0.0 and was.value == now.value:
                continue  # the same choice in both, no measurement (which spring drifts)
            widths = (
                friction_widths(name.removesuffix(f".{row.parameter}"), terms) if row.cause else (1.0, 1.0)
            )
            found = with_difference(row, was, now, widths=widths, relative=relative)
            if row.kind is ChangeKind.COUPLING:
                loads = [old.chains.masses[old.axes.index(a or "")][-1] for a in (row.axis, row.other_axis)]
                found = replace(found, scale=math.sqrt(float(np.prod(loads))))
            out.append(found)
    for axis in other:
        row = Change(ChangeKind.INERTIA, axis, f"{axis}.inertia", unit=units(old.linear)["mass"])
        out.append(with_difference(row, *(_whole_inertia(m, axis) for m in (old, new)), relative=relative))
    return out


_NO_STD = {
    "old": sentence("the old model gives no uncertainty"),
    "new": sentence("the new model gives no uncertainty"),
    "both": sentence("the old and the new model gives no uncertainty"),
}


def with_difference(
    row: Change,
    old: Estimate | None,
    new: Estimate | None,
    *,
    widths: tuple[float, float] = (1.0, 1.0),
    relative: float = 0.0,
) -> Change:
    """The row with both sides, their difference and its deviation, or why there is none.

    ``widths``: how many of its deviations either side counts.
    """
    if old is None or new is None:
        return replace(row, old=old, new=new)
    found = replace(
        row, old=old, new=new, difference=apart(row.name, old.value, new.value), scale=abs(old.value)
    )
    missing = [w for w, e in (("old", old), ("new", new)) if e.std is None or e.std < 0]
    if missing:
        return replace(found, why=_NO_STD["both" if len(missing) == 2 else missing[0]])
    if not math.isfinite(max(widths)):
        return replace(found, why=sentence("the other run describes the friction there by another law"))
    parts = [(w * (e.std or 0.0), relative * e.value) for w, e in zip(widths, (old, new), strict=True)]
    std = math.hypot(*(size for part in parts for size in part))
    return (
        replace(found, std=std)
        if std
        else replace(found, why=sentence("both models claim a standard deviation of 0"))
    )


def _whole_inertia(model: Model, axis: str) -> Estimate:
    """The sum of a branch's masses."""
    at = model.axes.index(axis)
    names = [f"{axis}.mass.{q + 1}" for q in range(mass_count(model, axis))]
    variance = float(covariance_of(model, names).sum())
    return Estimate(float(model.chains.masses[at].sum()), math.sqrt(variance) if variance >= 0 else None)


def covariance_of(model: Model, names: Sequence[str]) -> Float64:
    """(n, n) covariance of named numbers: the joint one where the model has it, else diagonal.

    A model's std (which may carry more than the fit's own covariance) stays; correlation is added. NaN where
    the model does not know one.
    """
    stds = stds_by_name(model)
    spread = np.array([stds.get(n, math.nan) for n in names])
    correlation = np.eye(len(names))
    joint = model.covariance
    if joint is not None and joint.shape == (len(model.parameter_names),) * 2:
        at = {n: k for k, n in enumerate(model.parameter_names)}
        at |= {_other_way_round(n): k for n, k in at.items()}
        known = [k for k, n in enumerate(names) if n in at]
        rows = [at[names[k]] for k in known]
        own = np.sqrt(np.clip(np.diag(joint)[rows], 0, None))
        with np.errstate(invalid="ignore", divide="ignore"):
            correlation[np.ix_(known, known)] = np.nan_to_num(
                joint[np.ix_(rows, rows)] / np.outer(own, own), posinf=0.0, neginf=0.0
            )
        np.fill_diagonal(correlation, 1.0)
    return np.asarray(correlation * np.outer(spread, spread))


def _other_way_round(name: str) -> str:
    """ "A2-A1.coupling" of "A1-A2.coupling", the same number."""
    first, dash, rest = name.partition("-")
    second, _, kind = rest.rpartition(".")
    return f"{second}-{first}.{kind}" if dash and kind == "coupling" else name


def covariance_of_differences(
    changes: Sequence[Change],
    models: tuple[Model, Model],
    factors: tuple[Mapping[str, float], Mapping[str, float]] = ({}, {}),
) -> Float64:
    """(n, n) covariance of the differences: the deviations that they have, with the fits' correlation.

    ``factors``: by axis, how many times the variance of its chain counts in either model.
    """
    names = [c.name for c in changes]
    total = np.diag([(c.std or 0.0) ** 2 for c in changes])
    for model, by_axis in zip(models, factors, strict=True):
        own = np.nan_to_num(covariance_of(model, names))
        total += own - np.diag(np.diag(own))
        for axis, factor in by_axis.items():
            at = np.ix_(*[[k for k, c in enumerate(changes) if c.axis == axis and c.cause is None]] * 2)
            total[at] += (factor - 1.0) * own[at]
    return total


# --- means ----------------------------------------------------------------------------------------
def has_same_shape(one: Model, other: Model) -> bool:
    """True where both have the same numbers, effects included, so that a mean has a meaning."""
    return one.linear == other.linear and numbers_of(one).keys() == numbers_of(other).keys()


def mean_model(models: Sequence[Model]) -> Model:
    """Mean of models of the same shape (the last gives names and facts), with the covariance of that mean.

    One weight a model, by the size of its variances: the mean of each parameter then lies between its values,
    which inverse covariance matrices do not promise where correlations are strong and themselves estimates.
    """
    last = models[-1]
    if len(models) == 1:
        return last
    weights, mean = _weights(models), dict[str, Estimate]()
    sides = [numbers_of(m) for m in models]
    for name in sides[-1]:
        each = [e for side in sides if (e := side[name].new) is not None]
        own = each[-1]
        shift = sum(w * apart(name, own.value, e.value) for w, e in zip(weights, each, strict=True))
        stds = [w * e.std for w, e in zip(weights, each, strict=True) if e.std is not None]
        std = math.hypot(*stds) if len(stds) == len(each) else None
        mean[name] = replace(own, value=own.value + shift, std=std)
    matrices = [m.covariance for m in models if m.parameter_names == last.parameter_names]
    known = [c for c in matrices if c is not None]
    whole = len(known) == len(models)
    joint = frozen_float(sum(w**2 * c for w, c in zip(weights, known, strict=True))) if whole else None
    return replace(
        last,
        chains=with_parameters(last.chains, {n: e.value for n, e in mean.items()}),
        std=std_by_name(last.chains, {n: math.nan if e.std is None else e.std for n, e in mean.items()}),
        covariance=joint,
        effects=tuple(
            replace(t, parameters={n: mean[f"{name_of(t)}.{n}"] for n in t.parameters}) for t in last.effects
        ),
    )


def _weights(models: Sequence[Model]) -> list[float]:
    stds = np.array([np.concatenate([*m.std.masses, *m.std.springs, *m.std.dampers]) for m in models])
    good = np.all(np.isfinite(stds) & (stds > 0), axis=0)
    if not good.any():
        return [1.0 / len(models)] * len(models)
    size = -2.0 * np.log(stds[:, good]).mean(axis=1)
    weight = np.exp(size - size.max())
    return [float(w) for w in weight / weight.sum()]
