"""A parallel map over candidates that are fitted independently."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from invid.effects.registry import effects
from invid.likelihood.joint_fit import JointFit
from invid.numerics.parallel import parallel_map
from invid.signals.spectral_record import SpectralRecord

A = TypeVar("A")
B = TypeVar("B")


def map_candidates(
    run: Callable[[A], B], items: Sequence[A], here: JointFit, records: Sequence[SpectralRecord]
) -> list[B]:
    """``[run(item) for item in items]`` on all cores; results share records, layout and effects with
    ``here``."""
    laws = [*effects(), *(t.effect for t in here.candidate.terms)]
    return parallel_map(run, items, known=[*records, here.layout, here.layout.structure, *laws])


__all__ = ["map_candidates"]
