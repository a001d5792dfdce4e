"""Runs that end when they know: how long those of the default plan are, what they tell so far, and who judges
by it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from invid.config import CellConfig, MultisineSpec
from invid.errors import InputError, NotIdentifiableError
from invid.identification.identify import Masses, identify
from invid.identification.kept_out import all_records
from invid.identification.search_start import settled_about
from invid.model.document import Model, parameter_vector
from invid.planning.belief import Belief
from invid.planning.build import DEFAULT, make_plan
from invid.planning.detection import DetectionLimit, detection_limits, limits_at
from invid.planning.expected_covariance import Noise, expected, is_in_goal, parameter_scale
from invid.recording import Recording

RUNS_S = (5.0, 6.5, 8.0)
"""Lengths of a run that are tried before that of the default plan, the longest: with it three axes take a
minute."""
UNCERTAINTY = 0.01
"""Expected relative deviation of every mass, spring and coupling after a default plan."""

Judge = Callable[[Recording], bool]
"""Says after each experiment but the last whether a recording needs another one; the next experiment goes on
meanwhile."""


def shortest_runs(config: CellConfig, belief: Belief, noise: Noise) -> MultisineSpec:
    """The shortest runs of the default plan that are expected to tell every parameter to ``UNCERTAINTY`` and
    to show the sizes of interest; those of the default plan where none is."""
    for length in RUNS_S:
        spec = DEFAULT.model_copy(update={"period_s": length})
        plan = make_plan(config.model_copy(update={"experiments": [spec]}), model=belief)
        limits = detection_limits(config, plan.recorded, belief, noise)
        shows = all(limit.is_met for limit in limits)
        if shows and expected(config, plan, belief, noise).worst[1] <= UNCERTAINTY:
            return spec
    return DEFAULT


@dataclass(frozen=True)
class Reached:
    """How well the records so far tell the parameters, and causes of the sizes of interest."""

    worst: str
    relative: float
    """Relative standard deviation of the worst mass, spring or coupling; infinite where one is not seen."""
    trustworthy: bool
    reason: str = ""
    limits: tuple[DetectionLimit, ...] = ()
    """Empty where nobody asks for causes."""

    @property
    def shown(self) -> int:
        """Causes that the records would show at their size of interest."""
        return sum(limit.is_met for limit in self.limits)

    @property
    def sentence(self) -> str:
        """What is known so far, in words."""
        if not (self.worst and self.trustworthy):
            return self.reason
        causes = f"; {self.shown} of {len(self.limits)} causes would show at their size of interest"
        return f"{self.worst} at {self.relative:.2g}{causes * bool(self.limits)}"

    def meets(self, goal: float) -> bool:
        """Whether they reach the goal, a relative standard deviation, and show every cause asked for."""
        return self.trustworthy and self.relative <= goal and self.shown == len(self.limits)


def reached(recording: Recording, masses: Masses = None, *, interests: CellConfig | None = None) -> Reached:
    """Identify the records so far; data that carry no model yet are a reason to go on, not an error.

    ``interests``: whose sizes of interest the records are asked for; ``None``: parameters alone.
    """
    try:
        model: Model = identify(recording, masses=masses)
    except (NotIdentifiableError, InputError) as error:
        return Reached("", float("inf"), False, str(error))
    names, _ = parameter_vector(model.chains)
    if model.covariance is None:
        return Reached("", float("inf"), False, "; ".join(model.warnings[:2]))
    place = {n: k for k, n in enumerate(model.parameter_names)}
    std = np.sqrt(np.maximum(np.diag(model.covariance), 0.0))[[place[n] for n in names]]
    relative = np.where(is_in_goal(names), std / parameter_scale(model.chains), 0.0)
    at = int(np.argmax(relative))
    trusted = bool(model.fit.get("trustworthy", True))
    reason = "" if trusted else "; ".join(model.warnings[:2])
    limits: tuple[DetectionLimit, ...] = ()
    if interests is not None:
        bare = replace(model.chains, ground_dampers=np.zeros(model.chains.branches))
        limits = limits_at(interests, settled_about(bare, all_records(recording)), recording)
    return Reached(names[at], float(relative[at]), trusted, reason, limits)


def judge_of(config: CellConfig, tell: Callable[[Reached], None] | None = None) -> Judge | None:
    """Who ends the default plan as soon as every parameter is known to 1 % and every cause of interest would
    show, worked out while the next run moves; ``None`` where the config asks for experiments of its own."""

    def needs_more(recording: Recording) -> bool:
        found = reached(recording, interests=config)
        if tell is not None and found.worst:
            tell(found)
        return not found.meets(UNCERTAINTY)

    return None if config.experiments else needs_more
