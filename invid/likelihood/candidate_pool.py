"""Candidates that are fitted each for itself, on all cores."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from invid.effects.registry import effects
from invid.likelihood.joint_fit import JointFit
from invid.numerics.parallel import at_once
from invid.signals.spectral_record import Record

A = TypeVar("A")
B = TypeVar("B")


def each(run: Callable[[A], B], items: Sequence[A], here: JointFit, records: Sequence[Record]) -> list[B]:
    """``[run(item) for item in items]``; answers share records, layout and effects with ``here``."""
    laws = [*effects(), *(t.effect for t in here.candidate.terms)]
    return at_once(run, items, known=[*records, here.layout, here.layout.structure, *laws])


__all__ = ["each"]
