"""Terms of what a fit has found, in the contract's terms: of every fit, friction at the motors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from invid.effects.registry import BY_CAUSE
from invid.effects.units import unit_of
from invid.identification.quantities import Quantities, axis_and_element
from invid.likelihood.unknown_forces.fitted_hypothesis import Channel, FittedHypothesis
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.timing import COMMAND, EXPECTED_DELAY, HOLD
from invid.likelihood.unknown_forces.worth import FRICTION
from invid.model.document import EffectTerm
from invid.model.plant import Kind
from invid.numerics.arrays import Float64

FEW = 6
"""Iterations from a finished fit to that with one law more: a small step, nearly linear."""
Sizes = dict[str, tuple[Callable[[Float64], float], list[int | None]]]
"""A cause's parameters: each a function of some of the values, and which."""


class TermWriter:
    """Terms of one fitted hypothesis."""

    def __init__(self, now: FittedHypothesis, axes: Sequence[str], *, linear: bool) -> None:
        self.now, self.axes, self.linear = now, tuple(axes), linear
        self.known = Quantities.of(now)
        self.structure = now.hypothesis.structure

    def _unit(self, cause: str, parameter: str) -> str | None:
        return unit_of(BY_CAUSE[cause].parameters.get(parameter, "ratio"), self.linear)

    def term(self, cause: str, axis: int, sizes: Sizes, **place: str) -> EffectTerm:
        """A cause's term, its parameters functions of what was fitted."""
        parameters = {
            name: self.known.estimate(size, indices, self._unit(cause, name))
            for name, (size, indices) in sizes.items()
        }
        return EffectTerm(cause, self.axes[axis], parameters, place.get("element"), place.get("other_axis"))

    def friction(self, motor: int, parts: frozenset[Part]) -> list[EffectTerm]:
        """Terms of a motor's friction for the parts that stay."""
        named = {
            Part(part)
            for placed in self.now.hypothesis.laws
            if axis_and_element(self.structure, placed.spot)[0] == motor
            for part in placed.law.beside
        }
        parts = parts - named
        at = {part: self.known.coefficient((part, motor)) for part in parts | {Part.DRY}}
        dry, rise = at[Part.DRY], at.get(Part.RISE)
        found: dict[str, Sizes] = {}
        if rise is not None:  # at its bound, there is none to have a velocity
            velocity = self.known.shape((Part.DRY, motor, "stribeck"))
            found["stribeck_friction"] = {
                "static": (lambda v: float(v[0] + v[1]), [dry, rise]),
                "coulomb": (lambda v: float(v[0]), [dry]),
                "velocity": (lambda v: float(np.exp(v[0])), [velocity]),
            }
        for part, cause in reversed(FRICTION):
            if part in parts and part is not Part.RISE and not (part is Part.DRY and rise is not None):
                found[cause] = {BY_CAUSE[cause].main: (lambda v: float(v[0]), [at[part]])}
        terms = [self.term(cause, motor, sizes, element="mass 1") for cause, sizes in found.items()]
        return [self._bent(t, motor) if t.cause == "coulomb_friction" else t for t in terms]

    def _bent(self, term: EffectTerm, motor: int) -> EffectTerm:
        """Dry friction with what it may carry of viscous friction that is out of the fit: what is too small
        to be told bends what stays."""
        known = term.parameters["torque"]
        if (Part.VISCOUS, motor) not in self.now.hypothesis.absent or known.std is None:
            return term
        bend = self._coefficient(self._with_viscous, motor) - self._coefficient(self.now, motor)
        return replace(term, parameters={"torque": replace(known, std=float(np.hypot(known.std, bend)))})

    @staticmethod
    def _coefficient(now: FittedHypothesis, motor: int) -> float:
        names = [c.name for c in now.fit.problem.columns]
        return float(now.fit.value.coefficients[names.index((Part.DRY, motor))])

    @cached_property
    def _with_viscous(self) -> FittedHypothesis:
        """The fit with every motor's viscous friction in it."""
        was = self.now.hypothesis
        gone = {(Part.VISCOUS, m) for m in range(self.structure.motors)}
        return self.now.refit(replace(was, absent=was.absent - gone), iterations=FEW)

    def load_spring(self, pair: tuple[int, int]) -> EffectTerm:
        """Term of a spring between two loads."""
        at = self.structure.index(Kind.LOAD_SPRING).start + self.structure.pairs.index(pair)
        unit = self.now.numbers.plant.unit[at]
        sizes = {"stiffness": (lambda v: v[0] * unit, [at])}
        element = f"mass {self.structure.sizes[pair[0]]}"
        return self.term("coupling_stiffness", pair[0], sizes, element=element, other_axis=self.axes[pair[1]])

    @property
    def late_channels(self) -> list[tuple[Channel, int]]:
        """Drives that are late or lag, by axis; one that shows its torque low-passed is none."""
        lag = self.now.numbers.timing.lag
        late = (c for c in self.now.hypothesis.channels if c[0] is Channel.DELAY or lag[c[1]] >= 0.0)
        return sorted(late, key=lambda c: (c[1], c[0].value))

    def channel(self, channel: Channel, axis: int) -> EffectTerm:
        """Term of a drive that is late or lags."""
        first, motors = self.now.numbers.plant.x.size, self.structure.motors
        step = self.now.numbers.timing.step
        if channel is Channel.LAG:
            at = first + 4 * motors + axis
            return self.term(channel.value, axis, {"time_constant": (lambda v: v[0] * step, [at])})
        driven = any(r.driven[axis] for s in self.now.bench.stacks for r in s.records)
        at = first + (axis if driven else motors + axis)
        usual, open_part = self._usual_delay(axis) if driven else (EXPECTED_DELAY[HOLD], 0.0)
        term = self.term(channel.value, axis, {"delay": (lambda v: (v[0] - usual) * step, [at])})
        known = term.parameters["delay"]
        std = None if known.std is None else float(np.hypot(known.std, open_part * step))
        return replace(term, parameters={"delay": replace(known, std=std)})

    def _usual_delay(self, axis: int) -> tuple[float, float]:
        """Delay of a punctual command in this record [samples], and its deviation: that of the other axes.

        On one axis alone nothing tells whether samples show the command that begins or the one that ended.
        """
        late = {a for _, a in self.now.hypothesis.channels} | {axis}
        others = [float(d) for a, d in enumerate(self.now.numbers.timing.delay[COMMAND]) if a not in late]
        return (float(np.median(others)), 0.0) if others else (0.0, 1.0 / np.sqrt(12.0))
