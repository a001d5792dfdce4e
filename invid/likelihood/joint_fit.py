"""Levenberg–Marquardt over the linear parameters and the effects together, within bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from invid.effects.motion import View
from invid.likelihood.covariance import inverse_normal
from invid.likelihood.evaluation import Evaluation, add_jacobian, evaluate
from invid.likelihood.hypothesis import Layout
from invid.likelihood.nuisance.hold_share import SHARES
from invid.likelihood.placed_effect import Candidate
from invid.numerics.arrays import Bool, Float64
from invid.numerics.levenberg_marquardt import Parabola, minimise
from invid.signals.spectral_record import SpectralRecord


@dataclass(frozen=True, eq=False)
class JointFit:
    """A fit of the linear parameters and the effects of ``candidate``."""

    layout: Layout
    p: Float64
    candidate: Candidate
    evaluation: Evaluation
    covariance: Float64
    converged: bool

    @property
    def cost(self) -> float:
        """χ² of the training records."""
        return self.evaluation.cost

    @property
    def dof(self) -> int:
        """Degrees of freedom."""
        return max(self.evaluation.dof - self.layout.count - sum(t.size for t in self.candidate.terms), 1)

    @property
    def dispersion(self) -> float:
        """χ²/ν, at least 1."""
        return max(1.0, self.cost / self.dof)

    @property
    def is_stuck(self) -> Bool:
        """(n,) parameters at a bound whose gradient points outwards."""
        low, high = parameter_bounds(self.layout, self.candidate, self.evaluation, strict=True)
        return _is_stuck(pack(self.p, self.candidate), low, high, self.evaluation)

    def covariance_of(self, number: int) -> Float64:
        """(k, k) covariance of the parameters of one effect; negative numbers count from the last."""
        ends = self.layout.count + np.cumsum([t.size for t in self.candidate.terms])
        part = slice(int(ends[number]) - self.candidate.terms[number].size, int(ends[number]))
        return self.covariance[part, part]


def parameter_bounds(
    layout: Layout, candidate: Candidate, evaluation: Evaluation, strict: bool
) -> tuple[Float64, Float64]:
    """Bounds of all parameters; ``strict``: time offsets within a sample."""
    low, high = np.full(layout.count, -np.inf), np.full(layout.count, np.inf)
    damper = layout.structure.slices["damper"]
    low[damper] = 0.0
    at = layout.structure.count
    if strict:  # up to one sample is sampling convention; more is a finding
        low[at : at + len(layout.free_delays)] = -1.0 * layout.step
        high[at : at + len(layout.free_delays)] = 1.0 * layout.step
    low[layout.zoh_slice], high[layout.zoh_slice] = -0.5, 1.5
    low[layout.hold_slice], high[layout.hold_slice] = SHARES
    low[layout.lag_slice] = 0.0
    for term in candidate.terms:
        shapes = term.effect.limits(evaluation.views, term.place)
        low = np.concatenate((low, term.effect.lower, [s[0] for s in shapes]))
        high = np.concatenate((high, term.effect.upper, [s[1] for s in shapes]))
    return low, high


def pack(p: Float64, candidate: Candidate) -> Float64:
    """(n,) parameters of the layout, then of the effects."""
    return np.concatenate((p, *candidate.x)) if candidate.x else p.copy()


def unpack(layout: Layout, candidate: Candidate, v: Float64) -> tuple[Float64, Candidate]:
    """Parameters of the layout and effects from a vector of ``pack``."""
    at, xs = layout.count, []
    for term in candidate.terms:
        xs.append(v[at : at + term.size].copy())
        at += term.size
    return v[: layout.count].copy(), Candidate(candidate.terms, tuple(xs))


def fit(  # noqa: PLR0913 - a fit's point and how it is taken
    layout: Layout,
    records: Sequence[SpectralRecord],
    p: Float64,
    candidate: Candidate,
    *,
    iterations: int = 30,
    tolerance: float = 1e-2,
    strict: bool = True,
    quick: bool = False,
    known: Evaluation | None = None,
    near: Sequence[View] = (),
) -> JointFit:
    """The joint fit from ``p`` (n,); converged when the predicted decrease of χ² is below ``tolerance``·χ²/ν.

    ``quick``: with a Jacobian that takes the effects' forces on inner masses as given. ``known``: the
    evaluation at the start, if there is one; ``near``: views of the records close by, whose inner motion is
    the start (a law as strong as a spring has several, and from rest another may be found, or none).
    """
    structure, thorough = layout.structure, not quick
    if known is None:
        known = evaluate(layout, records, p, candidate, jacobian=False, near=near)
    low, high = parameter_bounds(layout, candidate, known, strict)
    v = np.clip(pack(p, candidate), low, high)
    if not np.array_equal(v, pack(p, candidate)):
        p, candidate = unpack(layout, candidate, v)
        known = evaluate(layout, records, p, candidate, jacobian=False, near=near)
    limited = np.zeros(v.size, dtype=bool)
    limited[: structure.count] = structure.logarithmic
    at = layout.count
    for term in candidate.terms:
        count = len(term.effect.coefficients)
        limited[at + count : at + term.size] = term.effect.logarithmic
        at += term.size

    def parabola(here: _Point) -> Parabola:
        around = here.derive(layout, thorough=thorough)
        return Parabola.of_rows(around.jacobian, around.residual, ~_is_stuck(here.v, low, high, around))

    def take_step(here: _Point, step: Float64, limit: float) -> _Point | None:
        trial = np.clip(here.v + step, low, high)
        p, candidate = unpack(layout, here.candidate, trial)
        if not structure.admissible(p[: structure.count]):
            return None
        with np.errstate(all="ignore"):
            try:
                there = evaluate(
                    layout, records, p, candidate, jacobian=False, near=here.evaluation.views, limit=limit
                )
            except np.linalg.LinAlgError:
                return None
        return None if there.cost > limit else _Point(trial, p, candidate, there)

    found = minimise(
        _Point(v, p, candidate, known),
        parabola,
        take_step,
        limited=limited,
        iterations=iterations,
        dof=known.dof,
        tolerance=tolerance,
        gain=0.1 * tolerance,
    )
    last = found.point
    here = last.derive(layout, thorough=thorough)
    return JointFit(
        layout, last.p, last.candidate, here, _covariance(here, last.v), found.result == "converged"
    )


@dataclass(eq=False)
class _Point:
    """A point of the search; its Jacobian is computed on demand, for accepted points only."""

    v: Float64
    p: Float64
    candidate: Candidate
    evaluation: Evaluation
    derived: bool = field(default=False, init=False)

    @property
    def cost(self) -> float:
        """χ²."""
        return self.evaluation.cost

    def derive(self, layout: Layout, *, thorough: bool) -> Evaluation:
        """The evaluation with its Jacobian."""
        if not self.derived:
            self.evaluation = add_jacobian(self.evaluation, layout, self.p, self.candidate, thorough=thorough)
            self.derived = True
        return self.evaluation


def reorder_effects(found: JointFit, order: Sequence[int]) -> JointFit:
    """The same fit with its effects in another order."""
    candidate, count = found.candidate, found.layout.count
    ends = count + np.cumsum([t.size for t in candidate.terms])
    at = [np.arange(ends[k] - candidate.terms[k].size, ends[k]) for k in order]
    columns = np.concatenate((np.arange(count), *at))
    jacobian = found.evaluation.jacobian[:, columns] if found.evaluation.jacobian.size else np.zeros((0, 0))
    return replace(
        found,
        candidate=candidate.only(order),
        covariance=found.covariance[np.ix_(columns, columns)],
        evaluation=replace(found.evaluation, jacobian=jacobian),
    )


def drop_last_effect(found: JointFit, records: Sequence[SpectralRecord]) -> JointFit:
    """The fit without its last effect; the axis of a delay gets its time offset back."""
    layout, p, term = found.layout, found.p, found.candidate.terms[-1]
    if term.effect.cause == "torque_delay":
        layout = layout.with_delay(term.place.axis)
        p = np.insert(p, layout.structure.count + layout.free_delays.index(term.place.axis), 0.0)
    candidate = found.candidate.only(range(len(found.candidate.terms) - 1))
    return fit(layout, records, p, candidate, iterations=25)


def _is_stuck(v: Float64, low: Float64, high: Float64, here: Evaluation) -> Bool:
    """(n,) whether a parameter is at a bound and its gradient points outwards."""
    gradient = here.jacobian.T @ here.residual
    return ((v <= low) & (gradient > 0)) | ((v >= high) & (gradient < 0))


def _covariance(here: Evaluation, v: Float64) -> Float64:
    """(n, n) covariance of all parameters; infinite where the data do not determine them.

    The larger, parameter by parameter, of two: that of the noise times χ²/ν > 1, and the sandwich over lines
    (White 1980), which is true also where a model that is not quite right leaves more on the few lines that
    the parameter is read from than on the rest.
    """
    out, lost = inverse_normal(here.jacobian)
    spread = max(1.0, here.cost / max(here.dof - v.size, 1))
    plain = np.diag(out) * spread
    robust = ((_line_scores(here) @ out) ** 2).sum(axis=0) * here.dof / max(here.dof - v.size, 1)
    wider = np.sqrt(np.maximum(robust / np.where(plain > 0, plain, np.inf), 1.0))
    out[lost, lost] = np.inf
    out *= spread * wider[:, None] * wider
    return out


def _line_scores(here: Evaluation) -> Float64:
    """(lines of all records, n) contribution of each line to half the gradient of the cost."""
    at, out = 0, []
    for view in here.views:
        lines, motors = view.acting.shape
        rows = slice(at, at + 2 * lines * motors)
        own = here.jacobian[rows] * here.residual[rows, None]
        out.append(own.reshape(2, lines, motors, -1).sum(axis=(0, 2)))
        at = rows.stop
    return np.concatenate(out)


def evaluate_held_out(
    fitted: JointFit,
    records: Sequence[SpectralRecord],
    candidate: Candidate | None = None,
    near: Sequence[View] = (),
) -> Evaluation:
    """The held-out records evaluated under a fit, nothing refitted; ``near``: as in ``fit``."""
    effects = fitted.candidate if candidate is None else candidate
    return evaluate(fitted.layout, records, fitted.p, effects, jacobian=False, near=near)
