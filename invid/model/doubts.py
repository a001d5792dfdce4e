"""Reasons why a model is not to be trusted, as codes, the weightiest first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class DoubtCode(StrEnum):
    """Kinds of doubt in the order of their weight: how much of the model falls with it."""

    MISSED_TORQUE = "missed_torque"
    """More than half of the torque is missed: ``share``."""
    STATED_INERTIA = "stated_inertia"
    """The inertia of an axis is ``times`` the one that its config states: a scale is wrong, or it is old."""
    LITTLE_EXPLAINED = "little_explained"
    """Less of the torque is explained than a model of the right machine explains: ``share``."""
    TORQUE_BEHIND_SPRING = "torque_behind_spring"
    """The torque hardly moves the motor: it is measured behind the spring, or the motor is ``share`` of its
    chain."""
    WRONG_STRUCTURE = "wrong_structure"
    """A force that no part of the model makes acts behind the motors: ``times`` the torque's rms."""
    SHORT_RECORD = "short_record"
    """An experiment ends before its first period does."""
    ORDER_OPEN = "order_open"
    """Other numbers of masses explain the data alike."""
    CUT_SHORT = "cut_short"
    """The search for causes ran out of time."""
    OTHER = "other"
    """A doubt without a code of its own, of an earlier release's file, say."""
    UNSEEN = "unseen"
    """Parameters that the data do not determine; the others hold."""
    UNEXPLAINED = "unexplained"
    """Torque is missed beyond the noise, and no known cause explains it."""
    TEST = "test"
    """Measured with a test's small torques."""


_OF_THE_RUN = {DoubtCode.UNEXPLAINED, DoubtCode.TEST}
_LEAVES_THE_REST = {DoubtCode.UNSEEN, DoubtCode.STATED_INERTIA, *_OF_THE_RUN}


@dataclass(frozen=True)
class Doubt:
    """One reason: its code with values, and the sentence about it that stands among the warnings."""

    code: DoubtCode
    text: str
    values: Mapping[str, float] = field(default_factory=dict)

    @property
    def spoils_changes(self) -> bool:
        """Return whether a difference from another model may come from the doubt itself.

        What the data do not determine has no standard deviation and changes nowhere; what is missed or
        measured weakly is in the standard deviations of the rest; a scale is the same in both.
        """
        return self.code not in _LEAVES_THE_REST

    @property
    def is_of_model(self) -> bool:
        """Return whether it speaks against the model itself, and not of how it was measured or what it
        lacks.
        """
        return self.code not in _OF_THE_RUN

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"code": str(self.code), "text": self.text, "values": dict(self.values)}


def by_weight(doubts: Iterable[Doubt]) -> tuple[Doubt, ...]:
    """Return doubts, the weightiest first, those of one kind in their order."""
    order = list(DoubtCode)
    return tuple(sorted(doubts, key=lambda d: order.index(d.code)))


def doubt_facts(doubts: Iterable[Doubt]) -> dict[str, Any]:
    """Return what a model's ``fit`` says of its doubts: sentences, codes with values, and the sum of it."""
    found = tuple(doubts)
    return {
        "trustworthy": not found,
        "doubts": [d.text for d in found],
        "distrust": [d.to_json() for d in found],
    }


def doubts_of(fit: Mapping[str, Any]) -> tuple[Doubt, ...]:
    """Return the doubts in a model's ``fit``, the weightiest first; of a file without codes as ``other``."""
    typed = [_read(d) for d in fit.get("distrust", ()) if isinstance(d, Mapping)]
    known = {d.text for d in typed}
    plain = [
        Doubt(DoubtCode.OTHER, d) for d in fit.get("doubts", ()) if isinstance(d, str) and d not in known
    ]
    if not typed and not plain and not fit.get("trustworthy", True):
        plain = [Doubt(DoubtCode.OTHER, "the identification does not trust its own fit")]
    return by_weight([*typed, *plain])


def _read(document: Mapping[str, Any]) -> Doubt:
    code = str(document.get("code"))
    values = document.get("values")
    known = DoubtCode(code) if code in set(DoubtCode) else DoubtCode.OTHER
    return Doubt(known, str(document.get("text", "")), dict(values) if isinstance(values, Mapping) else {})
