"""A law without a name: what is missing at a place as a smooth curve over one quantity of its motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Self

import numpy as np
import scipy

from invid.effects.effect import Effect, Experiment, PlaceMotion
from invid.effects.motion_effect import OF_MOTION, OF_RATE, MotionEffect
from invid.effects.parameter import Parameter
from invid.effects.units import unit_of
from invid.errors import ModelError
from invid.model.document import EffectTerm
from invid.model.law_table import LawTable
from invid.model.parameters import ChainStructure
from invid.model.place import Place, mass_places, pair_places, spring_places
from invid.numerics.arrays import Float64, frozen_float

IN_SPRING = ("deflection", "deflection rate")
NAMELESS = "empirical_law"
KNOTS = 25
"""Most knots of a law over the range of its quantity; where no sample is near there is none."""
STANDS = 1e-12
"""Range of a quantity below which it is rounding [rad, rad/s, m, m/s]."""


def spline_law(knots: Sequence[float], values: Float64) -> Callable[[Float64], Float64]:
    """Return the natural cubic splines through ``values`` (k, n) at ``knots`` (k,), straight beyond them.

    Of (m,) quantities they give (m, n) resistances.
    """
    curve = scipy.interpolate.CubicSpline(knots, values, bc_type="natural")

    def resistance(u: Float64) -> Float64:
        within = np.clip(u, knots[0], knots[-1])
        out: Float64 = curve(within) + curve(within, 1) * (u - within)[:, None]
        return out

    return resistance


def knots_of(values: Sequence[Float64]) -> list[float] | None:
    """Return ascending knots over the range of a quantity, none where it never was; ``None`` where it stands.

    ``values``: its waves (n,) in the records.
    """
    every = np.concatenate(values)
    low, high = float(every.min()), float(every.max())
    if not high - low > STANDS:
        return None
    edges = np.linspace(low, high, KNOTS)
    half = 0.5 * (edges[1] - edges[0])
    counts = np.histogram(every, np.append(edges - half, high + half))[0]
    kept = counts > 0
    kept[[0, -1]] = True
    return [float(e) for e in edges[kept]]


def is_like_law(effect: Effect, over: str) -> bool:
    """Return whether a cause is a function of the same quantity as a law, so that one may stand for a part of
    the other."""
    return (effect.family == "friction") is (over in OF_RATE)


class EmpiricalLaw(MotionEffect):
    """Resistance Σ xₖ·sₖ(u) of a quantity u, each sₖ a natural cubic spline on the same knots.

    Beyond the knots it goes on straight. ``shapes`` (k, n) are the values of the splines at the knots (k,).
    """

    cause = NAMELESS
    title = "a torque that follows a law without a name"
    check = "Look for what acts there; its curve is in the report."
    separating = Experiment(
        "amplitudes", "the same excitation at another amplitude: a law holds there as well"
    )
    family = "other"
    numbers = (Parameter("torque", "torque"),)

    def __init__(
        self, over: str = "velocity", knots: Sequence[float] = (-1.0, 1.0), shapes: Float64 | None = None
    ) -> None:
        self.over = over
        self.home = "spring" if over in IN_SPRING else "motor"
        self.knots = frozen_float(knots)
        self.splines = frozen_float(np.zeros((self.knots.size, 1)) if shapes is None else shapes)
        count = self.splines.shape[1]
        self.coefficients = tuple(f"part_{k + 1}" for k in range(count))
        self.lower, self.upper = (-np.inf,) * count, (np.inf,) * count
        if shapes is not None:
            self.title = f"{self.title} over the {over}"

    @cached_property
    def _curve(self) -> Callable[[Float64], Float64]:
        return spline_law(self.knots.tolist(), self.splines)

    def places(self, structure: ChainStructure) -> list[Place]:
        if self.over not in IN_SPRING:
            return mass_places(structure)
        return spring_places(structure) + (pair_places(structure) if self.over == "deflection" else [])

    def resistance(self, motion: PlaceMotion, shape: Sequence[float]) -> Float64:
        return self._curve(motion.velocity if self.over in OF_RATE else motion.position)

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"torque": float(np.abs(self.splines @ np.asarray(x, dtype=float)).max())}

    def vector(self, p: Mapping[str, float]) -> list[float]:
        return [p["torque"]]

    def table(self, x: Float64, covariance: Float64, *, linear: bool) -> LawTable:
        return LawTable(
            self.over,
            tuple(self.knots.tolist()),
            unit_of("velocity" if self.over in OF_RATE else "position", linear),
            tuple((self.splines @ x).tolist()),
            unit_of("torque", linear),
            tuple(tuple(row) for row in (self.splines @ covariance @ self.splines.T).tolist()),
        )

    def known(self, term: EffectTerm) -> Self:
        table = term.table
        if table is None or table.over not in OF_MOTION:
            over = "no table" if table is None else f"over {table.over!r}"
            raise ModelError(
                f"effect {self.cause} on {term.axis}: {over}; it needs over, one of {', '.join(OF_MOTION)}, "
                "and a table"
            )
        value = np.array(table.value)
        return type(self)(table.over, table.at, (value / max(float(np.abs(value).max()), 1e-300))[:, None])

    def size_text(self, size: str) -> str:
        return f", up to {size},"
