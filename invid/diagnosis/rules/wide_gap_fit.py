"""A gap as wide as its spring deflects: linear parameters and gap found together, from the measured torque.

The linear fit takes such a spring for a far softer one and the masses for others, and no step leads back from
there. What the torque says of the force in the spring (``loose``) does not depend on that spring at all, so
plain questions find the way: the motor's share of its axis is tried on a grid, each gives the force and the
deflection over time, and of those the spring and the gap follow by regression.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve

from invid.diagnosis.linear_fit import highest_line
from invid.effects.catalogue.backlash import spring_index
from invid.identification.lowest_lines import rigid
from invid.likelihood.evaluation import noise_of, views_of
from invid.likelihood.hypothesis import Layout, acting_of, priors_of
from invid.likelihood.joint_fit import JointFit, limits_of
from invid.likelihood.nuisance.spring_force import PASSES, STAGES, Gap, Reading, law_of, resistance
from invid.likelihood.nuisance.transients import closing_of, ends_of
from invid.likelihood.placed_effect import Term
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.levenberg_marquardt import Parabola, minimise
from invid.numerics.whitening import whitener
from invid.signals.spectral_record import Record

LOOSEST = 10.0
"""Share of the torque to which a law holds that is as good as none."""
SHARES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
"""Of an axis' mass on the motor's side of the spring."""
WIDTHS = tuple(float(w) for w in np.geomspace(0.1, 3.0, 16))
"""Of the gap, over the rms deflection."""
FIRST = 0.1
"""Looseness at which starts are compared and fits begin: wide enough for masses a fifth off."""
SCANNED = 3
"""Records that starts are compared on."""
TRIED = 4
"""Starts that are fitted at most."""
HOLDS = 0.1
"""Cost over rows below which a law holds to well within its looseness, and no other start is tried. A guess,
a third of the looseness."""
LEFT_OPEN = 3.0
"""Cost over rows from which the best fit is no such law. A guess, for the price of going on."""
SOME, FEW = 3, 2
"""Steps of the unknowns while starts are compared, and after each step of the parameters."""
ROUNDED = (0.003, 0.01)
"""Relative errors of masses and springs, and of the gap, besides those that noise makes: beyond the highest
line corners of the law are rounded off. Empirical: seven gaps were 0.3 to 1.3 % too small where the law was
missed by 0.3 to 1.2 % of the torque, one 2.7 % where it was by 4 %; so that share counts as well."""
ITERATIONS, GAINED = 10, 0.01
"""Steps of a stage at most, and the share of its cost that one has to gain."""


@dataclass(frozen=True, eq=False)
class Free:
    """Linear parameters (n,), logarithm of the gap, and what is unknown in every record, at one looseness."""

    p: Float64
    width: float
    unknown: tuple[Float64, ...]
    cost: float


class FreePlay:
    """One spring with a gap in the records, at any looseness of its law."""

    def __init__(self, layout: Layout, records: Sequence[Record], term: Term) -> None:
        self.layout, self.records, self.term = layout, records, term
        self.pattern = term.place.pattern(layout.structure)
        springs = layout.structure.slices["spring"].start, layout.structure.slices["damper"].start
        self.spring, self.damper = (at + spring_index(layout.structure, term.place) for at in springs)

    def readings(self, p: Float64, share: float) -> list[Reading]:
        """Every record at parameters (n,)."""
        out = []
        for view in views_of(self.layout, self.records, p):
            factor = acting_of(view.record, self.layout, p).factor
            missing: Complex128 = (
                np.einsum("fij,fj->fi", view.stiffness, view.record.position) - view.acting - view.images
            )
            covariance = noise_of(view, factor)
            if view.record.transient:
                ends = ends_of(view, self.layout, p)
                view.closing = closing_of(view, ends, whitener(covariance), missing)
            out.append(Reading(view, self.pattern, missing, covariance, share))
        return out

    def gap(self, p: Float64, width: float) -> Gap:
        """The spring at parameters (n,) with a gap of a logarithm."""
        return Gap(float(np.exp(p[self.spring])), float(p[self.damper]), float(np.exp(width)))

    def solved(
        self, p: Float64, width: float, unknown: Sequence[Float64] | None, share: float, passes: int = PASSES
    ) -> Free:
        """The unknowns of every record that fit best."""
        gap, out, cost = self.gap(p, width), [], 0.0
        for number, reading in enumerate(self.readings(p, share)):
            u = np.zeros(reading.count) if unknown is None else unknown[number]
            u = reading.solved(u, gap, passes)
            residual, _ = reading.residual(u, gap)
            out.append(u)
            cost += float(residual @ residual)
        prior, _ = priors_of(self.layout, p, 1)
        return Free(p, width, tuple(out), cost + float(prior @ prior))

    def regressed(self, p: Float64, unknown: Sequence[Float64]) -> tuple[float, float, float]:
        """Share of the force's power that the best gap leaves, its width and its spring, out of force and
        deflection over time."""
        x, f = self._waves(p, unknown)
        size = float(np.std(x))
        found = []
        for width in WIDTHS:
            beyond = x - np.clip(x, -0.5 * width * size, 0.5 * width * size)
            left, springs = _left_by(beyond[:, None], f)
            found.append((left, width * size, float(springs[0])))
        return min(found)

    def against_cubic(self, free: Free) -> tuple[float, float]:
        """Share of the power of the force beside the linear spring that the gap leaves, and what the best
        cubic spring with another stiffness and damper would, in the motion that was read."""
        force, gap, cubic = [], [], []
        loosely = self.solved(free.p, free.width, free.unknown, FIRST)
        for reading, u in zip(self.readings(free.p, FIRST), loosely.unknown, strict=True):
            view, wave = reading.view, reading.deflection(u)
            size = float(np.abs(wave).max())
            rates = (Gap(1.0, 0.0, 0.0), Gap(0.0, 1.0, 0.0))
            own = [resistance(view, wave, one) for one in rates]
            own.append(resistance(view, wave**3 / size**2, rates[0]))
            force.append(reading.unpacked(u)[0])
            gap.append(law_of(view, wave, self.gap(free.p, free.width)))
            cubic.append(np.stack(own, axis=1))
        f, law, columns = np.concatenate(force), np.concatenate(gap), np.concatenate(cubic)
        real, rows = np.concatenate((f.real, f.imag)), np.concatenate((columns.real, columns.imag))
        left = float((np.abs(f - law) ** 2).sum()) / max(float((np.abs(f) ** 2).sum()), 1e-300)
        return left, _left_by(rows, real)[0]

    def _waves(self, p: Float64, unknown: Sequence[Float64]) -> tuple[Float64, Float64]:
        """(n,) deflection and force of the spring over time, all records one after the other."""
        motion, force = [], []
        for reading, u in zip(self.readings(p, LOOSEST), unknown, strict=True):
            wave = reading.deflection(u)
            beside = reading.unpacked(u)[0].copy()
            beside[0] = 0.0
            motion.append(wave - wave.mean())
            force.append(np.exp(p[self.spring]) * motion[-1] + reading.view.record.to_wave(beside))
        return np.concatenate(motion), np.concatenate(force)

    def fitted(self, start: Free, share: float, limits: tuple[Float64, Float64]) -> Free:
        """Levenberg–Marquardt over parameters and gap; the unknowns of each record are eliminated."""
        structure, count = self.layout.structure, self.layout.count
        low, high = (np.append(bound, edge) for bound, edge in zip(limits, (-np.inf, np.inf), strict=True))
        limited = np.append(
            np.concatenate((structure.logarithmic, np.zeros(count - structure.count, bool))), True
        )
        answers: list[
            tuple[Float64, Float64]
        ] = []  # of the point that was asked last, which is where steps begin

        def parabola(here: Free) -> Parabola:
            nonlocal answers
            normal, slope, answers = self._normal(here, share)
            v = np.append(here.p, here.width)
            move = ~(((v <= low) & (slope > 0)) | ((v >= high) & (slope < 0))) & (np.diag(normal) > 0)
            return Parabola.of_normal(normal, slope, move)

        def moved(here: Free, step: Float64) -> Free | None:
            v = np.append(here.p, here.width)
            trial = np.clip(v + step, low, high)
            return self._tried(trial, here, answers, trial - v, share)

        begun = self.solved(start.p, start.width, start.unknown, share)
        return minimise(begun, parabola, moved, limited=limited, iterations=ITERATIONS, gain=GAINED).point

    def covariance(self, free: Free) -> Float64:
        """(n + 1, n + 1) of parameters and logarithm of the gap, what the law misses counted as noise.

        Infinite where the records do not see them.
        """
        normal, _, _ = self._normal(free, STAGES[-1])
        rows = sum(2 * r.torque.size for r in self.records)
        scale = np.sqrt(np.diag(normal))
        blind = scale == 0.0
        scale[blind] = 1.0
        size, along = np.linalg.eigh(normal / scale[:, None] / scale)
        seen = size > 1e-12 * size[-1]
        out = (along[:, seen] / size[seen]) @ along[:, seen].T * max(1.0, free.cost / rows)
        lost = np.flatnonzero(blind | (np.abs(along[:, ~seen]) > 0.1).any(axis=1))
        out = out / scale[:, None] / scale
        structure = self.layout.structure
        out[np.diag_indices(structure.count)] += np.where(structure.logarithmic, ROUNDED[0], 0.0) ** 2
        out[-1, -1] += ROUNDED[1] ** 2 + STAGES[-1] ** 2 * free.cost / rows
        out[lost, lost] = np.inf
        return np.asarray(out, dtype=np.float64)

    def _tried(
        self, v: Float64, here: Free, answers: Sequence[tuple[Float64, Float64]], step: Float64, share: float
    ) -> Free | None:
        """What is at ``v`` (n + 1,), the unknowns moved along; none where no plant is."""
        if not self.layout.structure.admissible(v[: self.layout.structure.count]):
            return None
        unknown = [u + own + moved @ step for u, (own, moved) in zip(here.unknown, answers, strict=True)]
        with np.errstate(all="ignore"):
            try:
                return self.solved(v[:-1], float(v[-1]), unknown, share, FEW)
            except (np.linalg.LinAlgError, ValueError):
                return None

    def _normal(self, here: Free, share: float) -> tuple[Float64, Float64, list[tuple[Float64, Float64]]]:
        """Normal matrix (n + 1, n + 1) and slope of parameters and gap with the unknowns eliminated, and by
        how much those of each record move: by themselves and for each parameter."""
        gap, readings = self.gap(here.p, here.width), self.readings(here.p, share)
        states = [r.residual(u, gap) for r, u in zip(readings, here.unknown, strict=True)]
        columns: list[list[Float64]] = [[] for _ in readings]
        for k in range(here.p.size + 1):
            p, width = here.p.copy(), here.width
            h = self._step(here.p, k)
            if k < p.size:
                p[k] += h
                moved = self.readings(p, share)
            else:
                width, moved = width + h, readings
            for own, r, u, (residual, _) in zip(columns, moved, here.unknown, states, strict=True):
                own.append((r.residual(u, self.gap(p, width))[0] - residual) / h)
        prior, prior_rows = priors_of(self.layout, here.p, 1)
        normal, slope = prior_rows.T @ prior_rows, prior_rows.T @ prior
        answers = []
        for reading, u, own, (residual, wave) in zip(readings, here.unknown, columns, states, strict=True):
            reading.deflection(u)
            rows, factor = reading.linearised(wave, gap)
            by = np.stack([*own, residual], axis=1)
            across = reading.gathered(by, rows)
            moves = cho_solve(factor, across, check_finite=False)
            product = by.T @ by - across.T @ moves
            normal += product[:-1, :-1]
            slope += product[:-1, -1]
            answers.append((-moves[:, -1], -moves[:, :-1]))
        return normal, slope, answers

    def _step(self, p: Float64, k: int) -> float:
        """Step of a parameter for its derivative; that of the gap is the last."""
        structure = self.layout.structure
        if k == p.size or (k < structure.count and structure.logarithmic[k]):
            return 1e-5
        if k >= structure.count:
            late = k < structure.count + len(self.layout.free_delays)
            return 1e-4 * (self.layout.step if late else 1.0)
        values, slices = structure.physical(p[: structure.count]), structure.slices
        size = float(values[slices["mass"]].max())
        if slices["damper"].start <= k < slices["damper"].stop:
            size = float(values[slices["spring"]].max()) / float(self.records[0].omega[-1])
        return 1e-5 * max(abs(float(p[k])), 1e-3 * size)


def widest_gap(here: JointFit, records: Sequence[Record], terms: Sequence[Term]) -> tuple[Term, Free] | None:
    """The spring with a gap that the best starts of all places lead to, and the parameters with it."""
    starts: list[tuple[float, int, Term, Free]] = []
    for term in terms:
        axis = term.place.axis
        own = sorted(records, key=lambda r: -float((np.abs(r.torque[:, axis]) ** 2).sum()))
        for p in starts_of(here, records, term):
            found = _begun(FreePlay(here.layout, own[:SCANNED], term), p)
            if found is not None:
                starts.append((found.cost, len(starts), term, found))
    starts.sort(key=lambda s: s[:2])
    limits = limits_of(here.layout, here.candidate, here.evaluation, True)
    rows = sum(2 * r.torque.size for r in records)
    best: tuple[Term, Free] | None = None
    for _, _, term, start in starts[:TRIED]:
        play = FreePlay(here.layout, records, term)
        free = play.fitted(play.solved(start.p, start.width, None, FIRST), FIRST, limits)
        if best is None or free.cost < best[1].cost:
            best = term, free
        if best[1].cost < HOLDS * rows:
            break
    if best is None or best[1].cost > LEFT_OPEN * rows:
        return None
    term, free = best
    for share in STAGES[1:]:
        free = FreePlay(here.layout, records, term).fitted(free, share, limits)
    return term, free


def _begun(play: FreePlay, p: Float64) -> Free | None:
    """A start with the spring and the gap that its force and deflection ask for."""
    with np.errstate(all="ignore"):
        try:
            free = play.solved(p, -50.0, None, LOOSEST, 1)
            _, width, spring = play.regressed(p, free.unknown)
            if not spring > 0.0:
                return None
            p = p.copy()
            p[play.damper] *= spring / np.exp(p[play.spring])
            p[play.spring] = np.log(spring)
            found = play.solved(p, float(np.log(width)), None, FIRST, SOME)
        except (np.linalg.LinAlgError, ValueError):
            return None
    return found if np.isfinite(found.cost) else None


def starts_of(here: JointFit, records: Sequence[Record], term: Term) -> Iterator[Float64]:
    """(n,) parameters with the axis' mass, as the lowest lines show it, shared out between the two sides of
    the spring; each side as the linear fit has it, or all masses alike."""
    structure, axis, at = here.layout.structure, term.place.axis, term.place.number
    chains = structure.chains(here.p[: structure.count])
    total = rigid(records, structure.motors)[0][axis]
    top = highest_line(records)
    yield here.p.copy()
    if not total > 0.0:
        return
    several = structure.sizes[axis] > 2
    # Each start costs as much for every spring of every axis: fewer of them where there are many.
    for even in (False, True) if several and structure.motors == 1 else (False,):
        for share in SHARES[::2] if several else SHARES:
            masses, springs = chains.masses[axis].copy(), chains.springs[axis].copy()
            dampers = chains.dampers[axis].copy()
            for side, part in ((slice(0, at), share), (slice(at, None), 1.0 - share)):
                own = np.ones_like(masses[side]) if even else masses[side]
                masses[side] = part * total * own / own.sum()
            grown = masses / chains.masses[axis]
            for k in range(springs.size):
                if even or k == at - 1:
                    springs[k] = (0.5 * top) ** 2 * masses[k] * masses[k + 1] / (masses[k] + masses[k + 1])
                    dampers[k] = 0.02 * springs[k] / top
                else:
                    factor = float(np.sqrt(grown[k] * grown[k + 1]))
                    springs[k], dampers[k] = springs[k] * factor, dampers[k] * factor
            couplings = chains.couplings.copy()
            less = min(1.0, float(np.sqrt(grown[-1])))
            couplings[axis] *= less
            couplings[:, axis] *= less
            p = here.p.copy()
            p[: structure.count] = structure.vector(
                replace(
                    chains,
                    masses=_with(chains.masses, axis, masses),
                    springs=_with(chains.springs, axis, springs),
                    dampers=_with(chains.dampers, axis, dampers),
                    couplings=couplings,
                )
            )
            yield p


def _left_by(columns: Float64, force: Float64) -> tuple[float, Float64]:
    """Share of a force's power (n,) that a regression on columns (n, k) leaves, and its coefficients."""
    found: Float64 = np.asarray(np.linalg.lstsq(columns, force, rcond=None)[0], dtype=np.float64)
    left = force - columns @ found
    return float(left @ left) / max(float(force @ force), 1e-300), found


def _with(parts: tuple[Float64, ...], axis: int, own: Float64) -> tuple[Float64, ...]:
    return (*parts[:axis], own, *parts[axis + 1 :])
