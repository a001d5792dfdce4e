"""What a person said was changed before a measurement, and how what was found agrees with it, as data."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from invid.model.named_change import NamedChange


class Subject(StrEnum):
    """What a person says was changed."""

    TOOL = "tool"
    TRANSMISSION = "transmission"
    """Gear, belt or coupling."""
    LUBRICATION = "lubrication"


@dataclass(frozen=True)
class Expectation:
    """A person's word: what was changed, on which axis (``None``: not said), by how much.

    Of a tool ``size`` is its inertia about the axis [kg·m²], its mass on a linear axis [kg]; positive where
    it is heavier. ``mass`` [kg] is what is known where the distance from a rotary axis was not said.
    """

    subject: Subject
    axis: str | None = None
    size: float | None = None
    mass: float | None = None
    linear: bool = False


class Agreement(StrEnum):
    """How what was found agrees with what was said."""

    AS_SAID = "as_said"
    SIZE_OPEN = "size_open"
    """There, and in the direction that was said; how much was not said so that it could be compared."""
    MORE = "more"
    LESS = "less"
    OPPOSITE = "opposite"
    ELSEWHERE = "elsewhere"
    NOT_VISIBLE = "not_visible"
    """Nothing of the kind, though it would have been seen."""
    CANNOT_TELL = "cannot_tell"
    NO_MODEL = "no_model"
    """There is no accepted model to compare with."""


@dataclass(frozen=True)
class Answer:
    """What is to be said first: ``change`` is what was found, ``visible`` the size beyond which a change of
    the tool would have been seen, in ``unit``.
    """

    expectation: Expectation
    agreement: Agreement
    change: NamedChange | None = None
    visible: float | None = None
    unit: str | None = None
