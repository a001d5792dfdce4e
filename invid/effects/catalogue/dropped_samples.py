"""Rows of an axis that repeat the one before: found in the samples themselves, not by regression."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ModelPlace, RepeatedRows
from invid.effects.sizes import SAMPLES, Size, size


class DroppedSamples(Effect):
    """Each row repeats the one before with probability ``fraction``."""

    cause = "dropped_samples"
    title = "samples that were lost and repeated"
    check = "Check the bus load, the SYNC period and the PDO mapping of the axis."
    separating = Experiment("hand", "record the timestamps of every frame")
    family = "sampling"
    stands = ()
    home = "axis"
    sizes = (Size(SAMPLES, size("fraction")),)
    parameters: ClassVar[Mapping[str, str]] = {"fraction": "ratio"}
    main = "fraction"

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [RepeatedRows(at.value("fraction"))]
