"""Fit of plant, timing, laws and strengths together: Levenberg's steps with Fisher's information.

Strengths move as they are, not as logarithms: where the covariance is theirs alone Fisher's step is exact,
and one whose force is not there ends at its bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np

from invid.likelihood.unknown_forces.slope import Slope, slope, solve_scaled
from invid.likelihood.unknown_forces.value import Numbers, Problem, Value, bounded_minimum, evaluate
from invid.numerics import budget
from invid.numerics.arrays import Float64, Int64
from invid.wording.sentence import sentence

LARGEST_STEP = 0.7
"""Largest step of a number in one iteration: of a logarithm a factor of two."""
GAP = 0.3
"""Newton's decrement [−2 ln L] below which a fit is finished: a hundredth of the smallest price."""
TO_THE_END = 100
"""Most iterations of a fit that is to be finished."""
TO_END = sentence("fits to their end")
"""What a spent budget leaves out, in the words of the warning."""
LEAST_CURVATURE = 1e-3
"""Least curvature of numbers scaled to unit information (numerical): no saddle is stepped to."""
LEAST_FALL = 1e-2
"""Fall of an iteration below which nothing more is gained, whatever the slope says."""
BEYOND_PROMISE = 1.5
"""Fall over that promised from which a step is lengthened: two where the value has no curvature at all."""
PACE = 5
"""Iterations over which the pace of a fit is taken (empirical: falls of neighbours differ tenfold)."""
TRIALS = 8
FIRST, LESS, MORE, LEAST_DAMPING, RESTART = 1e-2, 0.2, 5.0, 1e-7, 1e-3
"""Damping of numbers scaled to unit curvature: at the start, its factors, its least, and where it begins
again."""


class Ended(Enum):
    """How a fit ended."""

    FINISHED = "finished"
    ITERATIONS = "iterations"
    """At the most iterations that it was given."""
    AT_BOUND = "at a bound"
    """Where a law's coefficient turns to its bound the value is bent, and least."""
    STALLED = "stalled"
    """No step lowers the value though its slope says so."""
    BEHIND = "behind"
    """At its pace it would not have come to what it had to beat."""
    CUT = "cut"
    """The time was up."""


@dataclass(frozen=True, eq=False)
class Fit:
    """The least value found, its slope there, how the steps ended, and the ``gap``: by how much −2 ln L may
    still fall (Newton's decrement over all numbers and strengths)."""

    problem: Problem
    value: Value
    slope: Slope
    ended: Ended
    gap: float

    @property
    def is_finished(self) -> bool:
        """Whether something may be concluded from its value."""
        return self.ended in (Ended.FINISHED, Ended.AT_BOUND)

    @property
    def open_gap(self) -> float:
        """By how much −2 ln L may still fall, none where the fit is finished."""
        return 0.0 if self.is_finished else self.gap

    @property
    def total(self) -> float:
        """−2 ln L."""
        return self.value.total

    @property
    def numbers(self) -> Numbers:
        """The numbers found."""
        return self.value.numbers

    @cached_property
    def covariance(self) -> Float64:
        """(p, p) covariance of the numbers as they move."""
        return solve_scaled(self.slope.curvature, np.eye(self.slope.curvature.shape[0]))


def fit(problem: Problem, start: Numbers, iterations: int = TO_THE_END, target: float = np.inf) -> Fit:
    """The least −2 ln L from ``start``; given up where it would not come to ``target`` at its pace.

    Raises
    ------
    LinAlgError
        No value at the start.
    """
    now = evaluate(problem, start)
    here, damping = _Here.start(problem, now), FIRST
    totals = [now.total]
    for number in range(iterations + 1):
        gap = here.fall(here.step(0.0))
        if 0.0 <= gap < GAP:
            return Fit(problem, here.value, here.around, Ended.FINISHED, gap)
        if number == iterations:
            break
        if _is_behind(totals, iterations - number, target):
            return Fit(problem, here.value, here.around, Ended.BEHIND, gap)
        if budget.is_left_out(TO_END):
            return Fit(problem, here.value, here.around, Ended.CUT, gap)
        found, damping = here.lower(problem, damping)
        if not found.total < here.value.total - LEAST_FALL:
            is_bent = bool((found.free != here.value.free).any())
            return Fit(problem, here.value, here.around, Ended.AT_BOUND if is_bent else Ended.STALLED, gap)
        here = here.at(problem, found)
        totals.append(found.total)
    return Fit(problem, here.value, here.around, Ended.ITERATIONS, gap)


def _is_behind(totals: Sequence[float], more: int, target: float) -> bool:
    """Whether as many iterations ``more``, each falling as the last few did, would not come to ``target``:
    falls become smaller."""
    if len(totals) <= PACE:
        return False
    return totals[-1] - more * (totals[-1 - PACE] - totals[-1]) / PACE > target


@dataclass(frozen=True, eq=False)
class _Here:
    """A value with all that may move from it (k,): numbers, then strengths that are not held at their bound.

    Attributes
    ----------
    beyond
        (N, N) what the curvature by all numbers and strengths has beside Fisher's information, learnt from
        how the gradient moved.
    is_bent
        Whether the value fell more as with it than as by information alone, which then is no curvature.
    """

    value: Value
    around: Slope
    least: float
    beyond: Float64
    is_bent: bool = False

    @classmethod
    def start(cls, problem: Problem, value: Value) -> _Here:
        """Where nothing is learnt yet."""
        size = value.numbers.x.size + value.numbers.strength.size
        return cls(value, slope(problem, value), problem.least, np.zeros((size, size)))

    def at(self, problem: Problem, value: Value) -> _Here:
        """After a step to a lower value: the structured secant update of Dennis, Gay and Welsch (NL2SOL,
        1981), with its sizing and its choice between two models."""
        around = slope(problem, value)
        new = _Here(value, around, self.least, np.zeros_like(self.beyond))
        fell, step = self.value.total - value.total, _whole(value.numbers) - _whole(self.value.numbers)
        own = step[self.moving]
        plain = -2.0 * self.gradient[self.moving] @ own - own @ self.around.whole @ own
        bent = plain - own @ self.beyond[np.ix_(self.moving, self.moving)] @ own
        is_bent = bool(abs(bent - fell) < abs(plain - fell))
        step, turned = step[new.moving], (new.gradient - self.gradient)[new.moving]
        at = np.ix_(new.moving, new.moving)
        known, wanted = self.beyond[at] @ step, turned - around.whole @ step
        size = min(1.0, abs(float(step @ wanted)) / max(abs(float(step @ known)), 1e-300))
        new.beyond[at] = size * self.beyond[at]
        along = float(turned @ step)
        if along > 0.0:
            missed, turned = wanted - size * known, turned / along
            cross = np.outer(missed, turned)
            new.beyond[at] += cross + cross.T - float(missed @ step) * np.outer(turned, turned)
        return replace(new, is_bent=is_bent)

    @cached_property
    def moving(self) -> Int64:
        """(k,) which of all numbers and strengths may move."""
        size = self.value.numbers.x.size
        return np.concatenate((np.arange(size), size + self.around.moving))

    @cached_property
    def gradient(self) -> Float64:
        """(N,) half the gradient by all numbers and strengths."""
        return np.concatenate((self.around.gradient, self.around.pull.ravel()))

    @cached_property
    def curvature(self) -> Float64:
        """(k, k) of what moves, positive."""
        if not self.is_bent:
            return self.around.whole
        out = self.around.whole + self.beyond[np.ix_(self.moving, self.moving)]
        unit = np.sqrt(np.diag(self.around.whole))
        least = float(np.linalg.eigvalsh(out / unit[:, None] / unit)[0])
        return np.asarray(out + max(0.0, LEAST_CURVATURE - least) * np.diag(unit**2), dtype=np.float64)

    def step(self, damping: float) -> Float64:
        """(k,) of what moves, strengths within their bounds."""
        damped = self.curvature + damping * np.diag(np.diag(self.around.whole))
        numbers = self.value.numbers
        room = (self.least - numbers.strength).ravel()[self.around.moving]
        low = np.concatenate((np.full(numbers.x.size, -np.inf), room))
        return bounded_minimum(damped, self.gradient[self.moving], (low, np.full(low.size, np.inf)))[0]

    def fall(self, step: Float64) -> float:
        """Fall of −2 ln L that a step promises."""
        return float(-2.0 * self.gradient[self.moving] @ step - step @ self.curvature @ step)

    def lower(self, problem: Problem, damping: float) -> tuple[Value, float]:
        """A lower value, where one is found, else the last tried; and the damping for the next step."""
        last = self.value
        size = self.value.numbers.x.size
        for _ in range(TRIALS):
            step = self.step(damping)
            step = step * min(1.0, LARGEST_STEP / max(float(np.abs(step[:size]).max()), 1e-300))
            numbers = self._moved(step)
            if numbers.plant.is_admissible():
                with suppress(np.linalg.LinAlgError):
                    last = evaluate(problem, numbers)
                if last.total < self.value.total:
                    return self._longer(problem, last, step), max(damping * LESS, LEAST_DAMPING)
            damping = max(damping * MORE, RESTART)
        return last, damping

    def _longer(self, problem: Problem, found: Value, step: Float64) -> Value:
        """The lowest value along a step that fell by far more than it promised: there is no curvature."""
        size = self.value.numbers.x.size
        while self.value.total - found.total > BEYOND_PROMISE * self.fall(step):
            step = 2.0 * step
            numbers = self._moved(step)
            if np.abs(step[:size]).max() > LARGEST_STEP or not numbers.plant.is_admissible():
                break
            try:
                longer = evaluate(problem, numbers)
            except np.linalg.LinAlgError:
                break
            if longer.total >= found.total:
                break
            found = longer
        return found

    def _moved(self, step: Float64) -> Numbers:
        now, size = self.value.numbers, self.value.numbers.x.size
        strength = now.strength.copy()
        strength.flat[self.around.moving] += step[size:]
        return replace(now.moved(now.x + step[:size]), strength=np.maximum(strength, self.least))


def _whole(numbers: Numbers) -> Float64:
    return np.concatenate((numbers.x, numbers.strength.ravel()))
