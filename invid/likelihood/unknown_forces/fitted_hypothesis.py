"""What a search supposes of a machine: structure, friction's shapes, laws at places; and the fit of it."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property, partial

import numpy as np

from invid.effects.supposed.law import Shape, SpotMotion
from invid.likelihood.unknown_forces.correspondence import Correspondence
from invid.likelihood.unknown_forces.descent import TO_THE_END, Fit, fit
from invid.likelihood.unknown_forces.forces import FIRST, Spot, Spots, Where, colours, missing_noise
from invid.likelihood.unknown_forces.motions import Motions, PlacedLaw, axis_of, vector_of
from invid.likelihood.unknown_forces.motor_laws import FrictionShape, MotorLaws, Part
from invid.likelihood.unknown_forces.motor_motion import Friction, agreed_records
from invid.likelihood.unknown_forces.price import PARTS, price_at_motors
from invid.likelihood.unknown_forces.smoother import SmoothedStack, smooth
from invid.likelihood.unknown_forces.stack import Stack
from invid.likelihood.unknown_forces.timing import CONVENTION
from invid.likelihood.unknown_forces.value import Column, Numbers, Problem, Value, evaluate
from invid.model.plant import Element, Kind, Structure
from invid.numerics.arrays import Complex128, Float64
from invid.signals.record import Record


class Channel(Enum):
    """What a drive may do to its torque."""

    DELAY = "torque_delay"
    LAG = "torque_lag"


FREE_TIME = 30.0
"""Standard deviation of a supposed delay or lag [samples]: not bounded by it."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Structure, friction's shapes and laws; no numbers."""

    structure: Structure
    friction: tuple[FrictionShape, ...]
    laws: tuple[PlacedLaw, ...] = ()
    absent: frozenset[Hashable] = frozenset()
    """Names of columns, and pairs of loads, that are held at zero; delays held within a sample."""
    channels: frozenset[tuple[Channel, int]] = frozenset()
    """Axes whose drive is late or lags by more than a sample's convention."""

    @property
    def covered(self) -> frozenset[Hashable]:
        """Parts of motors' friction that laws on the same axis take the place of."""
        return frozenset(
            (Part(part), axis_of(self.structure, placed.spot))
            for placed in self.laws
            for part in placed.law.covers
        )

    def plus(self, placed: PlacedLaw) -> Hypothesis:
        """With one law more, in the place of those that it contains."""
        rest = (p for p in self.laws if p.spot != placed.spot or not isinstance(p.law, placed.law.contains))
        return replace(self, laws=(*rest, placed))


class Bench:
    """Records with what they alone decide: friction's columns, kept by shape."""

    def __init__(self, stacks: Sequence[Stack]) -> None:
        self.stacks = tuple(stacks)
        self.motor_laws = MotorLaws(stacks)

    def columns(self, hypothesis: Hypothesis, motions: Motions) -> tuple[Column, ...]:
        """Friction, then the laws."""
        friction = self.motor_laws.columns(hypothesis.structure, hypothesis.friction)
        laws = [c for law in hypothesis.laws for c in self.law_columns(hypothesis.structure, law, motions)]
        gone = hypothesis.absent | hypothesis.covered
        return tuple(replace(c, low=0.0, high=0.0) if c.name in gone else c for c in (*friction, *laws))

    def law_columns(self, structure: Structure, placed: PlacedLaw, motions: Motions) -> tuple[Column, ...]:
        """Columns of one law, one a coefficient."""
        lines = self.law_lines(placed, motions)
        vector = vector_of(structure, placed.spot)
        still = np.zeros(len(placed.law.low))
        stretch = still
        if placed.law.reads:
            stretch = _stretch(placed, motions)
            lines = [
                w + n[..., None] * stretch for w, n in zip(lines, motions.rounding(placed.spot), strict=True)
            ]
        return tuple(
            Column(
                (*placed.key, i),
                vector,
                tuple(stack[..., i] for stack in lines),
                partial(_wide, placed, motions, i),
                low,
                high,
                reads=placed.spot.number if placed.law.reads else -1,
                scales=placed.spot.number if placed.law.scales else -1,
                stretch=float(stretch[i]),
            )
            for i, (low, high) in enumerate(placed.law.limits(motions.flat(placed.spot)))
        )

    def law_lines(
        self, placed: PlacedLaw, motions: Motions, shape: Shape | None = None, *, quick: bool = False
    ) -> list[Complex128]:
        """(R, F, L) of each stack; ``quick``: on as few instants as its waves allow."""
        at = placed.shape if shape is None else shape
        quick = quick or placed.law.is_smooth
        key = placed.law, placed.spot, at, quick
        if key not in motions.lines:

            def lines(record: Record, motion: SpotMotion) -> Complex128:
                stride = record.stride(placed.law.stride(motion, at)) if quick else 1
                return record.lines(placed.law.waves(motion.every(stride), at))

            motions.lines[key] = [
                np.array([lines(r, m) for r, m in zip(stack.records, moved, strict=True)])
                for stack, moved in zip(self.stacks, motions.of(placed.spot), strict=True)
            ]
        return motions.lines[key]


def _stretch(placed: PlacedLaw, motions: Motions) -> Float64:
    """(L,) mean derivative of a law's waves, on where the motor stands, by its reading."""
    moved = [np.diff(reading) for reading in motions.readings(placed.spot)]
    waves = [np.diff(placed.law.waves(m, placed.shape), axis=0) for m in motions.flat(placed.spot)]
    power = sum(float(d @ d) for d in moved)
    return np.asarray(np.sum([d @ w for d, w in zip(moved, waves, strict=True)], axis=0) / max(power, 1e-300))


def _wide(placed: PlacedLaw, motions: Motions, coefficient: int, number: int) -> Complex128:
    records = motions.stacks[number].records
    return np.array(
        [
            r.wide_lines(placed.law.waves(m, placed.shape)[:, coefficient])
            for r, m in zip(records, motions.of(placed.spot)[number], strict=True)
        ]
    )


@dataclass(frozen=True, eq=False)
class _OnKept:
    """Records kept out at what was fitted to others."""

    motions: Motions
    problem: Problem
    value: Value

    @property
    def total(self) -> float:
        """−2 ln L."""
        return float(self.value.share.sum())

    def smoothed(self, laws: Sequence[PlacedLaw], *, agreed: bool) -> Motions:
        """Their motion smoothed anew."""
        return self.motions.renewed(self.problem, self.value, laws, agreed=agreed)


@dataclass(frozen=True, eq=False)
class FittedHypothesis:
    """A hypothesis with its fit, the motions its laws were evaluated on, and the same of the records kept
    out."""

    bench: Bench
    hypothesis: Hypothesis
    motions: Motions
    fit: Fit
    kept: Bench | None = None
    kept_motions: Motions | None = None

    @property
    def total(self) -> float:
        """−2 ln L of the records fitted."""
        return self.fit.total

    @property
    def numbers(self) -> Numbers:
        """The numbers found."""
        return self.fit.numbers

    @property
    def sizes(self) -> dict[Hashable, float]:
        """The coefficients found, by the names of their columns."""
        names = (c.name for c in self.fit.problem.columns)
        return dict(zip(names, self.fit.value.coefficients.tolist(), strict=True))

    @property
    def ways(self) -> tuple[bool, ...]:
        """Ways of ``renewed`` to smooth inner motion: plainly, and where a spring has a law in agreement."""
        is_bent = any(p.spot.where is Where.SPRING for p in self.hypothesis.laws)
        return (False, True) if is_bent else (False,)

    @property
    def has_contact(self) -> bool:
        """Whether something comes into contact across a spring."""
        return any(p.spot.where is Where.SPRING and not p.law.is_smooth for p in self.hypothesis.laws)

    @property
    def kept_value(self) -> Value | None:
        """−2 ln L of the records kept out, at the numbers, strengths and coefficients that were fitted, and
        on inner motion that is smoothed at them until it stands."""
        return None if self._kept_at_rest is None else self._kept_at_rest.value

    @cached_property
    def _kept_at_rest(self) -> _OnKept | None:
        known = self._kept_unmoved
        if self.kept is None or known is None:
            return None
        for _ in range(KEPT_ROUNDS if self.follows_fit else 0):
            before = known.total
            known = self._on_kept(
                self.kept, known.smoothed(self.hypothesis.laws, agreed=self.motions.is_agreed)
            )
            if abs(known.total - before) < STANDS:
                break
        return known

    @cached_property
    def _kept_unmoved(self) -> _OnKept | None:
        """On their motion as it came here."""
        if self.kept is None or self.kept_motions is None:
            return None
        return self._on_kept(self.kept, self.kept_motions)

    def _on_kept(self, kept: Bench, motions: Motions) -> _OnKept:
        columns = kept.columns(self.hypothesis, motions)
        problem = replace(self.fit.problem, stacks=kept.stacks, columns=columns)
        return _OnKept(motions, problem, evaluate(problem, self.numbers, self.fit.value.coefficients))

    @property
    def _kept_known(self) -> Motions | None:
        """Motion of the records kept out as far as it was smoothed."""
        known: _OnKept | None = vars(self).get("_kept_at_rest")
        return self.kept_motions if known is None else known.motions

    @property
    def _kept_now(self) -> _OnKept | None:
        """On that motion."""
        known: _OnKept | None = vars(self).get("_kept_at_rest")
        return self._kept_unmoved if known is None else known

    @property
    def follows_fit(self) -> bool:
        """Whether a law is on motion that a fit has said."""
        return any(p.needs_fit for p in self.hypothesis.laws)

    @property
    def kept_total(self) -> float:
        """−2 ln L of the records kept out; that of those fitted where none are."""
        return self.total if self._kept_at_rest is None else self._kept_at_rest.total

    @property
    def kept_total_unmoved(self) -> float:
        """The same on their motion as it came here, as a fit is on motion that stays."""
        return self.total if self._kept_unmoved is None else self._kept_unmoved.total

    def at_rest_on_kept(self) -> FittedHypothesis:
        """The same with the motion of the records kept out at rest."""
        at_rest = self._kept_at_rest
        return self if at_rest is None else replace(self, kept_motions=at_rest.motions)

    def refit(
        self,
        hypothesis: Hypothesis | None = None,
        numbers: Numbers | None = None,
        iterations: int = TO_THE_END,
        target: float = np.inf,
    ) -> FittedHypothesis:
        """Another hypothesis, on the same motions, from here; given up where it would not come to
        ``target``."""
        changed = self.hypothesis if hypothesis is None else hypothesis
        start = self.numbers if numbers is None else numbers
        columns = self.bench.columns(changed, self.motions)
        problem = Problem.about(self.bench.stacks, columns, start)
        if start.plant.structure == self.numbers.plant.structure:
            problem = replace(problem, centre=self.fit.problem.centre, shut=self.fit.problem.shut)
        start, problem = bounded(start, problem, changed)
        found = fit(problem, start, iterations, target)
        return replace(self, hypothesis=changed, fit=found, kept_motions=self._kept_known)

    def with_forces_at_laws(self) -> FittedHypothesis:
        """The fit where behind the motors nothing unknown acts but at the places of laws."""
        problem, laws = self.fit.problem, {placed.spot for placed in self.hypothesis.laws}
        shut = [k for k, s in enumerate(problem.spots.spots) if s not in laws and s.where is not Where.MOTOR]
        strength = self.numbers.strength.copy()
        strength[shut] = problem.least
        numbers = replace(self.numbers, strength=strength)
        return replace(self, fit=fit(replace(problem, shut=np.array(shut, dtype=int)), numbers))

    def with_forces_anywhere(self) -> FittedHypothesis:
        """The fit where something unknown may act at every place."""
        problem = replace(self.fit.problem, shut=np.zeros(0, dtype=int))
        return replace(self, fit=fit(problem, self.numbers))

    def renewed(self, iterations: int = TO_THE_END, *, agreed: bool = False) -> FittedHypothesis:
        """The same with inner motion smoothed anew."""
        return self.smoothed(agreed=agreed).refit(iterations=iterations)

    def with_motion(self) -> FittedHypothesis:
        """The same where motion is known at every place: smoothed at its own fit where it never was."""
        return self if self.motions.smoothed else self.smoothed()

    def smoothed(self, *, agreed: bool = False) -> FittedHypothesis:
        """The same on inner motion smoothed at its own fit; ``agreed``, or where it was before: that across
        springs agrees with their laws."""
        motions = self.motions.renewed(
            self.fit.problem,
            self.fit.value,
            self.hypothesis.laws,
            agreed=agreed or self.motions.is_agreed,
        )
        kept = self._kept_known
        if not self.follows_fit and self._kept_at_rest is not None:  # where a law will start from
            kept = self._kept_at_rest.smoothed((), agreed=False)
        return replace(self, motions=motions, kept_motions=kept)

    def with_kept_agreed(self) -> FittedHypothesis:
        """The same on motion of the records kept out that agrees with the laws once more, at this fit."""
        known = self._kept_now
        if known is None:
            return self
        return replace(self, kept_motions=known.smoothed(self.hypothesis.laws, agreed=True))

    def with_agreed_motors(self) -> FittedHypothesis:
        """The same on motor motion that agrees with friction as it is found.

        Unknown forces behind the motors that are weaker than friction may be what its motion misses: of
        motion beside them and without any that with the lower value is taken.
        """
        sizes = self.sizes
        friction = [
            (shape, sizes[Part.DRY, m], sizes[Part.RISE, m])
            for m, shape in enumerate(self.hypothesis.friction)
        ]
        most = max(dry + rise for _, dry, rise in friction)
        if not most:
            return self
        smoothed = smooth(self.fit.problem, self.fit.value)
        tried = {}
        for alone in (False, True) if 0.0 < self.inner_strength < most else (False,):
            stacks = _agreed(smoothed, friction, alone=alone)
            tried[alone] = replace(self, bench=Bench(stacks), motions=self.motions.on(stacks)).refit()
        alone = min(tried, key=lambda way: tried[way].total)
        known = self._kept_now
        if known is None:
            return tried[alone]
        stacks = _agreed(smooth(known.problem, known.value), friction, alone=alone)
        return replace(tried[alone], kept=Bench(stacks), kept_motions=known.motions.on(stacks))

    def in_structure(
        self, moved: Correspondence, added: Mapping[Element, float], iterations: int = TO_THE_END
    ) -> FittedHypothesis:
        """The fit of another structure from here: what both have as it was, what is ``added`` from its
        values.

        Laws at places that are gone go too.
        """
        kept, known = self._kept_known, self.fit.problem.spots.number
        first = np.full(2, np.median(self.numbers.strength))
        strength = {moved.spot(spot): self.numbers.strength[k] for spot, k in known.items()}
        numbers = replace(
            self.numbers,
            plant=moved.plant(self.numbers.plant, added),
            strength=np.array([strength.get(s, first) for s in Spots.of(moved.new).spots]),
        )
        laws = [(placed, moved.spot(placed.spot)) for placed in self.hypothesis.laws]
        hypothesis = replace(
            self.hypothesis,
            structure=moved.new,
            laws=tuple(replace(placed, spot=at) for placed, at in laws if at is not None),
        )
        there = replace(
            self,
            motions=self.motions.in_structure(moved),
            kept_motions=None if kept is None else kept.in_structure(moved),
        )
        return there.refit(hypothesis, numbers, iterations)

    @property
    def strength(self) -> list[tuple[float, Spot]]:
        """Rms of the unknown force at every place [N·m], the strongest first."""
        problem = self.fit.problem
        power = sum(
            (colours(s.omega, problem.corner) * s.weight[:, None]).sum(axis=0) @ self.numbers.strength.T
            for s in problem.stacks
        ) / len(problem.stacks)
        rms = np.sqrt(power / 2.0)
        return sorted(
            ((float(v), s) for v, s in zip(rms, problem.spots.spots, strict=True)), key=lambda t: -t[0]
        )

    @property
    def inner_strength(self) -> float:
        """Rms of the strongest unknown force behind the motors [N·m]."""
        return max((v for v, s in self.strength if s.where is not Where.MOTOR), default=0.0)


def _agreed(smoothed: Sequence[SmoothedStack], friction: Friction, *, alone: bool) -> list[Stack]:
    return [replace(s.stack, records=agreed_records(s, friction, alone=alone)) for s in smoothed]


KEPT_ROUNDS, STANDS = 3, 0.1 * price_at_motors(PARTS)
"""Most times that the motion of records kept out is smoothed, and the change of −2 ln L by which it stands: a
tenth of the least price."""
HELD = 1e-9
"""Standard deviation of a number that is held at zero."""


def bounded(numbers: Numbers, problem: Problem, hypothesis: Hypothesis) -> tuple[Numbers, Problem]:
    """Numbers and problem with absent springs between loads held at zero, and supposed channels free."""
    structure, motors = numbers.plant.structure, numbers.plant.structure.motors
    first = structure.index(Kind.LOAD_SPRING).start
    at = [first + k for k, pair in enumerate(structure.pairs) if pair in hypothesis.absent]
    x, centre, spread = numbers.x.copy(), problem.centre.copy(), problem.spread.copy()
    x[at], centre[at], spread[at] = 0.0, 0.0, HELD
    times = numbers.plant.x.size
    for k in range(2 * motors):
        # Within conventions it is free as ever: a stale delay would look like a lag.
        if (Channel.DELAY, k % motors) in hypothesis.absent and abs(x[times + k]) > CONVENTION:
            x[times + k] = centre[times + k] = CONVENTION * np.sign(x[times + k])
            spread[times + k] = HELD
    for channel, axis in hypothesis.channels:
        free = [axis, motors + axis] if channel is Channel.DELAY else [4 * motors + axis]
        spread[[times + k for k in free]] = FREE_TIME
    return numbers.moved(x), replace(problem, centre=centre, spread=spread)


def excess(found: FittedHypothesis) -> float:
    """−2 ln L of the records fitted above what the sensors alone would leave."""
    value, out = found.fit.value, 0.0
    for work in value.work:
        count, lines, motors = work.shape
        rows = work.missing + work.laws @ value.coefficients
        nothing = np.zeros((lines, work.noise.power.shape[1]))
        sensors = (work.position_noise, work.torque_noise)
        alone = missing_noise(work.condensed.stiffness, work.noise.reach, nothing, sensors)
        more = work.noise.log_determinant - alone.log_determinant - motors
        out += float((rows**2).sum()) + 2.0 * count * float(work.stack.weight @ more)
    return out


def fit_hypothesis(
    benches: tuple[Bench, Bench | None],
    hypothesis: Hypothesis,
    numbers: Numbers,
    iterations: int = TO_THE_END,
    target: float = np.inf,
) -> FittedHypothesis:
    """The first fit of a hypothesis without laws, on records fitted and kept out; given up where it would not
    come to ``target``."""
    bench, kept = benches
    motions, numbers, problem = _first_problem(bench, hypothesis, numbers)
    kept_motions = None if kept is None else Motions(kept.stacks, hypothesis.structure)
    return FittedHypothesis(
        bench, hypothesis, motions, fit(problem, numbers, iterations, target), kept, kept_motions
    )


def _first_problem(
    bench: Bench, hypothesis: Hypothesis, numbers: Numbers
) -> tuple[Motions, Numbers, Problem]:
    """A hypothesis without laws on motion as it was read, about numbers within its bounds."""
    motions = Motions(bench.stacks, hypothesis.structure)
    problem = Problem.about(bench.stacks, bench.columns(hypothesis, motions), numbers)
    return motions, *bounded(numbers, problem, hypothesis)


def settle_hypothesis(bench: Bench, hypothesis: Hypothesis, numbers: Numbers) -> FittedHypothesis:
    """A hypothesis without laws at a plant that is known, with the strengths and the timing that the records
    ask for; its curvature is that of all numbers."""
    motions, numbers, problem = _first_problem(bench, hypothesis, numbers)
    spread = problem.spread.copy()
    spread[: numbers.plant.x.size] = HELD
    settled = fit(replace(problem, spread=spread), numbers).numbers
    return FittedHypothesis(bench, hypothesis, motions, fit(problem, settled, 0), None, None)


def first_strength(stacks: Sequence[Stack], structure: Structure) -> Float64:
    """(P, 2) small strengths to start from."""
    noise = float(np.mean([s.torque_noise.mean() for s in stacks]))
    return np.full((len(Spots.of(structure).spots), 2), FIRST * noise)
