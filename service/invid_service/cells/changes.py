"""What changed between two models of one cell: a test over all parameters at once.

The difference Δ of the two parameter vectors has covariance D = λ²(C₁ + C₂): the joint covariances of
the two fits, inflated by the repeatability λ that this cell's own history shows. Parameters of one fit
are strongly correlated, so looking at them one by one would see little and name the neighbours of what
changed. Instead the smallest set of changes that explains Δ is built up, one parameter at a time: each
step tests every remaining parameter with those already found fitted (a generalised least-squares score
test), and takes the best if it is significant after Holm's correction over all of them. A rival that
explains the difference about as well is never ruled out in silence: both are then "cannot tell".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from scipy.special import ndtr, ndtri  # scipy.stats takes seconds to load, and this is all it would do

from invid.arrays import Float64
from invid.model import Model, parameter_vector, units

FALSE_ALARMS = 0.01
"""Family-wise rate over all parameters of one comparison (half of the 2 % asked of the service: the
covariances are estimates themselves)."""
_RIVAL = float(ndtri(0.995)) ** 2
"""A rival whose χ² is no worse than this below the best is not ruled out: 6.6, a likelihood ratio of 28."""
_TWO_SIDED_95 = float(ndtri(0.975))
_RIDGE = 1e-9
"""On the correlation matrix: below it a direction is rounding of the fit, not information."""
MINIMUM_PAIRS = 2

Verdict = Literal["changed", "unchanged", "cannot_tell"]


@dataclass(frozen=True)
class ParameterChange:
    """One parameter in both models and what can be said of it."""

    name: str
    unit: str
    verdict: Verdict
    old: float | None
    old_std: float | None
    new: float | None
    new_std: float | None
    difference: float | None = None
    difference_std: float | None = None
    within_percent: float | None = None
    """"unchanged": a change beyond ±this would have been seen (95 %)."""
    reason: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        axis, _, rest = self.name.partition(".")
        return {
            "parameter": self.name,
            "axis": axis,
            "kind": rest.split(".")[0],
            "unit": self.unit,
            "status": self.verdict,
            "from": {"value": self.old, "std": self.old_std},
            "to": {"value": self.new, "std": self.new_std},
            "difference": self.difference,
            "difference_std": self.difference_std,
            "within_percent": self.within_percent,
            "reason": self.reason,
        }


@dataclass(frozen=True)
class Changes:
    """All parameters, and the sentences for a person."""

    parameters: tuple[ParameterChange, ...]
    sentence: str
    repeatability: float
    """λ: how much more this cell varies from run to run than the fits' covariances say; at least 1."""
    repeatability_pairs: int
    warnings: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "sentence": self.sentence,
            "parameters": [p.to_json() for p in self.parameters],
            "false_alarm_rate": FALSE_ALARMS,
            "repeatability": {"factor": self.repeatability, "pairs": self.repeatability_pairs},
            "warnings": list(self.warnings),
        }


def _values(model: Model) -> dict[str, float]:
    names, values = parameter_vector(model.chains)
    return dict(zip(names, values.tolist(), strict=True))


def _stds(model: Model) -> dict[str, float]:
    found: dict[str, float] = {}
    std, axes = model.std, model.axes
    for i, axis in enumerate(axes):
        for kind, column in (("mass", std.masses), ("spring", std.springs), ("damper", std.dampers)):
            found.update({f"{axis}.{kind}.{q + 1}": float(v) for q, v in enumerate(column[i])})
        found[f"{axis}.ground_spring"] = float(std.ground_springs[i])
        for j in range(i + 1, len(axes)):
            found[f"{axis}-{axes[j]}.coupling"] = float(std.couplings[i, j])
    return found


def _covariance(model: Model, names: Sequence[str]) -> Float64:
    """Covariance of ``names``: joint where the model has it, else from the standard deviations."""
    stds = _stds(model)
    matrix: Float64 = np.diag([stds[n] ** 2 for n in names])
    if model.covariance is not None:
        rows = {n: k for k, n in enumerate(model.parameter_names)}
        inside = [(i, rows[n]) for i, n in enumerate(names) if n in rows]
        if inside:
            own, joint = zip(*inside, strict=True)
            block = np.asarray(model.covariance)[np.ix_(joint, joint)]
            if np.isfinite(block).all() and (np.diag(block) > 0).all():
                matrix[np.ix_(own, own)] = block
    return matrix


def _testable(*models: Model) -> list[str]:
    """Names in all models with a standard deviation in each."""
    first = _values(models[0])
    return [
        n
        for n in first
        if all(n in _values(m) and np.isfinite(s := _stds(m).get(n, np.nan)) and s > 0 for m in models)
    ]


class _Whitened:
    """Δ and the unit vectors of the parameters, in coordinates where the noise is white."""

    def __init__(self, old: Model, new: Model, names: Sequence[str], factor: float) -> None:
        was, now = _values(old), _values(new)
        self.delta = np.array([now[n] - was[n] for n in names])
        covariance = factor**2 * (_covariance(old, names) + _covariance(new, names))
        self.std = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(self.std, self.std) + _RIDGE * np.eye(len(names))
        lower = np.linalg.cholesky(correlation)
        self.columns: Float64 = np.asarray(np.linalg.solve(lower, np.eye(len(names))), dtype=np.float64)
        self.data: Float64 = np.asarray(np.linalg.solve(lower, self.delta / self.std), dtype=np.float64)

    @property
    def chi2_per_parameter(self) -> float:
        """About 1 where nothing changed and the covariance is right."""
        return float(self.data @ self.data) / self.data.size

    def scores(self, chosen: Sequence[int]) -> Float64:
        """Signed z of every parameter with ``chosen`` fitted; 0 for those that are chosen."""
        columns, residual = self.columns, self.data
        if chosen:
            basis, _ = np.linalg.qr(self.columns[:, list(chosen)])
            residual = residual - basis @ (basis.T @ residual)
            columns = columns - basis @ (basis.T @ columns)
        length = np.linalg.norm(columns, axis=0)
        seen = length > 1e-6 * np.linalg.norm(self.columns, axis=0)
        z: Float64 = np.where(seen, columns.T @ residual / np.where(seen, length, 1.0), 0.0)
        z[list(chosen)] = 0.0
        return z

    def sizes(self, chosen: Sequence[int]) -> tuple[Float64, Float64]:
        """Changes of ``chosen`` with everything else unchanged, and their standard deviations."""
        basis = self.columns[:, list(chosen)]
        inverse = np.linalg.pinv(basis.T @ basis)
        size = inverse @ basis.T @ self.data
        scale = self.std[list(chosen)]
        return size * scale, np.sqrt(np.diag(inverse)) * scale


def repeatability(
    history: Sequence[Model], *, spanning: tuple[Model, Model] | None = None
) -> tuple[float, int]:
    """λ and the number of pairs of consecutive models behind it.

    The median over pairs: a change of tool in a minority of them does not count as bad repeatability.
    ``spanning``: the two models being compared; what lies between them says nothing about repeating.
    """
    ratios = []
    inside = False
    for old, new in pairwise(history):
        if spanning is not None:
            inside = (inside or old in spanning) and not (inside and old in spanning)
        names = _testable(old, new)
        if inside or not names:
            continue
        try:
            ratios.append(_Whitened(old, new, names, 1.0).chi2_per_parameter)
        except np.linalg.LinAlgError:
            continue
    if len(ratios) < MINIMUM_PAIRS:
        return 1.0, len(ratios)
    return max(1.0, float(np.sqrt(np.median(ratios)))), len(ratios)


def compare_models(
    old: Model,
    new: Model,
    *,
    history: Sequence[Model] = (),
    unchanged_percent: float = 20.0,
    false_alarms: float = FALSE_ALARMS,
) -> Changes:
    """Every parameter of the two models: changed, unchanged within ±x %, or cannot tell."""
    factor, pairs = repeatability(history, spanning=(old, new))
    warnings: list[str] = []
    if pairs < MINIMUM_PAIRS:
        warnings.append(
            f"repeatability of this cell is not known yet ({pairs} earlier pair(s) of runs, "
            f"{MINIMUM_PAIRS} needed): the test rests on the covariance of the two fits alone"
        )
    names = _testable(old, new)
    chosen: list[int] = []
    rivals: dict[int, list[int]] = {}
    white: _Whitened | None = None
    if names:
        try:
            white = _Whitened(old, new, names, factor)
            chosen, rivals = _select(white, false_alarms)
        except np.linalg.LinAlgError:
            warnings.append("the joint covariance is not positive definite: nothing can be told")
            names = []
    parameters = _judge(old, new, names, white, chosen, rivals, unchanged_percent)
    return Changes(tuple(parameters), _sentence(parameters, new), factor, pairs, tuple(warnings))


def _select(white: _Whitened, false_alarms: float) -> tuple[list[int], dict[int, list[int]]]:
    count = white.data.size
    chosen: list[int] = []
    rivals: dict[int, list[int]] = {}
    while len(chosen) < count:
        z = white.scores(chosen)
        best = int(np.argmax(np.abs(z)))
        if 2 * ndtr(-abs(z[best])) * (count - len(chosen)) > false_alarms:
            break
        rivals[best] = [
            k for k in range(count) if k != best and k not in chosen and z[k] ** 2 > z[best] ** 2 - _RIVAL
        ]
        chosen.append(best)
    return chosen, rivals


def _judge(
    old: Model,
    new: Model,
    names: Sequence[str],
    white: _Whitened | None,
    chosen: list[int],
    rivals: dict[int, list[int]],
    unchanged_percent: float,
) -> list[ParameterChange]:
    was, now, was_std, now_std = _values(old), _values(new), _stds(old), _stds(new)
    kinds = units(new.linear)
    size: dict[int, tuple[float, float]] = {}
    if white is not None and chosen:
        values, stds = white.sizes(chosen)
        size = {k: (float(v), float(s)) for k, v, s in zip(chosen, values, stds, strict=True)}
    # A rival that a later step found changed in its own right is no rival any more.
    doubtful = {
        k: [names[other] for other in {best, *others} if other != k]
        for best, others in rivals.items()
        for k in [best, *[o for o in others if o not in chosen]]
        if any(o not in chosen for o in others)
    }
    result = []
    for name in dict.fromkeys([*was, *now]):
        kind = name.split(".")[1]
        unit = kinds[
            {"spring": "stiffness", "ground_spring": "stiffness", "damper": "damping"}.get(kind, "mass")
        ]
        a, b = was.get(name), now.get(name)
        base = (
            a,
            _none(was_std.get(name)) if a is not None else None,
            b,
            _none(now_std.get(name)) if b is not None else None,
        )
        if white is None or name not in names:
            reason = (
                "not in both models"
                if a is None or b is None
                else "the data of one of the two runs do not determine it"
            )
            result.append(ParameterChange(name, unit, "cannot_tell", *base, reason=reason))
            continue
        k = list(names).index(name)
        delta, spread = float(white.delta[k]), float(white.std[k])
        if k in doubtful:
            reason = f"this or {' or '.join(sorted(doubtful[k]))} changed; the data do not separate them"
            result.append(ParameterChange(name, unit, "cannot_tell", *base, delta, spread, reason=reason))
        elif k in size:
            result.append(ParameterChange(name, unit, "changed", *base, *size[k]))
        else:
            reference = max(abs(a or 0.0), 1e-300)
            within = 100.0 * (abs(delta) + _TWO_SIDED_95 * spread) / reference
            if within <= unchanged_percent:
                result.append(ParameterChange(name, unit, "unchanged", *base, delta, spread, within))
            else:
                reason = f"a change of up to {_percent(within)} could have gone unseen"
                result.append(
                    ParameterChange(name, unit, "cannot_tell", *base, delta, spread, within, reason)
                )
    return result


def _none(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else value


def _percent(value: float) -> str:
    return f"{value:.2g} %" if value < 100 else f"{value:.0f} %" if value < 1e4 else "any size"


def spoken(name: str, model: Model) -> str:
    """``A2.mass.3`` as a person says it: "A2: final mass"."""
    axis, _, rest = name.partition(".")
    kind, _, place = rest.partition(".")
    if kind == "coupling":
        return f"{axis}: inertia coupling"
    if kind == "ground_spring":
        return f"{axis}: spring to ground"
    if kind == "mass" and axis in model.axes:
        last = model.chains.masses_per_branch[model.axes.index(axis)]
        if place == str(last) and last > 1:
            return f"{axis}: final mass"
    return f"{axis}: {kind} {place}"


def _number(value: float, std: float) -> str:
    digits = int(np.clip(1 - np.floor(np.log10(std)), 0, 8)) if std > 0 else 3
    return f"{value:.{digits}f}"


def _sentence(parameters: Sequence[ParameterChange], model: Model) -> str:
    changed = [p for p in parameters if p.verdict == "changed"]
    unsure = [p for p in parameters if p.verdict == "cannot_tell"]
    separate = [p for p in unsure if p.reason and p.reason.startswith("this or ")]
    rest = "Nothing else changed." if changed else "Nothing changed."
    if len(unsure) > len(separate):
        count = len(unsure) - len(separate)
        rest = (
            rest[:-1] + f" as far as the data tell ({count} of {len(parameters)} parameters cannot be told)."
        )
    parts = []
    for p in changed:
        difference, std = p.difference or 0.0, p.difference_std or 0.0
        sign = "+" if difference >= 0 else "−"
        parts.append(
            f"{spoken(p.name, model)} {_number(p.old or 0.0, std)} → {_number(p.new or 0.0, std)} {p.unit} "
            f"({sign}{_number(abs(difference), std)} ± {_number(std, std)})"
        )
    if separate:
        names = ", ".join(spoken(p.name, model) for p in separate)
        parts.append(f"one of these changed, the data do not tell which: {names}")
    if not parts:
        return rest
    ends = [p for p in changed if _at_the_end(p.name, model)]
    tool = changed and len(ends) == len(changed) and not separate
    return "; ".join(parts) + (": consistent with a tool change. " if tool else ". ") + rest


def _at_the_end(name: str, model: Model) -> bool:
    return "final mass" in spoken(name, model) or name.endswith(".coupling")
