"""The torque that motors miss in each record, as the verdict has it, and what of it a place or a cause makes.

One residual: that of the fit of the plant without causes (``without_causes``), read from its smoother.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from invid.effects import curve as laws
from invid.effects.elements import ModelPlace
from invid.effects.registry import effect_of
from invid.identification.fitted_model import plant_of
from invid.identification.kept_out import all_records
from invid.identification.search_start import settled_about
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.smoother import SmoothedStack, smooth
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm
from invid.numerics.arrays import Bool, Complex128, Float64
from invid.recording.model import Recording
from invid.signals.record import DENSE, Record

BINS = 160
"""Lines are gathered in at most so many bins: more cannot be told apart in a picture."""


@dataclass(frozen=True, eq=False)
class Missing:
    """One record of a stack that was smoothed: its motion, and on every line (A, M) what its motors miss."""

    record: Record
    stack: SmoothedStack
    torque: Complex128
    at: int

    @cached_property
    def hz(self) -> Float64:
        """(A,) lines [Hz]."""
        return np.asarray(self.stack.omega / (2.0 * np.pi))

    @cached_property
    def shown(self) -> Bool:
        """(A,) lines that carry the record: of its period, up to where the likelihood uses all."""
        number = np.arange(self.hz.size)
        inside = (number > 0) & (self.hz <= DENSE * self.record.top_hz)
        return np.asarray(inside & (number % max(self.record.periods, 1) == 0))

    @cached_property
    def excited(self) -> Bool:
        """(A,) lines on which the excitation has power: those stated, else all that are shown."""
        if not self.record.excited.size:
            return self.shown
        return self.shown & np.isin(np.arange(self.hz.size), self.record.excited)

    @property
    def std(self) -> Float64:
        """(A, M) amplitude that the sensors alone would leave."""
        return np.asarray(np.sqrt(self.stack.sensors))

    def moved(self, pattern: Float64) -> tuple[Float64, Float64]:
        """(k + 1,) position and velocity along ``pattern`` (n,)."""
        position, velocity = self.stack.over_time(pattern)
        return position[self.at], velocity[self.at]

    def wave(self, lines: Complex128) -> Float64:
        """(k + 1,) time signal of lines (A,), of those that are shown."""
        spectrum = np.zeros(self.stack.grid // 2 + 1, dtype=complex)
        spectrum[: lines.size] = np.where(self.shown, lines, 0.0)
        return self.stack.wave(spectrum)

    def without(self, pattern: Float64, force: Float64) -> Missing:
        """The same with a force (k + 1,) at a place taken for known."""
        return replace(
            self, torque=self.torque + self.reach(pattern) * self.record.wide_lines(force)[:, None]
        )

    def reach(self, pattern: Float64) -> Complex128:
        """(A, M) what a unit of force along ``pattern`` asks of the motors."""
        return np.asarray(self.stack.condensed.motion @ pattern)

    def force_at(self, pattern: Float64) -> tuple[Complex128, Float64]:
        """(A,) force at a place that explains the missing torque best, weighted with the sensors' noise, and
        its standard deviation (A,)."""
        stiffness, reach = self.stack.condensed.stiffness, self.reach(pattern)
        sensors = self.record.position_noise, self.record.torque_noise
        cover = np.einsum("fij,j,fkj->fik", stiffness, sensors[0], stiffness.conj()) + np.diag(sensors[1])
        scale = np.maximum(np.einsum("fii->f", cover).real, 1e-300)[:, None, None]
        solved = np.linalg.solve(
            cover / scale + 1e-9 * np.eye(reach.shape[1]), np.stack((reach, self.torque), axis=2)
        )
        size = np.maximum(np.einsum("fm,fm->f", reach.conj(), solved[..., 0]).real, 1e-300)
        force = np.einsum("fm,fm->f", reach.conj(), solved[..., 1]) / size
        return force, np.sqrt(scale[:, 0, 0] / size)


def missing_torques(recording: Recording, chains: CoupledChains) -> list[Missing]:
    """Every record that shakes an axis, under chains without causes."""
    if not any(e.frequencies_hz.size or e.torque.any() for e in recording.experiments):
        return []
    now = settled_about(chains, all_records(recording))
    every = frozenset((part, motor) for motor in range(chains.branches) for part in Part)
    numbers = replace(now.numbers, plant=plant_of(chains))
    now = now.refit(replace(now.hypothesis, absent=every), numbers, iterations=0)
    return [
        Missing(record, stack, stack.missing[at], at)
        for stack in smooth(now.fit.problem, now.fit.value)
        for at, record in enumerate(stack.stack.records)
    ]


@dataclass(frozen=True, eq=False)
class Place:
    """Where a cause acts: number of its axis, pattern (n,) over all coordinates, stiffness of its spring."""

    axis: int
    pattern: Float64
    stiffness: float = 0.0

    @property
    def near(self) -> Float64:
        """(n,) the mass at it, or the one on the motor's side of its spring."""
        return np.maximum(self.pattern, 0.0)


def place_in(chains: CoupledChains, term: EffectTerm) -> Place:
    """Where a term acts in chains; what is not placed at the motor."""
    effect, at = effect_of(term.cause), ModelPlace(chains, term)
    a, b = at.coordinates("motor" if effect is None else effect.home)
    pattern = np.zeros(chains.dofs)
    pattern[a] = 1.0
    if b < 0:
        return Place(at.axis, pattern)
    pattern[b] = -1.0
    is_pair = term.other_axis is not None
    return Place(at.axis, pattern, 0.0 if is_pair else float(at.spring()[2]))


def quantity(m: Missing, place: Place, what: str, *, own: bool = True) -> Float64:
    """(k + 1,) what a cause may depend on, at its place; ``own``: a spring's velocity is that across it."""
    if what in (laws.TORQUE, laws.TORQUE_RATE):
        lines = m.record.torque[:, place.axis]
        return m.wave(lines if what == laws.TORQUE else 1j * m.stack.omega * lines)
    near = what == laws.POSITION or (what == laws.VELOCITY and not own)
    position, velocity = m.moved(place.near if near else place.pattern)
    return velocity if what in (laws.VELOCITY, laws.DEFLECTION_RATE) else position


def cause_wave(m: Missing, place: Place, term: EffectTerm) -> Float64 | None:
    """(k + 1,) torque of a cause by its own numbers, without its mean, of which lines show little; ``None``
    where it is no law of motion."""
    own, second = laws.abscissa(term), laws.across(term)
    if own is None:
        return None
    x = quantity(m, place, own)
    curve = laws.curve(term, x, place.stiffness, None if second is None else quantity(m, place, second))
    if curve is None:
        return None
    wave = curve.y if curve.path else np.interp(x, curve.x, curve.y)
    return np.asarray(wave - wave.mean())


def beside(m: Missing, chains: CoupledChains, terms: Sequence[EffectTerm]) -> tuple[Missing, int]:
    """What is missing beside these causes, and how many of them have no law to take out."""
    lawless = 0
    for term in terms:
        place = place_in(chains, term) if term.axis in chains.axes else None
        wave = None if place is None else cause_wave(m, place, term)
        if place is None or wave is None:
            lawless += 1
        else:
            m = m.without(place.pattern, wave)
    return m, lawless


def sound(values: Complex128, std: Float64) -> Float64:
    """(A,) share of every line's power that is not noise."""
    noise = std**2
    return np.asarray(1.0 - noise / np.maximum(np.abs(values) ** 2, np.maximum(noise, 1e-300)))


def binned(hz: Sequence[Float64], power: Sequence[Float64]) -> tuple[list[float], list[float]]:
    """Rms over logarithmic bins of several records' lines: centre [Hz] and √(mean power) of those filled."""
    f, p = np.concatenate(list(hz)), np.concatenate(list(power))
    if not f.size:
        return [], []
    edges = np.geomspace(f.min() * 0.999, f.max() * 1.001, BINS + 1)
    at = np.clip(np.digitize(f, edges) - 1, 0, BINS - 1)
    count = np.bincount(at, minlength=BINS)
    used = count > 0
    centre, mean = (np.bincount(at, weights=x, minlength=BINS)[used] / count[used] for x in (f, p))
    return centre.tolist(), np.sqrt(mean).tolist()
