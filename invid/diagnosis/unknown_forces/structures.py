"""What a machine may have besides its chains: a mode at a mass, a base that gives way, one more mass; each
with starts by a scan over frequency, and each taken out again."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from invid.diagnosis.unknown_forces.resonances import BAND, DAMPING, Resonance, Scan, top
from invid.identification.contest import is_settled
from invid.identification.fewer_masses import expected
from invid.identification.first_plants import fraction_chains
from invid.identification.quantities import Quantities
from invid.likelihood.unknown_forces.correspondence import Correspondence
from invid.likelihood.unknown_forces.descent import TO_THE_END
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.model.plant import Element, Kind, Structure
from invid.numerics.arrays import Float64

LEAST_FALL = 20.0
"""First-order fall of −2 ln L below which nothing is fitted: half of what a cause has to bring on the records
fitted."""
STARTS = 2
"""Starts that are fitted."""
SMALL, SHARES = 0.03, (0.1, 0.35)
"""Masses of a mode over its host's, and of the loads' inertia of a base, to start from beside that of first
order, where that is no longer small."""
FRACTIONS = 2
"""Continued fractions of a chain with one mass more to start from."""
STRONG = 0.1
"""Unknown force over the strongest from which on an axis may have one mass more."""
HEAVIEST_MODE = 2.0
"""Most mass of a mode over its chain's."""
SURE = 0.5
"""Most deviation of the logarithms of a mass and its spring, and over a base's stiffness, that are known at
all."""
HEAVIEST = 1000.0
"""Most mass of a base over that of its heaviest load."""
NEARLY, HOSTS = 0.3, 3
"""Hosts that are fitted: first-order fall over that of the best, and how many."""

Values = dict[Element, float]


class Addition(ABC):
    """A part that a structure may have besides its chains as they are."""

    cause: str
    """As the contract names it; empty where it is one more mass of the chain."""

    @abstractmethod
    def within(self, structure: Structure) -> Structure:
        """The structure with it."""

    def numbers(self, structure: Structure) -> int:
        """Numbers that it brings: mass, spring and damper."""
        return 3

    @abstractmethod
    def spot(self, structure: Structure) -> Spot:
        """The place in a structure without it that it hangs on."""

    @abstractmethod
    def starts(self, now: FittedHypothesis, looked: Scan) -> list[Values]:
        """Its values at the peaks of a scan."""

    def fractions(self, now: FittedHypothesis) -> list[Values]:
        """Its values, and those of the chain that it belongs to, by what does not know the fit."""
        return []

    @abstractmethod
    def is_real(self, now: FittedHypothesis) -> bool:
        """Return whether records can show what was found."""


class AddedMass(Addition):
    """One more mass on a spring behind a coordinate."""

    @abstractmethod
    def ends(self, wider: Structure) -> tuple[int, int]:
        """Coordinates of its host and of its mass in the structure with it; the host's is as without it."""

    def spot(self, structure: Structure) -> Spot:
        host = self.ends(self.within(structure))[0]
        motor = host in structure.motor
        return Spot(Where.MOTOR, structure.motor.index(host)) if motor else Spot(Where.MASS, host)

    def starts(self, now: FittedHypothesis, looked: Scan) -> list[Values]:
        wider = self.within(now.hypothesis.structure)
        host, at = self.ends(wider)
        whole = float(now.numbers.plant.of_kind(Kind.MASS)[host])
        out = []
        for peak in looked.peaks([(host, host)], LEAST_FALL):
            for share in _shares(float(peak.sizes[0]) / whole):
                mass = share * whole
                values = _spring(peak, mass, Element(Kind.SPRING, host, at))
                values |= {Element(Kind.MASS, at): mass, Element(Kind.MASS, host): whole - mass}
                out.append(values | self.carried(now, wider, share))
        return out

    def fractions(self, now: FittedHypothesis) -> list[Values]:
        """Values of the whole chain with the mass at its end, by continued fractions."""
        wider = self.within(now.hypothesis.structure)
        host, at = self.ends(wider)
        axis, plant = wider.axis_of(host), now.numbers.plant
        first = wider.motor[axis]
        chain = [*(i for i in range(first, host + 1)), at]
        if host != first + now.hypothesis.structure.sizes[axis] - 1:
            return []
        out = []
        for (masses, springs), _ in fraction_chains(now.bench.stacks, axis, len(chain), most=FRACTIONS):
            values = {Element(Kind.MASS, i): float(m) for i, m in zip(chain, masses, strict=True)}
            for a, b, m, k in zip(chain[:-1], chain[1:], masses[1:], springs, strict=True):
                peak = Resonance(float(np.sqrt(k / m)), DAMPING, 0.0, masses)
                values |= _spring(peak, float(m), Element(Kind.SPRING, a, b))
            share = float(masses[-1]) / plant.of_kind(Kind.MASS)[host]
            out.append(values | self.carried(now, wider, min(share, 1.0)))
        return out

    def carried(self, now: FittedHypothesis, wider: Structure, share: float) -> Values:
        """What moves from the host to the mass."""
        return {}

    def is_real(self, now: FittedHypothesis) -> bool:
        structure, plant = now.hypothesis.structure, now.numbers.plant
        host, at = self.ends(structure)
        link = structure.links.index((host, at))
        mass, spring = plant.of_kind(Kind.MASS), plant.of_kind(Kind.SPRING)[link]
        numbers = [structure.index(Kind.MASS).start + at, structure.index(Kind.SPRING).start + link]
        deviation = np.sqrt(np.diag(now.fit.covariance)[numbers])
        axis = structure.axis_of(at)
        chain = mass[structure.motor[axis] : structure.load[axis] + 1].sum()
        frequency = np.sqrt(spring / mass[at]) / top(now)
        return bool(
            deviation.max() < SURE and mass[at] < HEAVIEST_MODE * chain and BAND[0] < frequency < BAND[1]
        )


@dataclass(frozen=True)
class Mode(AddedMass):
    """A mass on a spring at a coordinate of a chain, beside what the chain carries."""

    host: int
    cause = "extra_mode"

    def within(self, structure: Structure) -> Structure:
        return replace(structure, modes=(*structure.modes, self.host))

    def ends(self, wider: Structure) -> tuple[int, int]:
        return self.host, sum(wider.sizes) + wider.modes.index(self.host)


@dataclass(frozen=True)
class FurtherMass(AddedMass):
    """A mass at the end of a chain, which then carries the couplings."""

    axis: int
    cause = ""

    def within(self, structure: Structure) -> Structure:
        sizes = tuple(n + (i == self.axis) for i, n in enumerate(structure.sizes))
        last = structure.load[self.axis]
        return replace(structure, sizes=sizes, modes=tuple(h + (h > last) for h in structure.modes))

    def ends(self, wider: Structure) -> tuple[int, int]:
        last = wider.load[self.axis]
        return last - 1, last

    def carried(self, now: FittedHypothesis, wider: Structure, share: float) -> Values:
        coupling = now.numbers.plant.of_kind(Kind.COUPLING)
        joined = zip(wider.elements[wider.index(Kind.COUPLING)], coupling, strict=True)
        mass = wider.load[self.axis]
        return {e: float(c * np.sqrt(share)) for e, c in joined if mass in (e.a, e.b)}


@dataclass(frozen=True)
class Base(Addition):
    """The body under all loads on a spring to ground."""

    cause = "base_compliance"

    def numbers(self, structure: Structure) -> int:
        return 2 + structure.motors  # its mass is one with the scale of its couplings

    def within(self, structure: Structure) -> Structure:
        return replace(structure, base=True)

    def spot(self, structure: Structure) -> Spot:
        return Spot(Where.MOTOR, 0)

    def starts(self, now: FittedHypothesis, looked: Scan) -> list[Values]:
        wider = self.within(now.hypothesis.structure)
        at = wider.coordinates - 1
        inertia = load_inertia(now.hypothesis.structure, now.numbers.plant.values)
        mass = float(np.exp(np.log(np.diag(inertia)).mean()))
        out = []
        for peak in looked.peaks(looked.loads, LEAST_FALL):
            matrix = np.zeros(inertia.shape)
            matrix[np.triu_indices(inertia.shape[0])] = peak.sizes
            size, direction = np.linalg.eigh(matrix, UPLO="U")
            if size[-1] <= 0.0:
                continue
            force = direction[:, -1] * np.sqrt(mass)
            part = float(force @ np.linalg.solve(inertia, force)) / mass
            for share in _shares(float(size[-1]) * part):
                coupling = force * np.sqrt(share / part)
                values = _spring(peak, mass, Element(Kind.SPRING, at))
                values[Element(Kind.MASS, at)] = mass
                values |= {
                    Element(Kind.COUPLING, load, at): float(c)
                    for load, c in zip(wider.load, coupling, strict=True)
                }
                out.append(values)
        return out

    def is_real(self, now: FittedHypothesis) -> bool:
        structure, plant = now.hypothesis.structure, now.numbers.plant
        own, _ = base_of(structure, plant.values)
        frequency = np.sqrt(own["stiffness"] / (own["mass"] + own["carried"])) / top(now)
        heaviest = max(plant.of_kind(Kind.MASS)[i] for i in structure.load)
        stiffness = Quantities.of(now).estimate(
            lambda x: base_of(structure, plant.moved(x).values)[0]["stiffness"], [*range(plant.x.size)], None
        )
        return bool(
            0.0 < own["mass"] < HEAVIEST * heaviest
            and BAND[0] < frequency < BAND[1]
            and stiffness.std is not None
            and stiffness.std < SURE * stiffness.value
        )


def additions_of(structure: Structure) -> tuple[Addition, ...]:
    """What a structure has besides its chains."""
    return (*(Mode(h) for h in structure.modes), *((Base(),) if structure.base else ()))


def _shares(first: float) -> tuple[float, ...]:
    return (first,) if first < SMALL else SHARES if first > SHARES[-1] else (first, *SHARES)


def _spring(peak: Resonance, mass: float, spring: Element) -> Values:
    """A spring on which a mass swings, and its damper."""
    stiffness = peak.frequency**2 * mass
    damper = Element(Kind.DAMPER, spring.a, spring.b)
    return {spring: stiffness, damper: 2 * peak.damping * peak.frequency * mass}


def base_of(structure: Structure, values: Float64) -> tuple[dict[str, float], Float64]:
    """Mass, that of what it ``carries``, stiffness and damping ratio of a base, and (M,) its loads' shares.

    The base moves as the load that takes most part: its share is one. With c (M,) the base's couplings and J
    the inertia of the loads, shares are J⁻¹c, scaled so.
    """
    mass, spring, damper, coupling = (
        values[structure.index(k)] for k in (Kind.MASS, Kind.SPRING, Kind.DAMPER, Kind.COUPLING)
    )
    inertia = load_inertia(structure, values)
    shares = np.asarray(np.linalg.solve(inertia, coupling[-structure.motors :]), dtype=np.float64)
    scale = 1.0 / float(shares[np.argmax(np.abs(shares))])
    shares = shares * scale
    carried = float(shares @ inertia @ shares)
    out = {
        "mass": float(mass[-1]) * scale**2 - carried,
        "carried": carried,
        "stiffness": float(spring[-1]) * scale**2,
        "damping_ratio": float(damper[-1]) / (2.0 * float(np.sqrt(spring[-1] * mass[-1]))),
    }
    return out, shares


def load_inertia(structure: Structure, values: Float64) -> Float64:
    """(M, M) inertia of the loads."""
    out: Float64 = np.diag(values[structure.index(Kind.MASS)][list(structure.load)])
    for (i, j), c in zip(structure.pairs, values[structure.index(Kind.COUPLING)], strict=False):
        out[i, j] = out[j, i] = c
    return out


def add(now: FittedHypothesis, addition: Addition, looked: Scan) -> FittedHypothesis | None:
    """A short fit with an addition; none where no start has a value.

    The best starts of the scan compete with those of continued fractions where the fit is not home: a scan at
    numbers that are bent cannot judge them.
    """
    structure = now.hypothesis.structure
    moved = Correspondence.of(structure, addition.within(structure))
    tried = []
    for starts in (addition.starts(now, looked), [] if is_settled(now) else addition.fractions(now)):
        pool = []
        for values in starts:
            with suppress(np.linalg.LinAlgError):
                pool.append(now.in_structure(moved, values, 0))
        tried += [f.refit(iterations=6) for f in sorted(pool, key=expected)[:STARTS]]
    best: FittedHypothesis | None = None
    for start in sorted(tried, key=lambda f: f.total)[:STARTS]:
        found = start.refit(target=np.inf if best is None else best.total)
        best = found if best is None or found.total < best.total else best
    return best


def additions(now: FittedHypothesis, looked: Scan, *, growing: bool) -> list[Addition]:
    """What is worth a fit: hosts by the falls of the scan, loads of axes on which an unknown force is strong,
    a base where there are several loads.

    From one motor no host can be told from another. Where the number of masses is not known (``growing``) a
    chain may be longer.
    """
    structure = now.hypothesis.structure
    hosts = [h for h in range(sum(structure.sizes)) if h not in structure.modes]
    if structure.motors == 1:
        hosts = [h for h in hosts if h in structure.load]
    falls = {h: looked.fall([(h, h)]) for h in hosts}
    best = max([LEAST_FALL, *falls.values()])
    leaders = sorted((h for h in hosts if falls[h] > NEARLY * best), key=lambda h: -falls[h])[:HOSTS]
    bent = [structure.load[axis] for axis in axes_with_force(now)]
    leaders += [h for h in bent if h in hosts and h not in leaders]
    longer = [h for h in leaders if growing and h in structure.load]
    out: list[Addition] = [FurtherMass(structure.load.index(h)) for h in longer]
    out += [Mode(h) for h in leaders if not growing or structure.motors > 1]
    if structure.motors > 1 and not structure.base and looked.fall(looked.loads) > LEAST_FALL:
        out.append(Base())
    return out


def axes_with_force(now: FittedHypothesis) -> list[int]:
    """Axes with an unknown force behind the motor that is no tenth of the strongest; none where none
    counts."""
    if is_settled(now):
        return []
    structure = now.hypothesis.structure
    out: list[int] = []
    for rms, spot in now.strength:
        if spot.where is Where.MOTOR or rms < STRONG * now.inner_strength:
            continue
        if spot.where is Where.PAIR:
            out += [spot.number, spot.other]
        else:
            link = spot.where is Where.SPRING
            out.append(structure.axis_of(structure.links[spot.number][0] if link else spot.number))
    return list(dict.fromkeys(out))


def without(now: FittedHypothesis, addition: Addition, iterations: int = TO_THE_END) -> FittedHypothesis:
    """The fit with an addition taken out, its mass put back on its host."""
    structure, values = now.hypothesis.structure, {}
    if isinstance(addition, Mode):
        fewer = replace(structure, modes=tuple(h for h in structure.modes if h != addition.host))
        mass = now.numbers.plant.of_kind(Kind.MASS)
        values[Element(Kind.MASS, addition.host)] = float(sum(mass[[*addition.ends(structure)]]))
    else:
        fewer = replace(structure, base=False)
    return now.in_structure(Correspondence.of(structure, fewer), values, iterations)
