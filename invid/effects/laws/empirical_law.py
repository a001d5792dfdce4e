"""A law without a name: what is missing at a place, smooth over one quantity of its motion or two."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Self

import numpy as np
import scipy

from invid.effects.effect import Effect, Experiment, PlaceMotion
from invid.effects.motion_effect import OF_MOTION, OF_RATE, PAIRS, MotionEffect
from invid.effects.parameter import Parameter
from invid.effects.units import unit_of
from invid.errors import ModelError
from invid.model.document import EffectTerm
from invid.model.law_table import LawTable
from invid.model.place import Place, mass_places, pair_places, spring_places
from invid.model.plant import Structure
from invid.numerics.arrays import Float64, frozen_float
from invid.wording.sentence import sentence

IN_SPRING = ("deflection", "deflection rate")
NAMELESS = "empirical_law"
KNOTS = 25
"""Most knots of a law over the range of its quantity; where no sample is near there is none."""
KNOTS_OF_TWO = (13, 7)
"""The same for a law over two quantities: of the position or deflection, of the rate. The square of their
product stands in its covariance, and what is worn is worn at a place (empirical)."""
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


def surface_law(
    knots: Sequence[float], across: Sequence[float], values: Float64
) -> Callable[[Float64, Float64], Float64]:
    """Return the same over two quantities for ``values`` (k·l, n) at ``knots`` (k,) and ``across`` (l,).

    Beyond them it stays as it is there: straight on, it would grow with the product of both.
    """
    grids = (knots, across)
    curves = [scipy.interpolate.CubicSpline(at, np.eye(len(at)), bc_type="natural") for at in grids]

    def resistance(u: Float64, w: Float64) -> Float64:
        first, second = (
            curve(np.clip(x, at[0], at[-1])) for curve, x, at in zip(curves, (u, w), grids, strict=True)
        )
        out: Float64 = (first[:, :, None] * second[:, None, :]).reshape(u.size, -1) @ values
        return out

    return resistance


def most_knots(over: str, *, two: bool) -> int:
    """Most knots of a quantity in a law over one or ``two``."""
    return KNOTS_OF_TWO[over in OF_RATE] if two else KNOTS


def knots_of(values: Sequence[Float64], most: int = KNOTS) -> list[float] | None:
    """Return ascending knots over the range of a quantity, none where it never was; ``None`` where it stands.

    ``values``: its waves (n,) in the records.
    """
    every = np.concatenate(values)
    low, high = float(every.min()), float(every.max())
    if not high - low > STANDS:
        return None
    edges = np.linspace(low, high, most)
    half = 0.5 * (edges[1] - edges[0])
    counts = np.histogram(every, np.append(edges - half, high + half))[0]
    kept = counts > 0
    kept[[0, -1]] = True
    return [float(e) for e in edges[kept]]


def is_known(rows: Float64, x: Float64, covariance: Float64) -> bool:
    """Return whether the largest resistance of a law in ``rows`` (m, k) is above three standard deviations of
    any: the rest of the model may undo it else. Knots that no row is near do not count."""
    variance = np.sum(rows @ covariance * rows, axis=1)
    return bool(9.0 * variance.max() < np.square(rows @ x).max())


def is_like_law(effect: Effect, over: str) -> bool:
    """Return whether a cause is a function of the same quantity as a law, so that one may stand for a part of
    the other."""
    return (effect.family == "friction") is (over in OF_RATE)


class EmpiricalLaw(MotionEffect):
    """Resistance Σ xₖ·sₖ(u) of a quantity u, each sₖ a natural cubic spline on the same knots.

    Beyond the knots it goes on straight. ``shapes`` (k, n) are the values of the splines at the knots (k,).
    Of two quantities it is Σ xₖ·sₖ(u, w), the values are (k·l, n), and beyond the knots it stays as it is.
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
        self,
        over: str = "velocity",
        knots: Sequence[float] = (-1.0, 1.0),
        shapes: Float64 | None = None,
        across: str = "",
        across_knots: Sequence[float] = (-1.0, 1.0),
    ) -> None:
        self.over, self.across = over, across
        self.home = "spring" if over in IN_SPRING else "motor"
        self.knots = frozen_float(knots)
        self.across_knots = frozen_float(across_knots if across else (0.0,))
        size = self.knots.size * self.across_knots.size
        self.splines = frozen_float(np.zeros((size, 1)) if shapes is None else shapes)
        if shapes is not None:
            over_what = " and ".join(filter(None, (f"over the {over}", across)))
            self.title = f"{self.title} {over_what}"

    @cached_property
    def _curve(self) -> Callable[..., Float64]:
        if self.across:
            return surface_law(self.knots.tolist(), self.across_knots.tolist(), self.splines)
        return spline_law(self.knots.tolist(), self.splines)

    def straight(self) -> Float64:
        """(k, s) orthonormal: a constant and the straight lines over each quantity, at its knots."""
        at = np.meshgrid(self.knots, self.across_knots, indexing="ij")[: 2 if self.across else 1]
        lines = [x.ravel() / np.abs(x).max() for x in at]
        return np.linalg.qr(np.column_stack((np.ones(lines[0].size), *lines)))[0]

    def places(self, structure: Structure) -> list[Place]:
        if self.over not in IN_SPRING:
            return mass_places(structure)
        return spring_places(structure) + (pair_places(structure) if self.over == "deflection" else [])

    def resistance(self, motion: PlaceMotion, shape: Sequence[float]) -> Float64:
        quantities = (self.over, self.across) if self.across else (self.over,)
        return self._curve(*(motion.velocity if q in OF_RATE else motion.position for q in quantities))

    def table(self, x: Float64, covariance: Float64, *, linear: bool) -> LawTable:
        return LawTable(
            self.over,
            tuple(self.knots.tolist()),
            unit_of("velocity" if self.over in OF_RATE else "position", linear),
            tuple((self.splines @ x).tolist()),
            unit_of("torque", linear),
            tuple(tuple(row) for row in (self.splines @ covariance @ self.splines.T).tolist()),
            self.across,
            tuple(self.across_knots.tolist()) if self.across else (),
            unit_of("velocity" if self.across in OF_RATE else "position", linear) if self.across else "",
        )

    def known(self, term: EffectTerm) -> Self:
        table = term.table
        if table is None or table.quantities not in (*((q,) for q in OF_MOTION), *PAIRS):
            over = "no table" if table is None else f"over {' and '.join(map(repr, table.quantities))}"
            raise ModelError(
                f"effect {self.cause} on {term.axis}: {over}; it needs over, one of {', '.join(OF_MOTION)}, "
                f"or over and across, {' or '.join(' and '.join(p) for p in PAIRS)}, and a table"
            )
        value = np.array(table.value)
        shape = (value / max(float(np.abs(value).max()), 1e-300))[:, None]
        return type(self)(table.over, table.at, shape, table.across, table.across_at)

    def size_text(self, size: str) -> str:
        return sentence(", up to {size},", size=size)
