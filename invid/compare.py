"""Two models of one robot: which parameters changed beyond their uncertainty, in words and numbers.

A parameter *changed* where |new − old| is significant against the uncertainty of both (two-sided,
Holm's step-down over everything tested, so that calling anything changed on a robot that did not
change happens at most with probability ``alpha``); it is *unchanged within ±x %* where the whole
interval of the difference lies inside that tolerance; otherwise the data *cannot tell*. A joint
chi-square test with the full covariance sees changes that are spread over correlated parameters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from invid.arrays import Float64
from invid.compare_words import differing_number, interpret
from invid.distributions import chi2_sf, normal_isf, normal_sf
from invid.errors import InputError
from invid.model import EffectTerm, Estimate, Model, units

ALPHA = 0.01
"""Probability of calling anything changed where nothing did (family-wise)."""
TOLERANCE = 0.02
"""Default of ±x: 2 % is about what a tool change of practical interest exceeds (a convention)."""


class Status(StrEnum):
    """What can be said of one parameter."""

    CHANGED = "changed"
    UNCHANGED = "unchanged"
    CANNOT_TELL = "cannot_tell"


@dataclass(frozen=True)
class Change:
    """One parameter, before and after.

    ``bound`` is the largest relative change that the data still allow (a fraction of ``scale``);
    ``scale`` is |old|, or for couplings the geometric mean of the final masses they join.
    """

    name: str
    label: str
    axis: str
    kind: str
    unit: str | None
    old: Estimate | None
    new: Estimate | None
    status: Status
    reason: str = ""
    difference: float | None = None
    std: float | None = None
    p_value: float | None = None
    p_adjusted: float | None = None
    scale: float = 0.0
    bound: float | None = None
    final: bool = False

    def to_json(self) -> dict[str, Any]:
        """Plain values."""

        def estimate(e: Estimate | None) -> dict[str, Any] | None:
            return None if e is None else {"value": e.value, "std": e.std}

        return {
            "parameter": self.name,
            "label": self.label,
            "axis": self.axis,
            "kind": self.kind,
            "unit": self.unit,
            "old": estimate(self.old),
            "new": estimate(self.new),
            "status": str(self.status),
            "reason": self.reason,
            "difference": self.difference,
            "std": self.std,
            "p": self.p_value,
            "p_adjusted": self.p_adjusted,
            "within_percent": None if self.bound is None else 100.0 * self.bound,
        }


@dataclass(frozen=True)
class Comparison:
    """What changed between two models."""

    old_robot: str
    new_robot: str
    alpha: float
    tolerance: float
    parameters: tuple[Change, ...]
    effects: tuple[Change, ...]
    joint_p: float | None
    joint_dof: int
    sentences: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    structure: tuple[str, ...] = field(default=())
    """What differs in structure: axes, numbers of masses, effects that came or went."""

    @property
    def told(self) -> bool:
        """False where nothing could be called changed or unchanged."""
        return bool(self.structure) or any(
            c.status is not Status.CANNOT_TELL for c in self.parameters + self.effects
        )

    def to_json(self) -> dict[str, Any]:
        """The ``invid-comparison`` document."""
        return {
            "format": "invid-comparison",
            "format_version": 1,
            "robots": [self.old_robot, self.new_robot],
            "alpha": self.alpha,
            "tolerance_percent": 100.0 * self.tolerance,
            "parameters": [c.to_json() for c in self.parameters],
            "effects": [c.to_json() for c in self.effects],
            "joint": {"p": self.joint_p, "dof": self.joint_dof},
            "structure": list(self.structure),
            "sentences": list(self.sentences),
            "warnings": list(self.warnings),
        }


def compare(
    old: Model,
    new: Model,
    *,
    tolerance: float = TOLERANCE,
    alpha: float = ALPHA,
    repeatability: float = 0.0,
) -> Comparison:
    """Compare two models of one robot.

    Parameters
    ----------
    tolerance
        ±x as a fraction: below it a parameter is called unchanged, if the data are good enough.
    alpha
        Family-wise probability of a false "changed".
    repeatability
        Relative standard deviation between measurements of an unchanged robot (temperature, pose),
        added to the uncertainty of every parameter; 0 trusts the models' own.

    Raises
    ------
    InputError
        Where the models have no axis in common, different units, or an option is out of range.
    """
    for name, value, top in (
        ("tolerance", tolerance, 10.0),
        ("alpha", alpha, 0.5),
        ("repeatability", repeatability, 10.0),
    ):
        if not (0 <= value <= top) or (value == 0 and name != "repeatability"):
            raise InputError(f"compare: {name} is {value!r}; it must lie between 0 and {top}")
    if old.linear != new.linear:
        raise InputError(
            f"compare: the old model is in {units(old.linear)['mass']} and the new one in "
            f"{units(new.linear)['mass']}; these are different robots"
        )
    common = [a for a in old.axes if a in new.axes]
    if not common:
        raise InputError(
            f"compare: no axis in common: the old model has {list(old.axes)}, the new one {list(new.axes)}"
        )
    structure, warnings = _structure(old, new, common)
    if old.robot != new.robot:
        warnings.append(f"the models name different robots: {old.robot!r} and {new.robot!r}")
    parameters = _linear_parameters(old, new, common, repeatability)
    effects, came_and_went = _effects(old, new, common, repeatability)
    structure += came_and_went
    tested = _judge([*parameters, *effects], tolerance, alpha)
    linear, effect_changes = tuple(tested[: len(parameters)]), tuple(tested[len(parameters) :])
    joint_p, joint_dof = _joint(old, new, linear, repeatability)
    comparison = Comparison(
        old.robot,
        new.robot,
        alpha,
        tolerance,
        linear,
        effect_changes,
        joint_p,
        joint_dof,
        (),
        tuple(warnings),
        tuple(structure),
    )
    return replace(comparison, sentences=_sentences(comparison))


# --- pairing ---------------------------------------------------------------------------------------
def _estimate(value: float, std: float, unit: str) -> Estimate:
    return Estimate(float(value), float(std) if math.isfinite(std) else None, unit)


def _structure(old: Model, new: Model, common: Sequence[str]) -> tuple[list[str], list[str]]:
    said = []
    for axis in old.axes:
        if axis not in new.axes:
            said.append(f"{axis} is in the old model only.")
    for axis in new.axes:
        if axis not in old.axes:
            said.append(f"{axis} is in the new model only.")
    for axis in common:
        before = old.chains.masses[old.axes.index(axis)].size
        after = new.chains.masses[new.axes.index(axis)].size
        if before != after:
            said.append(
                f"{axis} had {before} {_plural(before, 'mass')} and now has {after}: only its whole "
                "inertia can be compared."
            )
    return said, []


def _plural(count: int, word: str) -> str:
    return word if count == 1 else word + "es"


def _names(count: int) -> list[str]:
    """What a person calls the masses of a branch."""
    if count == 1:
        return ["mass"]
    return ["motor mass", *(f"mass {q + 1}" for q in range(1, count - 1)), "final mass"]


def _linear_parameters(old: Model, new: Model, common: Sequence[str], repeatability: float) -> list[Change]:
    unit = units(old.linear)
    out: list[Change] = []
    for axis in common:
        i, j = old.axes.index(axis), new.axes.index(axis)
        a, b = old.chains, new.chains
        if a.masses[i].size != b.masses[j].size:
            out.append(_whole_inertia(old, new, axis, unit["mass"], repeatability))
            continue
        columns = (
            ("mass", unit["mass"], a.masses[i], old.std.masses[i], b.masses[j], new.std.masses[j]),
            ("spring", unit["stiffness"], a.springs[i], old.std.springs[i], b.springs[j], new.std.springs[j]),
            ("damper", unit["damping"], a.dampers[i], old.std.dampers[i], b.dampers[j], new.std.dampers[j]),
        )
        labels = _names(a.masses[i].size)
        for kind, of, va, sa, vb, sb in columns:
            for q in range(va.size):
                label = labels[q] if kind == "mass" else f"{kind} {q + 1}"
                change = _pair(
                    f"{axis}.{kind}.{q + 1}",
                    f"{axis}: {label}",
                    axis,
                    kind,
                    _estimate(va[q], sa[q], of),
                    _estimate(vb[q], sb[q], of),
                    repeatability,
                )
                out.append(replace(change, final=kind == "mass" and q == va.size - 1))
        if a.ground_springs[i] != 0 or b.ground_springs[j] != 0:
            out.append(
                _pair(
                    f"{axis}.ground_spring",
                    f"{axis}: spring to ground",
                    axis,
                    "ground_spring",
                    _estimate(a.ground_springs[i], old.std.ground_springs[i], unit["stiffness"]),
                    _estimate(b.ground_springs[j], new.std.ground_springs[j], unit["stiffness"]),
                    repeatability,
                )
            )
    for x, first in enumerate(common):
        for second in common[x + 1 :]:
            i, j = old.axes.index(first), old.axes.index(second)
            k, m = new.axes.index(first), new.axes.index(second)
            scale = math.sqrt(float(old.chains.masses[i][-1] * old.chains.masses[j][-1]))
            out.append(
                _pair(
                    f"{first}-{second}.coupling",
                    f"{first}-{second}: coupling",
                    first,
                    "coupling",
                    _estimate(old.chains.couplings[i, j], old.std.couplings[i, j], unit["mass"]),
                    _estimate(new.chains.couplings[k, m], new.std.couplings[k, m], unit["mass"]),
                    repeatability,
                    scale=scale,
                )
            )
    return out


def _whole_inertia(old: Model, new: Model, axis: str, unit: str, repeatability: float) -> Change:
    """Sum of a branch's masses: the one thing that does not depend on their number."""

    def total(model: Model) -> Estimate:
        i = model.axes.index(axis)
        names = [f"{axis}.mass.{q + 1}" for q in range(model.chains.masses[i].size)]
        covariance = _covariance(model, names)
        variance = float(covariance.sum())
        std = math.sqrt(variance) if math.isfinite(variance) and variance >= 0 else math.nan
        return _estimate(float(model.chains.masses[i].sum()), std, unit)

    return _pair(
        f"{axis}.inertia", f"{axis}: whole inertia", axis, "inertia", total(old), total(new), repeatability
    )


def _pair(
    name: str,
    label: str,
    axis: str,
    kind: str,
    old: Estimate,
    new: Estimate,
    repeatability: float,
    *,
    scale: float | None = None,
) -> Change:
    """Difference and its standard deviation; the status is decided later, over all."""
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
        scale=abs(old.value) if scale is None else scale,
    )
    missing = [w for w, e in (("old", old), ("new", new)) if e.std is None or e.std < 0]
    if missing:
        return replace(change, reason=f"the {' and the '.join(missing)} model gives no uncertainty")
    variance = (old.std or 0.0) ** 2 + (new.std or 0.0) ** 2
    variance += repeatability**2 * (old.value**2 + new.value**2)
    if variance == 0:
        return replace(change, reason="both models claim a standard deviation of 0")
    return replace(change, std=math.sqrt(variance))


# --- effects ---------------------------------------------------------------------------------------
def _key(term: EffectTerm) -> tuple[str, str, str | None, str | None]:
    return term.cause, term.axis, term.element, term.other_axis


def describe(term: EffectTerm) -> str:
    """ "coulomb friction at mass 1" of an effect, without its axis."""
    words = term.cause.replace("_", " ")
    if term.other_axis:
        words += f" to {term.other_axis}"
    return words + (f" at {term.element}" if term.element else "")


def _main(term: EffectTerm) -> tuple[str, Estimate] | None:
    """First parameter by the contract's order: the size."""
    return next(iter(term.parameters.items()), None)


def _effects(
    old: Model, new: Model, common: Sequence[str], repeatability: float
) -> tuple[list[Change], list[str]]:
    before = {_key(t): t for t in old.effects if t.axis in common}
    after = {_key(t): t for t in new.effects if t.axis in common}
    changes: list[Change] = []
    said: list[str] = []
    for key, term in before.items():
        base = f"{term.axis}.{'.'.join(p for p in (term.cause, term.element, term.other_axis) if p)}"
        if key in after:
            for parameter, value in term.parameters.items():
                if parameter in after[key].parameters:
                    changes.append(
                        _pair(
                            f"{base}.{parameter}",
                            f"{term.axis}: {describe(term)}, {parameter}",
                            term.axis,
                            "effect",
                            value,
                            after[key].parameters[parameter],
                            repeatability,
                        )
                    )
            continue
        twin = _same_place(term, after.values(), before)
        said.append(
            f"{term.axis}: {describe(term)} is described as {twin.cause.replace('_', ' ')} now."
            if twin
            else f"{term.axis}: {describe(term)}{_size(term)} is no longer found."
        )
    for key, term in after.items():
        if key not in before and _same_place(term, before.values(), after) is None:
            said.append(f"{term.axis}: {describe(term)}{_size(term)} is new.")
    return changes, said


def _same_place(
    term: EffectTerm, others: Iterable[EffectTerm], own: Mapping[Any, EffectTerm]
) -> EffectTerm | None:
    """Another kind of friction at the same place, that this side does not have too."""
    for other in others:
        if (
            _key(other) not in own
            and (other.axis, other.element) == (term.axis, term.element)
            and other.cause.endswith("_friction")
            and term.cause.endswith("_friction")
        ):
            return other
    return None


def _size(term: EffectTerm) -> str:
    main = _main(term)
    if main is None:
        return ""
    name, value = main
    shown = differing_number(value.value, value.std or abs(value.value) * 0.01)
    spread = f" ± {differing_number(value.std, value.std)}" if value.std else ""
    return f" ({name.replace('_', ' ')} {shown}{spread}{' ' + value.unit if value.unit else ''})"


# --- judging ---------------------------------------------------------------------------------------
def _judge(changes: Sequence[Change], tolerance: float, alpha: float) -> list[Change]:
    """Holm's step-down for *changed*, an interval inside ±tolerance for *unchanged*."""
    tested = [i for i, c in enumerate(changes) if c.std is not None]
    p = {i: 2 * normal_sf(abs((changes[i].difference or 0.0) / (changes[i].std or 1.0))) for i in tested}
    out = list(changes)
    running = 0.0
    # One-sided on either side: the larger of both ends decides (two one-sided tests).
    reach = normal_isf(alpha)
    for rank, i in enumerate(sorted(tested, key=lambda k: p[k])):
        running = max(running, min(1.0, (len(tested) - rank) * p[i]))
        c = out[i]
        half = reach * (c.std or 0.0)
        bound = (abs(c.difference or 0.0) + half) / c.scale if c.scale > 0 else None
        if running < alpha:
            status, reason = Status.CHANGED, ""
        elif bound is not None and bound <= tolerance:
            status, reason = Status.UNCHANGED, ""
        else:
            status = Status.CANNOT_TELL
            reason = (
                "no value to compare with: it was 0"
                if bound is None
                else f"a change of up to {100 * bound:.2g} % would not be seen"
            )
        out[i] = replace(c, p_value=p[i], p_adjusted=running, status=status, reason=reason, bound=bound)
    return out


def _covariance(model: Model, names: Sequence[str]) -> Float64:
    """Covariance of named linear parameters: the joint one where the model has it, else diagonal."""
    stds = _stds(model)
    spread = np.array([stds.get(n, math.nan) for n in names])
    result: Float64 = np.diag(spread**2)
    joint = model.covariance
    if joint is None or joint.shape != (len(model.parameter_names),) * 2:
        return result
    at = {n: k for k, n in enumerate(model.parameter_names)}
    known = [k for k, n in enumerate(names) if n in at]
    rows = [at[names[k]] for k in known]
    block = joint[np.ix_(rows, rows)]
    own = np.sqrt(np.clip(np.diag(block), 0, None))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = block / np.outer(own, own)
    # A model's std (which may carry more than the fit's own covariance) stays; correlation is added.
    scaled = correlation * np.outer(spread[known], spread[known])
    good = np.isfinite(scaled)
    target = result[np.ix_(known, known)]
    target[good] = scaled[good]
    np.fill_diagonal(target, spread[known] ** 2)
    result[np.ix_(known, known)] = target
    return result


def _stds(model: Model) -> dict[str, float]:
    """Standard deviation by the names of ``parameter_vector``."""
    out: dict[str, float] = {}
    for i, axis in enumerate(model.axes):
        for kind, column in (
            ("mass", model.std.masses[i]),
            ("spring", model.std.springs[i]),
            ("damper", model.std.dampers[i]),
        ):
            out.update({f"{axis}.{kind}.{q + 1}": float(s) for q, s in enumerate(column)})
        out[f"{axis}.ground_spring"] = float(model.std.ground_springs[i])
    for i, first in enumerate(model.axes):
        for j in range(i + 1, len(model.axes)):
            second, value = model.axes[j], float(model.std.couplings[i, j])
            out[f"{first}-{second}.coupling"] = out[f"{second}-{first}.coupling"] = value
    return out


def _joint(
    old: Model, new: Model, changes: Sequence[Change], repeatability: float
) -> tuple[float | None, int]:
    """p of "nothing at all changed" by the joint covariance, and its degrees of freedom."""
    used = [c for c in changes if c.std is not None and c.kind != "inertia"]
    if not used:
        return None, 0
    names = [c.name for c in used]
    covariance = _covariance(old, names) + _covariance(new, names)
    extra = [repeatability**2 * (c.old.value**2 + c.new.value**2) if c.old and c.new else 0.0 for c in used]
    covariance = covariance + np.diag(extra)
    spread = np.sqrt(np.diag(covariance))
    if not np.isfinite(covariance).all() or (spread <= 0).any():
        return None, 0
    values, vectors = np.linalg.eigh(covariance / np.outer(spread, spread))
    # Directions whose variance is rounding error of the others' carry no information.
    keep = values > len(names) * np.finfo(float).eps * 1e3 * values[-1]
    along = vectors[:, keep].T @ (np.array([c.difference for c in used], dtype=float) / spread)
    statistic = float((along**2 / values[keep]).sum())
    return chi2_sf(statistic, int(keep.sum())), int(keep.sum())


# --- words -----------------------------------------------------------------------------------------
def _sentences(c: Comparison) -> tuple[str, ...]:
    everything = c.parameters + c.effects
    changed = [x for x in everything if x.status is Status.CHANGED]
    unchanged = [x for x in everything if x.status is Status.UNCHANGED]
    open_ones = [x for x in everything if x.status is Status.CANNOT_TELL]
    said = interpret(changed, c.parameters, c.tolerance)
    said += list(c.structure)
    spread_out = c.joint_p is not None and c.joint_p < c.alpha and not changed
    if spread_out:
        said.append(
            f"Something changed (joint test, p = {c.joint_p:.1g}), but the data cannot tell which parameter: "
            "the uncertainties of several go together. A longer measurement would."
        )
    told = bool(changed or c.structure or spread_out)
    if unchanged:
        worst = 100 * max(x.bound or 0.0 for x in unchanged)
        if not open_ones and not spread_out:
            said.append(
                f"Nothing {'else ' if told else ''}changed: {_all(len(unchanged))} within ±{worst:.2g} %."
            )
        else:
            said.append(f"{_count(len(unchanged))} unchanged within ±{worst:.2g} %.")
    if open_ones:
        said.append(f"Cannot tell for {_listing([x.label for x in open_ones])}: {_reasons(open_ones)}.")
    return tuple(said)


def _all(count: int) -> str:
    return "the one other parameter is the same" if count == 1 else f"all {count} parameters are the same"


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
        said.append(
            f"changes of up to {100 * min(bounds):.2g} to {100 * max(bounds):.2g} % would not be seen"
            if len(bounds) > 1
            else f"a change of up to {100 * bounds[0]:.2g} % would not be seen"
        )
    return "; ".join(said)
