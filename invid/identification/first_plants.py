"""Plants to start from: two classes that fail in different places, so that they compete apart.

*Random splits*: the inertia of each chain from its slowest lines, shared out at random, springs at random
frequencies of the band. *Continued fractions*: interlaced zeros and poles on a grid against the motor's own
dynamic stiffness, each set made a chain by Cauer's continued fraction of the lossless stiffness

    Z(λ) = −M λ Π(1 − λ/p_k)/Π(1 − λ/z_k),   λ = ω².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.polynomial import polynomial
from scipy.optimize import nnls

from invid.identification.own_stiffness import ALL, NOTHING, SOME, follow
from invid.likelihood.unknown_forces.stack import Stack
from invid.model.plant import Kind, Plant, Structure
from invid.numerics.arrays import Float64, Int64
from invid.numerics.linear_algebra import least_squares, real_rows
from invid.signals.band import apparent_inertia, hann
from invid.signals.record import Record

DAMPING_RATIO = 0.02
"""Of every spring at the start."""
LEAST_REST = 0.1
"""Of a chain's inertia that is split where what is kept holds more of it."""
SPLIT = 4.0
"""Concentration of the random shares: of two masses one is rarely less than a tenth of the other."""
FREQUENCIES = (0.06, 1.1)
"""Range of the springs' own frequencies over the highest of elasticity."""
GRIDS = {1: 60, 2: 26, 3: 19, 4: 15}
"""Frequencies of the grid by the number of zeros: ten thousand sets at most."""
LOWEST = 0.08
"""Lowest frequency of the grid over the highest of elasticity."""
RIGID_END, BENT, BEYOND = 10, 0.3, 1.3
"""Share of the highest lines that may show a motor's own mass; logarithm by which its stiffness differs from
that where chains bend it; and how far beyond there a pole may be."""
CLOSED = 0.01
"""Jump from a record's start to its end over its range up to which it closes (numerical)."""
BAND_LINES = 3
"""Lines of a record without a period whose median counts: its ends bend single ones."""
FEW_LINES = 8
"""Lines of a record below which those of all records are taken together: five numbers of two masses."""
RIGID = 3.0
"""Lines beyond the highest frequency of elasticity, over it, that chains are compared on."""
APART = 2
"""Sets of zeros and poles that differ by less than so many points of the grid are one."""
LOOKED, FOLLOWED = 2000, 20
"""Sets that are looked at, and chains that are made of them and follow the stiffness."""
GROWING, CLOSE = 2, 0.03
"""Chains of one mass less that grow by a close pair of a zero and a pole, and half their distance in λ."""
SAME = 0.2
"""Chains whose logarithms differ less are one start."""
BLUNT = 0.01
"""Squared loss of the resonances that are compared."""
GROWN, TORN = (0.15, 0.3, 0.5, 0.8), 0.4
"""Frequencies of a mass that is split off, over the highest excited one, and its share."""
STILL = 1e-3
"""Motion over the largest of a line below which motors stand still in every record."""
SLOW = (0.025, 0.13)
"""Lines that show a chain's whole inertia, over the highest of elasticity."""

Chain = tuple[Float64, Float64]
"""Masses and springs."""


@dataclass(frozen=True)
class OwnStiffness:
    """How a motor's own stiffness is followed.

    ``in_bands``: in bands, where the ends of records bend single lines; ``friction``: beside friction of the
    motor, which a ripple looks like as well; ``ground``: beside a spring from its load to those of other
    axes; both as ``follow`` has them.
    """

    in_bands: bool = False
    friction: float = NOTHING
    ground: float = NOTHING


ALONE, IN_BANDS = OwnStiffness(), OwnStiffness(in_bands=True)
RUBBING, TIED = OwnStiffness(friction=SOME), OwnStiffness(friction=SOME, ground=ALL)


def total_inertias(stacks: Sequence[Stack], tops: Sequence[float]) -> Float64:
    """(M,) inertia of each chain from its slowest lines, beside viscous and dry friction; ``tops`` (M,) as
    ``elastic_top``."""
    out = np.ones(len(tops))
    for m, top in enumerate(tops):
        rows, right = [], []
        for stack in stacks:
            omega = stack.omega
            torque = stack.parts.sum(axis=0)
            for k, record in enumerate(stack.records):
                if not record.driven[m]:
                    continue
                size = np.abs(stack.parts[0, k, :, m])
                use = (omega > SLOW[0] * top) & (omega < SLOW[1] * top) & (size > 0.1 * size.max())
                if use.sum() < 3:
                    use = (omega > 0) & (omega < 2 * SLOW[1] * top)
                w, theta = omega[use], stack.position[k, use, m]
                speed = 1j * w * theta + 2.0 / record.span * record.jump[m]
                bend = record.motion.velocity[-1, m] - record.motion.velocity[0, m]
                rows.append(
                    np.stack(
                        (1j * w * speed + 2.0 / record.span * bend, speed, speed / (np.abs(speed) + 1e-300)),
                        axis=1,
                    )
                )
                right.append(torque[k, use, m])
        if rows:
            out[m] = least_squares(real_rows(np.concatenate(rows)), real_rows(np.concatenate(right)))[0]
    least: Float64 = np.maximum(out, 1e-3 * np.abs(out).max())
    return least


def chain_lengths(structure: Structure) -> tuple[int, ...]:
    """Masses of each chain, with that of a mode at its end."""
    return tuple(
        n + (load in structure.modes) for n, load in zip(structure.sizes, structure.load, strict=True)
    )


def plant_of_chains(structure: Structure, chains: Sequence[Chain]) -> Plant:
    """The plant of uncoupled chains, each as long as ``chain_lengths``; the last mass beyond its load is the
    mode's."""
    pairs = list(zip(structure.sizes, chains, strict=True))
    at_ends = [pairs[structure.load.index(host)] for host in structure.modes]
    mass = np.concatenate([*(m[:n] for n, (m, _) in pairs), *(m[n:] for n, (m, _) in at_ends)])
    spring = np.concatenate([*(k[: n - 1] for n, (_, k) in pairs), *(k[n - 1 :] for n, (_, k) in at_ends)])
    none = np.zeros(2 * len(structure.pairs))
    return Plant.of_values(structure, np.concatenate((mass, spring, _dampers(structure, mass, spring), none)))


def random_plants(
    stacks: Sequence[Stack], structure: Structure, count: int, rng: np.random.Generator
) -> list[Plant]:
    """Random splits of the chains' inertia."""
    tops = [_top(stacks, m) for m in range(structure.motors)]
    total = total_inertias(stacks, tops)
    out = []
    for _ in range(count):
        chains = []
        for whole, top, n in zip(total, tops, chain_lengths(structure), strict=True):
            chains.append(_random_chain((np.zeros(0), np.zeros(0)), n, whole, top, rng))
        out.append(plant_of_chains(structure, chains))
    return out


def _random_chain(known: Chain, masses: int, whole: float, top: float, rng: np.random.Generator) -> Chain:
    """A chain that begins as is known, the rest of its inertia at random."""
    first = known[0].size
    rest = rng.dirichlet(np.full(masses - first, SPLIT)) * max(
        whole - float(known[0].sum()), LEAST_REST * whole
    )
    mass = np.concatenate((known[0], rest))
    frequency = top * np.exp(rng.uniform(np.log(FREQUENCIES[0]), np.log(FREQUENCIES[1]), masses - 1))
    spring = frequency**2 / (1 / mass[:-1] + 1 / mass[1:])
    spring[:first] = known[1]
    return mass, spring


def split_plants(
    stacks: Sequence[Stack], plant: Plant, place: tuple[int, int], count: int, rng: np.random.Generator
) -> list[Plant]:
    """Random splits of one chain from a mass on, what is before it and the others as they are.

    What is before the first place at which something unknown acts moves at high frequencies as it does.

    Parameters
    ----------
    place
        The axis, and how many of its masses stay, each with the spring behind it.
    """
    axis, kept = place
    mass, spring = chains_of_plant(plant)[axis]
    top, whole = _top(stacks, axis), float(mass.sum())
    begins = mass[:kept], spring[:kept]
    return [_with_chain(plant, axis, _random_chain(begins, mass.size, whole, top, rng)) for _ in range(count)]


def _with_chain(plant: Plant, axis: int, chain: Chain) -> Plant:
    """The plant with another chain; of what else is behind the motors as it was only masses, springs, those
    between loads too, and a base stay."""
    structure, values, was = plant.structure, plant.values.copy(), plant.of_kind(Kind.MASS)
    masses, links = _chain_places(structure)[axis]
    mass, spring = values[structure.index(Kind.MASS)], values[structure.index(Kind.SPRING)]
    mass[masses], spring[links] = chain
    values[structure.index(Kind.DAMPER)][: len(structure.links)] = _dampers(structure, mass, spring)
    for p, e in enumerate(structure.elements):
        if e.joins_axes:
            on_base = structure.base and e.b == structure.coordinates - 1
            values[p] *= np.sqrt(mass[e.a] / was[e.a]) if on_base else float(e.kind is Kind.LOAD_SPRING)
    return Plant.of_values(structure, values)


def grown_plants(plant: Plant, structure: Structure, top_hz: float) -> list[Plant]:
    """Plants of ``structure`` from one with fewer masses: in each chain that is longer one mass is split.

    A mode that shows little is beside the others where they are, not where their starts put it.
    """
    old, chains, out = plant.structure, chains_of_plant(plant), []
    for split in range(max(old.sizes)):
        for share in GROWN:
            stiffness = (2 * np.pi * share * top_hz) ** 2 * TORN * (1.0 - TORN)
            out.append(
                plant_of_chains(
                    structure,
                    [
                        _split(m, k, min(split, m.size - 1), stiffness) if n > m.size else (m, k)
                        for (m, k), n in zip(chains, structure.sizes, strict=True)
                    ],
                )
            )
    return out


def chains_of_plant(plant: Plant) -> list[Chain]:
    """Masses and springs of every chain, with a mode at its end."""
    mass, spring = plant.of_kind(Kind.MASS), plant.of_kind(Kind.SPRING)
    return [(mass[masses], spring[links]) for masses, links in _chain_places(plant.structure)]


def _chain_places(structure: Structure) -> list[tuple[list[int], list[int]]]:
    """Coordinates and springs of every chain, with a mode at its end."""
    chains, link = [], 0
    for first, n, load in zip(structure.motor, structure.sizes, structure.load, strict=True):
        masses, links = list(range(first, first + n)), list(range(link, link + n - 1))
        if load in structure.modes:
            masses.append(sum(structure.sizes) + structure.modes.index(load))
            links.append(structure.links.index((load, masses[-1])))
        chains.append((masses, links))
        link += n - 1
    return chains


def _dampers(structure: Structure, mass: Float64, spring: Float64) -> Float64:
    """Dampers of all springs but a base's."""
    reduced = np.array([1 / (1 / mass[a] + 1 / mass[b]) for a, b in structure.links]).reshape(-1)
    return np.asarray(2 * DAMPING_RATIO * np.sqrt(spring[: reduced.size] * reduced), dtype=np.float64)


def _split(mass: Float64, spring: Float64, at: int, stiffness: float) -> Chain:
    parts = mass[at] * np.array([1.0 - TORN, TORN])
    masses = np.concatenate((mass[:at], parts, mass[at + 1 :]))
    return masses, np.insert(spring, at, stiffness * mass[at])


def fraction_plants(
    stacks: Sequence[Stack], structure: Structure, followed: OwnStiffness = ALONE
) -> list[Plant]:
    """Chains by continued fractions: the best of every axis, then each axis and all at their next best."""
    chains = [fraction_chains(stacks, m, n, followed) for m, n in enumerate(chain_lengths(structure))]
    if not all(chains):
        return []
    motors = structure.motors
    choices = [[0] * motors, [1] * motors, [2] * motors]
    if motors > 1:
        choices += [[int(a == b) for a in range(motors)] for b in range(motors)]
    seen: dict[tuple[int, ...], None] = {}
    for choice in choices:
        seen[tuple(min(c, len(found) - 1) for c, found in zip(choice, chains, strict=True))] = None
    return [_tied([found[c] for c, found in zip(choice, chains, strict=True)], structure) for choice in seen]


def _tied(chains: Sequence[tuple[Chain, float]], structure: Structure) -> Plant:
    """The plant of chains whose loads springs between them hold as they are held."""
    plant = plant_of_chains(structure, [chain for chain, _ in chains])
    held = np.array([ground for _, ground in chains])
    ends = np.array([[float(i in pair) for pair in structure.pairs] for i in range(structure.motors)])
    values = plant.values.copy()
    if structure.pairs and held.all():
        # Relatively: a chain that is astray makes its spring too strong.
        values[structure.index(Kind.LOAD_SPRING)] = nnls(ends / held[:, None], np.ones(held.size))[0]
    return Plant.of_values(structure, values)


def fraction_chains(
    stacks: Sequence[Stack], motor: int, masses: int, followed: OwnStiffness = ALONE, most: int = 4
) -> list[tuple[Chain, float]]:
    """Chains whose zeros and poles follow the motor's own stiffness best, the best first, each with the
    spring that holds its load."""
    in_bands = followed.in_bands
    zeros = masses - 1
    if zeros == 0:
        omega, size = own_stiffness(stacks, motor, in_bands=in_bands)
        return [((np.array([np.exp(np.median(np.log(size / omega**2)))]), np.zeros(0)), 0.0)]
    looked = _interlaced(stacks, motor, zeros, in_bands=in_bands)
    if looked is None:
        return []
    grid, sets, inertia, misfit = looked
    starts: list[Float64] = []
    taken: list[int] = []
    for k in np.argsort(misfit)[:LOOKED]:
        if any(np.abs(sets[k] - sets[j]).max() < APART for j in taken):
            continue
        taken.append(int(k))
        chain = cauer_chain(float(np.exp(inertia[k])), grid[sets[k, 1::2]] ** 2, grid[sets[k, 0::2]] ** 2)
        if all((part > 0).all() for part in chain):
            starts.append(np.concatenate(chain))
        if len(starts) >= FOLLOWED:
            break
    for chain, _ in fraction_chains(stacks, motor, masses - 1, followed, GROWING):
        starts += _with_close_pair(chain, grid)
    if not starts:
        return []
    own = own_stiffness(stacks, motor, in_bands=in_bands)
    found, loss = follow(*own, np.array(starts), followed.friction, followed.ground)
    out: list[Float64] = []
    for k in np.argsort(loss):
        if all(np.abs(np.log(found[k] / other))[:-1].max() > SAME for other in out):
            out.append(found[k])
    return [((chain[:masses], chain[masses:-1]), float(chain[-1])) for chain in out[:most]]


def _with_close_pair(chain: Chain, grid: Float64) -> list[Float64]:
    """Masses, then springs, of a chain with one more zero and pole close together about a frequency between
    points of the grid each.

    On the grid they would be wide apart; a mode that shows little is a narrow pair anywhere.
    """
    mass, spring = chain
    stiffness = np.diag(np.append(spring, 0.0) + np.insert(spring, 0, 0.0))
    stiffness -= np.diag(spring, 1) + np.diag(spring, -1)
    scaled = stiffness / np.sqrt(mass[:, None] * mass)
    poles, zeros = np.linalg.eigvalsh(scaled)[1:], np.linalg.eigvalsh(scaled[1:, 1:])
    out = []
    for middle in grid[:-1] * grid[1:]:
        nearer, further = middle * (1.0 - CLOSE), middle * (1.0 + CLOSE)
        first = (zeros < middle).sum() == (poles < middle).sum()
        zero, pole = (nearer, further) if first else (further, nearer)
        grown = cauer_chain(
            float(mass.sum()), np.sort(np.append(poles, pole)), np.sort(np.append(zeros, zero))
        )
        if all((part > 0).all() for part in grown):
            out.append(np.concatenate(grown))
    return out


def masses_seen(stacks: Sequence[Stack], motor: int) -> int:
    """Number of masses whose zeros and poles follow a motor's own stiffness best.

    The grid of a further zero and pole is coarser, so that one that is not there does worse.
    """
    omega, size = own_stiffness(stacks, motor)
    level = np.log(size / omega**2)
    misfits = [float(np.abs(level - np.median(level)).mean())]
    for zeros in GRIDS:
        looked = _interlaced(stacks, motor, zeros)
        if looked is not None:
            misfits.append(float(looked[3].min()))
    return int(np.argmin(misfits)) + 1


def _interlaced(
    stacks: Sequence[Stack], motor: int, zeros: int, *, in_bands: bool = False
) -> tuple[Float64, Int64, Float64, Float64] | None:
    """Grid of frequencies, sets of interlaced zeros and poles (S, 2·zeros) on it, and (S,) each set's inertia
    and mean misfit of the logarithm; none where there are too few lines."""
    omega, size = own_stiffness(stacks, motor, in_bands=in_bands)
    if zeros not in GRIDS or omega.size < 2 * zeros + 2:
        return None
    top = elastic_top(omega, size)
    within = omega < RIGID * top
    omega, size = omega[within], size[within]
    keep = slice(None, None, max(1, omega.size // 70))
    omega, level = omega[keep], np.log(size[keep] / omega[keep] ** 2)
    grid = np.exp(np.linspace(np.log(LOWEST * top), np.log(1.3 * top), GRIDS[zeros]))
    ratio = (omega[:, None] / grid) ** 2
    each = 0.5 * np.log((1 - ratio) ** 2 + BLUNT * ratio).T
    sets = np.array(list(combinations(range(grid.size), 2 * zeros)))
    shape = each[sets[:, 1::2]].sum(axis=1) - each[sets[:, 0::2]].sum(axis=1)
    inertia = np.median(level - shape, axis=1)
    return grid, sets, inertia, np.abs(level - shape - inertia[:, None]).mean(axis=1)


def elastic_top(omega: Float64, size: Float64) -> float:
    """Frequency [rad/s] above which a motor's own stiffness is that of a mass alone, or the highest line."""
    level = np.log(size / omega**2)
    apart = np.abs(level - np.median(level[-max(level.size // RIGID_END, 3) :])) > BENT
    # Of three neighbours that all differ none is noise.
    beyond = np.flatnonzero(np.convolve(apart, np.ones(3), mode="same") > 2.5)
    last = int(beyond[-1]) if beyond.size else level.size - 1
    return float(min(omega[-1], BEYOND * omega[last]))


def _top(stacks: Sequence[Stack], motor: int) -> float:
    """``elastic_top`` of a motor; of too few lines the highest frequency that is excited."""
    omega, size = own_stiffness(stacks, motor)
    return elastic_top(omega, size) if omega.size >= FEW_LINES else 2 * np.pi * stacks[0].records[0].top_hz


def own_stiffness(stacks: Sequence[Stack], motor: int, *, in_bands: bool = False) -> tuple[Float64, Float64]:
    """Lines [rad/s] and |Z| of a motor with the other motors still, by least squares over the records.

    Where there are fewer records than motors, torque over motion of the records that drive it; where a
    record has no period, torque over motion in bands, which its ends do not bend. Where every record has few
    lines of its own (stepped sines), or no stack drives all motors apart, those of all.
    """
    stack = max(stacks, key=lambda s: s.count)
    driven = [s for s in stacks if any(r.driven[motor] for r in s.records)]
    if in_bands or not stack.records[0].periods:
        if stack.count >= stack.position.shape[2] or not driven:
            return _stiffness_in_bands(stack, motor)
        each = [_stiffness_in_bands(s, motor) for s in driven]
    else:
        omega, size = _stiffness_on_lines([s for s in stacks if np.array_equal(s.omega, stack.omega)], motor)
        if omega.size >= FEW_LINES:
            return omega, size
        each = [_stiffness_on_lines([s], motor) for s in driven]
    omega, size = (np.concatenate(part) for part in zip(*each, strict=True))
    order = np.argsort(omega)
    return omega[order], size[order]


def closes(record: Record) -> bool:
    """Return whether the motion ends where it began: else its ends bend every line."""
    return bool((np.abs(record.jump) <= CLOSED * np.ptp(record.motion.position, axis=0)).all())


def _stiffness_on_lines(alike: Sequence[Stack], motor: int) -> tuple[Float64, Float64]:
    parts, position = (
        np.concatenate(x, axis=-3) for x in zip(*((s.parts, s.position) for s in alike), strict=True)
    )
    records = [r for s in alike for r in s.records]
    torque = parts.sum(axis=0)
    driven = np.abs(parts[0]).max(axis=(0, 2))
    lines = np.flatnonzero((alike[0].omega > 0) & (driven > 0.1 * driven.max()))
    omega = alike[0].omega[lines]
    theta, tau = (x[:, lines].transpose(1, 0, 2) for x in (position, torque))
    if len(records) >= theta.shape[2]:
        return omega, np.abs((np.linalg.pinv(theta, rcond=STILL) @ tau)[:, motor, motor])
    own = [k for k, r in enumerate(records) if r.driven[motor]] or list(range(len(records)))
    power = (np.abs(theta[:, own, motor]) ** 2).sum(axis=1)
    cross = (tau[:, own, motor] * theta[:, own, motor].conj()).sum(axis=1)
    return omega, np.abs(cross) / np.maximum(power, 1e-300)


def _stiffness_in_bands(stack: Stack, motor: int) -> tuple[Float64, Float64]:
    first = stack.records[0]
    within = first.wide <= 2 * np.pi * first.top_hz
    hertz = first.wide[within] / (2 * np.pi)
    own = [r for r in stack.records if r.driven[motor]] or list(stack.records)
    if len(own) >= first.driven.size > 1:
        return _stiffness_of_many(hertz, own, motor)
    seen = apparent_inertia(
        hertz,
        np.array([r.position[within] for r in own]),
        np.array([r.torque[within] for r in own]),
        motor,
        float(np.nan_to_num(own[0].hold[motor])),
    )
    omega = 2 * np.pi * seen.frequency
    return omega, seen.inertia * omega**2


def _stiffness_of_many(hertz: Float64, records: Sequence[Record], motor: int) -> tuple[Float64, Float64]:
    """By least squares over as many records as motors that drive them all, the median of each band."""
    theta, torque = (
        hann(np.array([lines[: hertz.size].T for lines in each])).transpose(2, 0, 1)
        for each in ([r.position for r in records], [r.torque for r in records])
    )
    size = np.abs((np.linalg.pinv(theta, rcond=STILL) @ torque)[:, motor, motor])
    omega = 2 * np.pi * hertz[1:-1]
    bands = np.array_split(np.arange(omega.size), max(1, omega.size // BAND_LINES))
    return (
        np.array([omega[at].mean() for at in bands]),
        np.array([np.median(size[at] / omega[at] ** 2) * omega[at].mean() ** 2 for at in bands]),
    )


def cauer_chain(inertia: float, poles: Float64, zeros: Float64) -> Chain:
    """Masses and springs of the lossless chain with these resonances and (motor fixed) antiresonances
    [rad²/s²]."""
    upper = polynomial.polymul([0.0, -inertia], polynomial.polyfromroots(poles) / np.prod(-poles))
    lower = polynomial.polyfromroots(zeros) / np.prod(-zeros)
    mass, spring = [], []
    for _ in poles:
        first = -upper[-1] / lower[-1]
        rest = polynomial.polyadd(upper, polynomial.polymul([0.0, first], lower))[: lower.size]
        stiffness = rest[-1] / lower[-1]
        lower_rest = polynomial.polysub(lower, rest / stiffness)[: lower.size - 1]
        mass.append(first)
        spring.append(stiffness)
        upper, lower = rest, lower_rest
    mass.append(-upper[-1] / lower[-1])
    return np.array(mass), np.array(spring)
