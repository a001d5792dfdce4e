"""What was ruled out: for every cause at every place the smallest size that these records would have shown.

Of a law of the size a, y(a) is the torque that nothing in the fit takes up, whitened by the noise at the
strengths that the fit has. λ = |y|² is its fall of −2 ln L without noise, to first order; without the law the
strength of an unknown force would rise, and yᴴ(1 + ΔS)⁻¹y + ln|1 + ΔS| is left of it, the least of any
place, colour and rise. A fall passes its threshold N in 95 of 100 records where √λ ≥ √N + 1.64
(noncentral χ² of one number). A law that grows with its size asks for one projection; of free play and of a
limit of the torque, sizes on a grid are tried. A law of unknown shape counts at the shape that shows least,
of those that show at all. Records kept out tell as much for each of their rows as those fitted.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from invid.diagnosis.sentences import ruled_out_sentence
from invid.diagnosis.unknown_forces.machine_search import ElasticSearch
from invid.diagnosis.unknown_forces.projected_rows import Rows
from invid.diagnosis.unknown_forces.resonances import mode_answer, top
from invid.diagnosis.unknown_forces.scoring import spot_at, spots_of
from invid.effects.catalogue.backlash import BacklashLaw
from invid.effects.catalogue.coulomb_friction import InnerDry
from invid.effects.catalogue.torque_saturation import TorqueSaturationLaw
from invid.effects.effect import Effect
from invid.effects.registry import effects
from invid.effects.supposed.law import Shape, SupposedLaw
from invid.effects.supposed_laws import supposed_laws
from invid.effects.units import unit_of
from invid.identification.late_drives import LAGS, lag_rows
from invid.likelihood.unknown_forces.descent import fit
from invid.likelihood.unknown_forces.fitted_hypothesis import Channel, FittedHypothesis
from invid.likelihood.unknown_forces.forces import Spot, Where, colours
from invid.likelihood.unknown_forces.motions import PlacedLaw, vector_of
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.price import FITTED, KEPT, PARTS, price, price_at_motors
from invid.likelihood.unknown_forces.slope import inner_motion
from invid.likelihood.unknown_forces.timing import COMMAND, CONVENTION, EXPECTED_DELAY, HOLD
from invid.likelihood.unknown_forces.value import Value
from invid.likelihood.unknown_forces.worth import FRICTION
from invid.model.diagnosis_document import Finding, RuledOut
from invid.model.place import Place
from invid.model.plant import Kind, Structure
from invid.numerics import budget
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.distributions import normal_isf
from invid.recording.model import Recording
from invid.wording.sentence import sentence

SURE = normal_isf(0.05)
"""Standard deviations by which the root of a fall has to pass its threshold (statistical: 95 of 100)."""
WHAT = sentence("what was ruled out")
"""What a spent budget leaves out, in the words of the warning."""
UNSEEN = 1e-4
"""Share of a law's torque that the fit has to leave for it to be told from the model's own numbers
(empirical: to first order these are right to about a hundredth)."""
FAR, SHARES = 0.1, (0.25, 0.5, 1.0)
"""Share of friction's torque below which other numbers would move so far for it that they are fitted, at
these shares of the size of first order (numerical)."""
STANDS = 2.0
"""Counts of its encoder within which an axis never moved."""
MODE_BANDS, MODE_DAMPING = (0.3, 0.45, 0.6, 0.8), 0.02
"""Frequencies of a mode over the highest excited one at which its limit is asked for, its damping ratio."""
RISES = np.concatenate(([0.0], np.logspace(-4.0, 8.0, 49)))
"""Power of an unknown force that rises, over the noise on the line that shows it best."""
HIDDEN = CONVENTION - EXPECTED_DELAY[COMMAND]
"""Samples of delay that conventions may hide, from the earliest of them on."""
UNTOLD = sentence("nothing in these records tells it from the parameters of the model")
TOO_SMALL = sentence("even as large as all that acts there it would not have stood out of the noise")
NO_LAW = sentence("it is not sought there, and would have been a force without a name")


@dataclass(frozen=True)
class Limit:
    """The smallest size seen, in the unit of its parameter, and the law's other parameters there."""

    parameter: str
    size: float
    at: dict[str, float]


def ruled_out(found: ElasticSearch, findings: Sequence[Finding]) -> tuple[RuledOut, ...]:
    """The limit of every cause that was not found, by place; those that could not be seen with the reason.

    Of as many as the budget allows. What is found, or one of its alternatives, is not among them.
    """
    recording, structure = found.recording, found.end.hypothesis.structure
    chains = Structure(structure.sizes)
    taken = [(f.cause, {f.axis, f.other_axis}, f.element) for f in findings]
    taken += [(a.cause, {a.axis, a.other_axis}, a.element) for f in findings for a in f.alternatives]
    screen = Screen(found.end, recording)
    out: list[RuledOut] = []
    for effect in effects():
        if recording.linear and effect.rotary:
            continue
        for place in effect.places(chains):
            if budget.is_left_out(WHAT):
                return tuple(out)
            made = _empty(effect, place, recording)
            if not any(_is_same(made, *t) for t in taken):
                limit = _limit_of(effect, place, screen, made)
                said = ruled_out_sentence(limit, structure.sizes, recording.axes)
                out.append(replace(limit, sentence=said))
    return tuple(out)


def _empty(effect: Effect, place: Place, recording: Recording) -> RuledOut:
    other = recording.axes[place.other] if place.other >= 0 else None
    unit = unit_of(effect.parameters[effect.main], recording.linear)
    return RuledOut(
        effect.cause, recording.axes[place.axis], place.element, other, effect.main, None, unit, None
    )


def _is_same(made: RuledOut, cause: str, axes: set[str | None], element: str | None) -> bool:
    """Whether a cause was found there; one that names no element may be at any."""
    here = {made.axis, made.other_axis}
    at = element == made.element or element is None or made.element is None
    return made.cause == cause and here - {None} == axes - {None} and (at or made.other_axis is not None)


def _limit_of(effect: Effect, place: Place, screen: Screen, made: RuledOut) -> RuledOut:
    """The limit of one cause at one place, or why it could not have been seen."""
    why = _why_never(effect, place, screen)
    if why is not None:
        return replace(made, why=why)
    limits = list(_limits(effect, place, screen))
    if not limits:
        return replace(made, why=NO_LAW)
    seen = [limit for limit in limits if limit is not None]
    if not seen:
        return replace(made, why=UNTOLD)
    worst = max(seen, key=lambda limit: limit.size)
    unit = unit_of(effect.parameters[worst.parameter], screen.recording.linear)
    made = replace(made, parameter=worst.parameter, unit=unit)
    if worst.size > screen.largest(effect.parameters[worst.parameter], place.axis):
        return replace(made, why=TOO_SMALL)
    return replace(made, limit=worst.size, at=worst.at)


def _limits(effect: Effect, place: Place, screen: Screen) -> Iterator[Limit | None]:
    """The limit at every shape of a cause that the search may find there; ``None`` where it is not seen."""
    spot = spot_at(screen.structure, place)
    for law in screen.laws:
        if law.cause == effect.cause and spot in spots_of(law, screen.structure):
            yield from screen.of_law(law, spot, effect.main)
    motor = place.kind == "mass" and place.number == 1
    for part, cause in FRICTION if motor else ():
        if cause == effect.cause:
            parameter = next(iter(effect.parameters)) if part is Part.RISE else effect.main
            yield screen.of_friction(part, place.axis, parameter)
    for channel in Channel:
        if channel.value == effect.cause:
            yield screen.of_channel(channel, place.axis, effect.main)
    if place.kind == "pair":
        yield screen.of_pair(place, effect.main)
    if "mass" in effect.parameters and effect.family == "structure" and place.kind == "mass":
        yield from screen.of_mode(place, effect.main)


class Screen:
    """The final fit: what a torque put into its rows would have gained."""

    def __init__(self, end: FittedHypothesis, recording: Recording) -> None:
        self.end, self.recording = end, recording
        self.structure = end.hypothesis.structure
        self.rows = Rows(end)
        self.laws = supposed_laws(linear=recording.linear)
        self._open: dict[frozenset[object], Screen] = {}

    @cached_property
    def kept(self) -> float:
        """Rows kept out over those fitted."""
        value = self.end.kept_value
        count = sum(w.missing.size for w in self.end.fit.value.work)
        return 0.0 if value is None else sum(w.missing.size for w in value.work) / count

    @cached_property
    def rises(self) -> tuple[list[tuple[Complex128, Float64]], Float64]:
        """Of each stack the whitened reach (F, M, P) of the unknown forces and the share (F, P, 2, Q) of a
        torque along it that risen strengths take up; what they cost (P, 2, Q)."""
        problem, value = self.end.fit.problem, self.end.fit.value
        reach = [w.noise.whitener @ w.noise.reach for w in value.work]
        colour = [colours(w.stack.omega, problem.corner)[:, None] for w in value.work]
        felt = [(np.abs(h) ** 2).sum(axis=1)[..., None] * g for h, g in zip(reach, colour, strict=True)]
        risen = RISES / np.maximum(np.max([f.max(axis=0) for f in felt], axis=0), 1e-300)[..., None]
        taken, cost = [], np.zeros(risen.shape)
        for work, g, f in zip(value.work, colour, felt, strict=True):
            weight = 2.0 * work.stack.count * work.stack.weight
            cost += np.einsum("f,fpcq->pcq", weight, np.log1p(f[..., None] * risen))
            taken.append(g[..., None] * risen / (1.0 + f[..., None] * risen))
        return list(zip(reach, taken, strict=True)), cost

    def size_seen(self, left: Float64, *, of_friction: bool = False) -> float:
        """How many times larger a law has to be that leaves ``left`` (rows,) at size one."""
        stacks, cost = self.rises
        first, own, prior = 0, np.zeros(cost.shape), left[-self.end.numbers.x.size :]
        for work, (reach, share) in zip(self.end.fit.value.work, stacks, strict=True):
            rows = left[first : (first := first + work.missing.size)].reshape(work.missing.shape)
            real, imaginary = np.split(rows, 2, axis=1)
            lines = (real + 1j * imaginary).reshape(work.shape)
            along = (np.abs(np.einsum("fmp,rfm->rfp", reach.conj(), lines)) ** 2).sum(axis=0)
            own += float((rows**2).sum()) - np.einsum("fp,fpcq->pcq", along, share)
        held = float(prior @ prior)
        needs = [(price(), 1.0 + self.kept, held), (FITTED * price(), 1.0, held)]
        if self.kept:
            needs.append((KEPT * price(), self.kept, 0.0))
        return max(
            float(np.sqrt((((np.sqrt(need) + SURE) ** 2 - part * cost) / (part * own + fixed)).max()))
            for need, part, fixed in ([(price_at_motors(PARTS), 1.0, held)] if of_friction else needs)
        )

    def of_law(self, law: SupposedLaw, spot: Spot, main: str) -> Iterator[Limit | None]:
        """Limits of a law at its shapes."""
        if isinstance(law, BacklashLaw | TorqueSaturationLaw):
            yield self._of_knee(law, spot, main)
            return
        for shape in law.shapes(self.end.motions.flat(spot)):
            placed = PlacedLaw(law, spot, shape)
            left, felt = self.rows.of_law(placed), self.rows.felt_of(placed)
            seen, direction = _least_seen(left, only_last=bool(law.contains))
            if not float(seen @ seen) > UNSEEN**2 * float(((felt @ direction) ** 2).sum()):
                yield None
                continue
            coefficients = self.size_seen(seen) * np.abs(direction)
            yield self._limit(placed, coefficients, main)

    def _limit(self, placed: PlacedLaw, coefficients: Float64, main: str) -> Limit:
        """The size of a law over none: of a gain from one, of friction by direction over plain friction."""
        stiffness = self._stiffness(placed.spot)
        beside = np.zeros(len(placed.law.beside))
        values, none = (
            placed.law.parameters(np.concatenate((c, beside)), placed.shape, stiffness)
            for c in (coefficients, 0.0 * coefficients)
        )
        grown = [n for n in values if values[n] != none[n]]
        parameter = main if main in grown else grown[0]
        return Limit(parameter, abs(values.pop(parameter) - none[parameter]), values)

    def _of_knee(self, law: SupposedLaw, spot: Spot, main: str) -> Limit | None:
        """The smallest (or, of a limit of the torque, the largest) knee on the grid that is seen."""
        shapes = law.shapes(self.end.motions.flat(spot))
        shapes = sorted(shapes, reverse=isinstance(law, TorqueSaturationLaw))
        return _crossing(main, [(float(np.exp(s[0])), self._fall_of_knee(law, spot, s)) for s in shapes])

    def _fall_of_knee(self, law: SupposedLaw, spot: Spot, shape: Shape) -> float:
        """Fall of a law with a knee over what is asked for."""
        coefficients = np.ones(1)
        if spot.where is Where.SPRING:
            damper = float(self.end.numbers.plant.of_kind(Kind.DAMPER)[spot.number])
            coefficients = np.array([self._stiffness(spot), damper])
        return self._fall(self.rows.of_law(PlacedLaw(law, spot, shape)) @ coefficients)

    def of_friction(self, part: Part, motor: int, parameter: str) -> Limit | None:
        """Limit of a part of a motor's friction that is not there."""
        laws = self.end.bench.motor_laws
        shape = self.end.hypothesis.friction[motor]
        lines = [lines[..., None] for lines in laws.lines(motor, part, shape)]
        vector = self._vector(Spot(Where.MOTOR, motor))
        rows = self._with_dry(motor).rows if part is Part.RISE else self.rows
        left, felt = rows.of_force(lines, vector)[:, 0], float((rows.felt(lines, vector) ** 2).sum())
        if not float(left @ left) > UNSEEN**2 * felt:
            return None
        at = {"velocity": shape.stribeck} if part is Part.RISE else {}
        size = self.size_seen(left, of_friction=True)
        if float(left @ left) > FAR**2 * felt:
            return Limit(parameter, size, at)
        rises = self._rises_of_friction((part, motor), [share * size for share in SHARES])
        return _crossing(parameter, rises) or Limit(parameter, size, at)

    def _rises_of_friction(self, name: Hashable, sizes: Sequence[float]) -> list[tuple[float, float]]:
        """Sizes, and the rise of −2 ln L with a part of friction held so much below its best, over what is
        asked for."""
        problem, need = self.end.fit.problem, (np.sqrt(price_at_motors(PARTS)) + SURE) ** 2

        def held(low: float, high: float) -> Value:
            columns = (replace(c, low=low, high=high) if c.name == name else c for c in problem.columns)
            return fit(replace(problem, columns=tuple(columns)), self.end.numbers).value

        best = held(-np.inf, np.inf)
        own = best.coefficients[[c.name for c in problem.columns].index(name)]
        return [(s, (held(own - s, own - s).total - best.total) / float(need)) for s in sizes]

    def _with_dry(self, motor: int) -> Screen:
        """The screen with dry friction of a motor in the fit: what rises at slow speed rises above it."""
        key = frozenset({(Part.DRY, motor)})
        if key not in self._open:
            was = self.end.hypothesis
            freed = self.end.refit(replace(was, absent=was.absent - key), iterations=0)
            self._open[key] = Screen(freed, self.recording)
        return self._open[key]

    def of_channel(self, channel: Channel, axis: int, parameter: str) -> Limit | None:
        """Limit of a drive's delay beyond conventions, or of its lag."""
        step = self.end.numbers.timing.step
        if channel is Channel.LAG:
            falls = [(lag * step, self._fall_of_lag(lag, axis)) for lag in LAGS]
            limit = _crossing(parameter, falls)
            return limit and replace(limit, size=max(limit.size, HIDDEN * step))
        driven = any(r.driven[axis] for s in self.end.bench.stacks for r in s.records)
        first = self.end.numbers.plant.x.size
        number = first + (COMMAND if driven else HOLD) * self.structure.motors + axis
        left = self.rows.of_number(number)
        return Limit(parameter, (self.size_seen(left) + HIDDEN) * step, {}) if left.any() else None

    def _fall_of_lag(self, lag: float, axis: int) -> float:
        """Fall of a lag [samples] over what is asked for: in the logarithm, where delays and lags add up."""
        return self._fall(self.rows.project(np.concatenate(lag_rows(self.end, axis, lag))))

    def _fall(self, left: Float64) -> float:
        left = left.ravel()
        return float(self.size_seen(left) ** -2.0) if left.any() else 0.0

    def of_pair(self, place: Place, parameter: str) -> Limit | None:
        """Limit of a spring between two loads."""
        pair = (min(place.axis, place.other), max(place.axis, place.other))
        number = self.structure.index(Kind.LOAD_SPRING).start + self.structure.pairs.index(pair)
        left, unit = self.rows.of_number(number), float(self.end.numbers.plant.unit[number])
        return Limit(parameter, self.size_seen(left) * unit, {}) if left.any() else None

    def of_mode(self, place: Place, parameter: str) -> Iterator[Limit | None]:
        """Limits of a further mass on a spring at a mass, at frequencies in the band."""
        vector, fit = self._vector(spot_at(self.structure, place)), self.end.fit
        moved = [inner_motion(fit.problem, fit.value, k) @ vector for k in range(len(fit.value.work))]
        for band in MODE_BANDS:
            natural = band * top(self.end)
            lines = [
                (mode_answer(work.stack.omega, natural, MODE_DAMPING) * motion)[..., None]
                for work, motion in zip(fit.value.work, moved, strict=True)
            ]
            left = self.rows.of_force(lines, vector)[:, 0]
            if not float(left @ left) > UNSEEN**2 * float((self.rows.felt(lines, vector) ** 2).sum()):
                yield None
                continue
            mass = self.size_seen(left)
            at = {"stiffness": mass * natural**2}
            yield Limit(parameter, mass, at) if parameter == "mass" else Limit(parameter, at["stiffness"], {})

    def _vector(self, spot: Spot) -> Float64:
        return vector_of(self.structure, spot)

    def _stiffness(self, spot: Spot) -> float:
        if spot.where is not Where.SPRING:
            return 1.0
        return float(self.end.numbers.plant.of_kind(Kind.SPRING)[spot.number])

    def largest(self, kind: str, axis: int) -> float:
        """The largest size that makes sense of a torque; infinite of others."""
        if kind != "torque":
            return np.inf
        return max(
            float(np.abs(r.torque_wave[:, axis]).max()) for s in self.end.bench.stacks for r in s.records
        )

    def reverses(self, spot: Spot) -> bool:
        """Whether the motion at a place goes both ways in any record."""
        return any(m.velocity.min() < 0.0 < m.velocity.max() for m in self.end.motions.flat(spot))

    def bent(self, spot: Spot) -> float:
        """Largest torque about its mean that bends a spring."""
        waves = [m.position - m.position.mean() for m in self.end.motions.flat(spot)]
        return self._stiffness(spot) * max(float(np.abs(w).max()) for w in waves)


def _least_seen(left: Float64, *, only_last: bool) -> tuple[Float64, Float64]:
    """(rows,) what a law of size one leaves and its coefficients, where it shows least; with ``only_last`` of
    what its last coefficient has beyond the others."""
    if not only_last:
        direction = np.linalg.eigh(left.T @ left)[1][:, 0]
        return left @ direction, direction
    others = np.linalg.qr(left[:, :-1])[0]
    beyond = left[:, -1] - others @ (others.T @ left[:, -1])
    return beyond, np.eye(left.shape[1])[-1]


def _crossing(parameter: str, falls: Sequence[tuple[float, float]]) -> Limit | None:
    """The size between those of a grid at which the fall is what is asked for; ``None`` where none is.

    Between two sizes, and below the first, the fall is taken for a power of the size.
    """
    seen = next((k for k, (_, fall) in enumerate(falls) if fall >= 1.0), None)
    if seen is None:
        return None
    k = max(seen, 1)
    if k >= len(falls):
        return Limit(parameter, falls[seen][0], {})
    (low, little), (high, much) = falls[k - 1], falls[k]
    power = np.log(much / max(little, 1e-300)) / np.log(high / low)
    at = np.log(high) if power == 0.0 else np.log(high) - np.log(much) / power
    return Limit(parameter, float(np.exp(at)), {})


def _why_never(effect: Effect, place: Place, screen: Screen) -> str | None:
    """Why these records could not show a cause there, whatever its size; ``None`` where they could."""
    recording, axis = screen.recording, place.axis
    counts = 0.0 if recording.encoder_resolution is None else float(recording.encoder_resolution[axis])
    span = max(float(np.ptp(e.position[:, axis])) for e in recording.experiments)
    if span <= STANDS * counts:
        return "the axis never moved"
    spot, laws = spot_at(screen.structure, place), [law for law in screen.laws if law.cause == effect.cause]
    if spot.where is Where.SPRING:
        bent = screen.bent(spot)
        if bent == 0.0:
            return sentence("the spring was never loaded")
        carried = min(abs(float(e.torque[:, axis].mean())) for e in recording.experiments)
        if carried > bent and any(isinstance(law, BacklashLaw) for law in laws):
            return "it was never unloaded"
    is_dry = any(isinstance(law, InnerDry) for law in laws) or (Part.RISE, effect.cause) in FRICTION
    if is_dry and not screen.reverses(spot):
        return "the motion never reversed"
    return UNTOLD if effect.family == "linear" else None
