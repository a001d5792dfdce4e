"""What a comparison of two models consists of: ``Change`` of one number or cause, ``Comparison`` of all."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from invid.clauses import label, row_sentence
from invid.diagnosis.headline import changes_headline
from invid.model.document import Estimate
from invid.model.named_change import ChangeKind, NamedChange
from invid.wording.sentence import capital


class Status(StrEnum):
    """What can be said of a parameter, or what became of a cause."""

    CHANGED = "changed"
    UNCHANGED = "unchanged"
    CANNOT_TELL = "cannot_tell"
    APPEARED = "appeared"
    GREW = "grew"
    SHRANK = "shrank"
    GONE = "gone"

    @property
    def is_change(self) -> bool:
        """Whether it is more than chance."""
        return self not in (Status.UNCHANGED, Status.CANNOT_TELL)


@dataclass(frozen=True)
class Change(NamedChange):
    """One number or cause, before and after, and what the test of its difference came to.

    ``difference`` ± ``std`` is new − old with the uncertainty of both and the repeatability of the cell; of a
    *changed* parameter it is the change that explains the two models with all that did not change held equal,
    which is better known than the plain difference of two correlated estimates. Of a cause it is that of its
    size (its amount, of a gain its distance from 1) by its main ``parameter``; ``None`` in ``old`` or ``new``
    where a run did not find it.
    ``scale`` is |old|, or for couplings the geometric mean of the final masses they join; ``bound`` the
    largest relative change that the data still allow; ``rivals`` the names of parameters of which this one,
    or they, changed. ``detectable`` is the relative change in this parameter alone that would have been found
    with 90 %; of a cause the size that a run without it would have seen in 95 of 100 cases.
    """

    status: Status = Status.CANNOT_TELL
    why: str = ""
    """Why nothing can be told; empty where something can."""
    p_value: float | None = None
    p_adjusted: float | None = None
    bound: float | None = None
    detectable: float | None = None
    scale: float = 0.0
    rivals: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """What a person calls it."""
        return label(self)

    @property
    def family(self) -> str:
        """ "mass", "spring", "coupling", "effect", …: what kind of parameter it is."""
        is_mass = self.kind in (ChangeKind.LOAD, ChangeKind.MOTOR_MASS)
        return str(ChangeKind.MASS if is_mass else self.kind)

    def to_json(self) -> dict[str, Any]:
        """Plain values; those of a cause say what it is and where."""
        if self.is_cause:
            keys = ("name", "cause", "axis", "element", "other_axis", "parameter", "unit", "label")
            what = {key: getattr(self, key) for key in keys} | {"detectable": self.detectable}
        else:
            what = {
                "parameter": self.name,
                "label": self.label,
                "axis": self.axis,
                "kind": self.family,
                "unit": self.unit,
                "detectable_percent": _percent(self.detectable),
            }
        return {
            **what,
            "old": _estimate_to_json(self.old),
            "new": _estimate_to_json(self.new),
            "status": str(self.status),
            "reason": self.why,
            "difference": self.difference,
            "std": self.std,
            "p": self.p_value,
            "p_adjusted": self.p_adjusted,
            "within_percent": _percent(self.bound),
        }


def _percent(fraction: float | None) -> float | None:
    return None if fraction is None else 100.0 * fraction


def _estimate_to_json(e: Estimate | None) -> dict[str, Any] | None:
    return None if e is None else {"value": e.value, "std": e.std}


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
class Comparison:
    """What changed between two models."""

    robots: tuple[str, str]
    alpha: float
    tolerance: float
    parameters: tuple[Change, ...]
    effects: tuple[Change, ...]
    """Numbers of causes that both sides have."""
    joint_p: float | None
    joint_dof: int
    sentences: tuple[str, ...] = ()
    """All that can be said, what changed first."""
    warnings: tuple[str, ...] = ()
    shape: tuple[NamedChange, ...] = ()
    """What differs in structure: axes, numbers of masses."""
    repeatability: Repeatability = field(default=Repeatability())
    runs: tuple[int, int] = (1, 1)
    """How many models the old and the new side are the mean of."""
    causes: tuple[Change, ...] = ()
    """What became of every cause that either side has."""
    named: tuple[NamedChange, ...] = ()
    """What changed beyond its uncertainty, as it is told first."""

    @property
    def structure(self) -> tuple[str, ...]:
        """What differs in structure."""
        return tuple(capital(row_sentence(c)) for c in self.shape)

    @property
    def headline(self) -> str:
        """What changed, what it looks like and what now."""
        return changes_headline(self.named)

    @property
    def told(self) -> bool:
        """False where nothing could be called changed or unchanged."""
        rows = self.parameters + self.effects + self.causes
        return bool(self.shape) or any(c.status is not Status.CANNOT_TELL or c.rivals for c in rows)

    def to_json(self) -> dict[str, Any]:
        """The ``invid-comparison`` document."""
        return {
            "format": "invid-comparison",
            "format_version": 1,
            "robots": list(self.robots),
            "alpha": self.alpha,
            "tolerance_percent": 100.0 * self.tolerance,
            "parameters": [c.to_json() for c in self.parameters],
            "effects": [c.to_json() for c in self.effects],
            "causes": [c.to_json() for c in self.causes],
            "joint": {"p": self.joint_p, "dof": self.joint_dof},
            "repeatability": {"factor": self.repeatability.factor, "pairs": self.repeatability.pairs},
            "runs": {"old": self.runs[0], "new": self.runs[1]},
            "headline": self.headline,
            "structure": list(self.structure),
            "sentences": list(self.sentences),
            "warnings": list(self.warnings),
        }
