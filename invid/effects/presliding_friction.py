"""Presliding: the contact gives elastically before it slides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.arrays import Float64
from invid.effects.base import ForceEffect
from invid.effects.place import Place, mass_places
from invid.effects.slider import remembers, slide
from invid.effects.view import View, rms
from invid.refine.structure import ChainStructure


class PreslidingFriction(ForceEffect):
    """Resistance stiffness·z with z the slider's displacement, |stiffness·z| ≤ torque."""

    cause = "presliding_friction"
    title = "dry friction with elastic presliding"
    check = "Check seals, bearings' preload and the brake's lining: the contact springs before it slides."
    separate = "small motions around many positions, and slow moves that reverse"
    family = "friction"
    parameters: ClassVar[Mapping[str, str]] = {"stiffness": "stiffness", "torque": "torque"}
    coefficients = ("torque",)
    lower, upper = (0.0,), (np.inf,)
    shapes, logarithmic = ("most",), (True,)
    main = "torque"

    def places(self, structure: ChainStructure) -> list[Place]:
        return mass_places(structure)

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        size = rms([v.wave(place.pattern(v.structure)) for v in views])
        return [(float(np.log(max(size, 1e-300) * f)),) for f in (0.05, 0.15, 0.35, 0.8)]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        size = max(rms([v.wave(place.pattern(v.structure)) for v in views]), 1e-300)
        return [(float(np.log(1e-3 * size)), float(np.log(2.0 * size)))]

    def remembers(self, view: View, place: Place, x: Sequence[float]) -> bool:
        wave = view.wave(place.pattern(view.structure))
        return remembers(wave, float(np.exp(x[1])), periodic=not view.record.transient)

    def law(self, view: View, place: Place, shape: Sequence[float]) -> Float64:
        most = float(np.exp(shape[0]))
        x = view.wave(place.pattern(view.structure))
        start = view.starts.get(place.pattern(view.structure), 0.0)
        return slide(x, most, periodic=not view.record.transient, start=start)[:, None] / most

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"stiffness": float(x[0] / np.exp(x[1])), "torque": float(x[0])}
