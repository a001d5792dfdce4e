"""What a comparison of two models consists of: ``Change`` of one parameter, ``Comparison`` of all."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from invid.diagnosis.headline import changes_headline
from invid.model.document import Estimate
from invid.model.named_change import NamedChange
from invid.wording.clauses import row_statement
from invid.wording.statement import ENGLISH, LANGUAGES, Statement, say, upper_first


class Status(StrEnum):
    """What can be said of one parameter."""

    CHANGED = "changed"
    UNCHANGED = "unchanged"
    CANNOT_TELL = "cannot_tell"


class CauseStatus(StrEnum):
    """What became of a cause."""

    APPEARED = "appeared"
    GREW = "grew"
    SHRANK = "shrank"
    UNCHANGED = "unchanged"
    GONE = "gone"
    CANNOT_TELL = "cannot_tell"


def _estimate_to_json(e: Estimate | None) -> dict[str, Any] | None:
    return None if e is None else {"value": e.value, "std": e.std}


@dataclass(frozen=True, kw_only=True)
class _Judged:
    """What the test of one difference came to.

    ``difference`` ± ``std`` is new − old; ``bound`` the largest relative change that the data still allow.
    """

    why: Statement | None = None
    """Why nothing can be told."""
    difference: float | None = None
    std: float | None = None
    p_value: float | None = None
    p_adjusted: float | None = None
    bound: float | None = None
    detectable: float | None = None

    @property
    def reason(self) -> str:
        """Why nothing can be told, in English; empty where something can."""
        return "" if self.why is None else say(self.why)

    def _judged_to_json(
        self, old: Estimate | None, new: Estimate | None, status: Status | CauseStatus
    ) -> dict[str, Any]:
        return {
            "old": _estimate_to_json(old),
            "new": _estimate_to_json(new),
            "status": str(status),
            "reason": self.reason,
            "difference": self.difference,
            "std": self.std,
            "p": self.p_value,
            "p_adjusted": self.p_adjusted,
            "within_percent": None if self.bound is None else 100.0 * self.bound,
        }


@dataclass(frozen=True)
class Change(_Judged):
    """One parameter, before and after.

    ``difference`` ± ``std`` is new − old with the uncertainty of both and the repeatability of the cell;
    of a *changed* parameter it is the change that explains the two models with all that did not change
    held equal, which is better known than the plain difference of two correlated estimates.
    ``bound`` is the largest relative change that the data still allow (a fraction of ``scale``);
    ``scale`` is |old|, or for couplings the geometric mean of the final masses they join.
    ``detectable`` is the relative change in this parameter alone that would have been found with 90 %.
    ``rivals`` are the names of parameters of which this one, or they, changed.
    """

    name: str
    label: str
    axis: str
    kind: str
    unit: str | None
    old: Estimate | None
    new: Estimate | None
    status: Status
    scale: float = 0.0
    final: bool = False
    rivals: tuple[str, ...] = ()
    cause: str | None = None
    """Of a number of a cause."""
    element: str | None = None
    other_axis: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "parameter": self.name,
            "label": self.label,
            "axis": self.axis,
            "kind": self.kind,
            "unit": self.unit,
            **self._judged_to_json(self.old, self.new, self.status),
            "detectable_percent": None if self.detectable is None else 100.0 * self.detectable,
        }


@dataclass(frozen=True)
class Repeatability:
    """How much more a cell varies from run to run than the fits' covariances say.

    ``factor`` multiplies every standard deviation (below 1 where the runs agree better than their fits say,
    and there are enough of them to say so); ``pairs`` of runs are behind it,
    with ``dof`` effective degrees of freedom (infinite where the factor is assumed, not measured).
    ``relative`` is the relative standard deviation between measurements of an unchanged robot (temperature,
    pose) beside it, as the user states it.
    """

    factor: float = 1.0
    pairs: int = 0
    dof: float = float("inf")
    relative: float = 0.0


@dataclass(frozen=True)
class CauseChange(_Judged):
    """One cause, before and after, by its main ``parameter``; ``None`` where a run did not find it.

    ``difference`` ± ``std`` is that of its size (its amount, of a gain its distance from 1); ``bound`` the
    largest relative change that the data still allow; ``detectable`` the size that a run without the cause
    would have seen in 95 of 100 cases.
    """

    name: str
    cause: str
    axis: str
    element: str | None
    other_axis: str | None
    parameter: str
    unit: str | None
    label: str
    old: Estimate | None
    new: Estimate | None
    status: CauseStatus

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "name": self.name,
            "cause": self.cause,
            "axis": self.axis,
            "element": self.element,
            "other_axis": self.other_axis,
            "parameter": self.parameter,
            "unit": self.unit,
            "label": self.label,
            **self._judged_to_json(self.old, self.new, self.status),
            "detectable": self.detectable,
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
    statements: tuple[Statement, ...] = ()
    """All that can be said, what changed first."""
    warnings: tuple[str, ...] = ()
    shape: tuple[NamedChange, ...] = ()
    """What differs in structure: axes, numbers of masses."""
    repeatability: Repeatability = field(default=Repeatability())
    runs: tuple[int, int] = (1, 1)
    """How many models the old and the new side are the mean of."""
    causes: tuple[CauseChange, ...] = ()
    """What became of every cause that either side has."""
    named: tuple[NamedChange, ...] = ()
    """What changed beyond its uncertainty, as it is told first."""

    @property
    def structure(self) -> tuple[str, ...]:
        """What differs in structure, in English."""
        return tuple(upper_first(say(row_statement(c))) for c in self.shape)

    @property
    def sentences(self) -> tuple[str, ...]:
        """All that can be said, in English."""
        return self.sentences_in(ENGLISH)

    def sentences_in(self, language: str) -> tuple[str, ...]:
        """All that can be said in a language."""
        return tuple(upper_first(say(s, language)).strip() for s in self.statements)

    @property
    def headlines(self) -> dict[str, str]:
        """What changed, what it looks like and what now, by language."""
        return {language: changes_headline(self.named, language) for language in LANGUAGES}

    @property
    def told(self) -> bool:
        """False where nothing could be called changed or unchanged."""
        return (
            bool(self.shape)
            or any(c.status is not Status.CANNOT_TELL or c.rivals for c in self.parameters + self.effects)
            or any(str(c.status) != "cannot_tell" for c in self.causes)
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
            "causes": [c.to_json() for c in self.causes],
            "joint": {"p": self.joint_p, "dof": self.joint_dof},
            "repeatability": {"factor": self.repeatability.factor, "pairs": self.repeatability.pairs},
            "runs": {"old": self.runs[0], "new": self.runs[1]},
            "headline": self.headlines[ENGLISH],
            "headlines": self.headlines,
            "structure": list(self.structure),
            "sentences": list(self.sentences),
            "warnings": list(self.warnings),
        }
