"""Poles that are barely visible: a rational fit weighted by the noise itself, with poles to spare.

A mode whose pole and zero all but cancel at every motor is above the noise of the records and far below
the two per cent that ``invid.modes.rational_fit`` grants them. It is found where three things are right: the
weight of every line is the noise that torque *and* position put on it (C_r of the fit, with the FRF of the
first rational fit in it), the torque acts when it does (a staircase acts half a sample late, and the phase of
that costs a pole), and the search has poles to spare. Those are taken away one by one, the least
significant first (Wald statistic of its residues), and the rest relocated each time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.modes import Modes
from invid.modes.rational_fit import (
    TRUSTED,
    Record,
    columns_of,
    even_poles,
    fractions,
    project_out_transients,
    record_of,
    relocate_once,
    residues_of,
    sample_modes,
)
from invid.numerics import budget
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.parallel import parallel_map
from invid.signals.frf import FrfMatrix
from invid.signals.spectra import LineSpectra

SPARE = 4
"""Poles to spare at the start: two for each of the two weakest modes, empirical (random plants)."""
DELAYS = (0.5, 0.0)
"""Torque later than recorded, in samples: held over the sample, or continuous."""
ROUNDS = 3
"""Weights re-evaluated so often for each number of poles."""
MOST = 4e9
"""Operations a search may take (some seconds); larger plants go without."""


def search_modes(
    spectra: Sequence[LineSpectra], masses: Sequence[int], *, model_error: float = 0.0
) -> tuple[Modes, FrfMatrix, float] | None:
    """Modes and G on a grid that resolves them, weak modes included, and how much later than recorded the
    torque acts [s]; ``None`` where it fails or is too long.

    A start for the fit: the modes carry no covariance. Uses about ``MOST_LINES`` lines of each record.

    ``model_error``: relative error of the spectra beyond their noise (friction).
    """
    modes = sum(masses) - len(masses)
    if modes == 0:
        return None
    search = _Search(spectra, model_error)
    spare = SPARE if search.operations(modes + SPARE) * (SPARE + 1) < MOST else 1
    if search.operations(modes + spare) * (spare + 1) > 3 * MOST:
        return None
    found = search.best(spare, modes)
    if found is None:
        return None
    delay, _, poles, residues = found
    sampled = sample_modes(poles, residues, search.scale, tuple(masses), search.band)
    return (*sampled, delay / spectra[0].sample_rate_hz)


class _Search:
    """The records of one search and what a set of poles costs on them."""

    def __init__(self, spectra: Sequence[LineSpectra], model_error: float) -> None:
        self.spectra, self.model_error = spectra, model_error
        self.motors = spectra[0].axis_count
        self.raw = [record_of(s, TRUSTED) for s in spectra]
        self.rows = 2 * sum(w.size for w, *_ in self.raw)
        low, high = min(float(w[0]) for w, *_ in self.raw), max(float(w[-1]) for w, *_ in self.raw)
        self.band, self.scale = (low, high), float(np.sqrt(low * high))

    def operations(self, poles: int) -> float:
        """Return the number of operations of a search with so many poles, for each number that it goes
        through.
        """
        width = (self.motors + 1) * (2 * poles + 1)
        return 2.0 * self.motors * self.rows * width**2 * 5 * ROUNDS

    def best(self, spare: int, modes: int) -> tuple[float, float, Complex128, Float64] | None:
        """Delay [samples], cost, poles and residues of the delay that leaves least."""
        runs = zip(DELAYS, parallel_map(lambda d: self.run(spare, modes, d), DELAYS), strict=True)
        found = [(delay, *run) for delay, run in runs if run is not None]
        return min(found, key=lambda f: f[1], default=None)

    def run(self, spare: int, modes: int, delay: float) -> tuple[float, Complex128, Float64] | None:
        """Cost, poles and residues after the spare poles are gone."""
        first = self._relocated(self.raw, even_poles(*self.band, modes, self.scale), 15)
        if first is None:
            return None
        residues = residues_of(self.raw, first, self.motors, self.scale)
        model = (first, residues)
        poles = even_poles(*self.band, modes + spare, self.scale)
        while not budget.is_spent():
            for _ in range(ROUNDS):
                data = self.weighted(delay, *model)
                fresh = self._relocated(data, poles, 5)
                if fresh is None:
                    return None
                poles = fresh
                residues = residues_of(data, poles, self.motors, self.scale)
                if not np.isfinite(residues).all():
                    return None
                model = (poles, residues)
            cost, significance = self._judged(self.weighted(delay, *model), poles)
            if poles.size == modes:
                return cost, poles, residues
            poles = np.delete(poles, int(np.argmin(significance)))
        return None

    def _relocated(self, data: Sequence[Record], poles: Complex128, times: int) -> Complex128 | None:
        for _ in range(times):
            if budget.is_spent():
                return None
            with np.errstate(all="ignore"):
                fresh = relocate_once(data, poles, self.motors, self.scale)
            if fresh is None or not np.isfinite(fresh).all():
                return None
            settled = np.allclose(fresh, poles, rtol=1e-5, atol=0)
            poles = fresh
            if settled:
                break
        return poles

    def weighted(self, delay: float, poles: Complex128, residues: Float64) -> list[Record]:
        """The records with each line's noise under the FRF given, torque ``delay`` samples late."""
        out: list[Record] = []
        for s, (w, acceleration, torque, _, transient) in zip(self.spectra, self.raw, strict=True):
            gain = np.abs(np.einsum("fn,nij->fij", fractions(w / self.scale, poles), residues)) ** 2
            variance = (w**4)[:, None] * s.floor[: self.motors] + gain @ s.floor[self.motors :]
            variance = variance + (self.model_error * np.abs(acceleration)) ** 2 + 1e-300
            # ``record_of`` has taken a quarter of a sample already.
            turn = np.exp(-1j * w * (delay - 0.25) / s.sample_rate_hz)[:, None]
            out.append((w, acceleration, torque * turn, 1.0 / np.sqrt(variance), transient))
        return out

    def _judged(self, data: Sequence[Record], poles: Complex128) -> tuple[float, Float64]:
        """Weighted squares left by a set of poles, and by how much more each pole's absence leaves."""
        count = poles.size
        shared = self.motors * (2 * count + 1)
        columns = columns_of(data, poles, self.motors, self.scale)
        left_over, significance = 0.0, np.zeros(count)
        for i in range(self.motors):
            left, goal = project_out_transients(
                data, columns, [a[:, i : i + 1] for _, a, *_ in data], i, shared
            )
            size = np.linalg.norm(left, axis=0)
            q, triangle = np.linalg.qr(left / np.where(size > 0, size, 1.0))
            along = q.T @ goal[:, 0]
            inverse = np.linalg.pinv(triangle)
            x, covariance = inverse @ along, inverse @ inverse.T
            left_over += float(goal[:, 0] @ goal[:, 0] - along @ along)
            for k in range(count):
                own = np.array(
                    [j * (2 * count + 1) + part for j in range(self.motors) for part in (k, count + k)]
                )
                significance[k] += float(x[own] @ np.linalg.pinv(covariance[np.ix_(own, own)]) @ x[own])
        return left_over, significance
