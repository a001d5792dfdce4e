"""One thing that changed since an earlier model, as data: what, where, by how much, whether it matters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from invid.model.document import Estimate


class ChangeKind(StrEnum):
    """What changed."""

    LOAD = "load"
    """The final mass of an axis."""
    MOTOR_MASS = "motor_mass"
    MASS = "mass"
    INERTIA = "inertia"
    """The sum of all masses of an axis, where their number changed."""
    SPRING = "spring"
    GROUND_SPRING = "ground_spring"
    DAMPER = "damper"
    COUPLING = "coupling"
    SCALE = "scale"
    """All masses and springs of an axis by one factor."""
    EFFECT = "effect"
    """Another number of a cause than its size."""
    APPEARED = "appeared"
    GREW = "grew"
    SHRANK = "shrank"
    GONE = "gone"
    CAUSE = "cause"
    """A cause of which none of these can be said."""
    MASSES = "masses"
    """The number of masses of an axis."""
    AXIS_NEW = "axis_new"
    AXIS_GONE = "axis_gone"
    ONE_OF = "one_of"
    """One of several, which the data do not separate."""
    UNLOCATED = "unlocated"
    """Something, which the data do not place."""
    UNTOLD = "untold"
    """Nothing can be told: no number is known well enough in both models."""


@dataclass(frozen=True)
class NamedChange:
    """One change.

    ``number`` counts masses or springs from the motor, from 1; ``difference`` ± ``std`` in ``unit``;
    ``share`` is the difference relative to what was. ``matters`` is False where it is certainly too small to.
    Of a cause, ``old`` and ``new`` are its size; of ``MASSES``, their number; of ``SCALE``, ``new`` is the
    factor.
    """

    kind: ChangeKind
    axis: str = ""
    name: str = ""
    number: int | None = None
    other_axis: str | None = None
    cause: str | None = None
    element: str | None = None
    parameter: str | None = None
    old: Estimate | None = None
    new: Estimate | None = None
    difference: float | None = None
    std: float | None = None
    unit: str | None = None
    share: float | None = None
    matters: bool = True
    among: tuple[NamedChange, ...] = ()

    @property
    def is_cause(self) -> bool:
        """Whether it is a cause, by its size."""
        return self.kind in CAUSES


CAUSES = frozenset(
    {ChangeKind.APPEARED, ChangeKind.GREW, ChangeKind.SHRANK, ChangeKind.GONE, ChangeKind.CAUSE}
)


def is_tool_change(changes: Sequence[NamedChange]) -> bool:
    """Return whether all that changed and matters is what another tool changes.

    A tool changes final masses, and with them how loads couple and weigh; it changes no spring and no
    friction.
    """
    serious = [c for c in changes if c.matters]
    loads = {c.axis for c in serious if c.kind is ChangeKind.LOAD}
    return bool(loads) and all(
        c.kind in (ChangeKind.LOAD, ChangeKind.COUPLING)
        or (c.cause == "gravity" and not loads.isdisjoint({c.axis, c.other_axis}))
        for c in serious
    )
