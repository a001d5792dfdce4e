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
from dataclasses import dataclass

import numpy as np

from invid.errors import NotIdentifiableError
from invid.modes.model import Modes
from invid.modes.rational_fit import (
    TRUSTED,
    Record,
    columns_of,
    even_poles,
    fractions,
    modes_of,
    project_out_transients,
    record_of,
    relocate_once,
    residues_of,
)
from invid.numerics import budget
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.parallel import parallel_map
from invid.signals.spectra import LineSpectra

SPARE = 4
"""Poles to spare at the start: two for each of the two weakest modes, empirical (random plants)."""
DELAYS = (0.5, 0.0)
"""Torque later than recorded, in samples: held over the sample, or continuous."""
ROUNDS = 3
"""Weights re-evaluated so often for each number of poles."""
MOST = 4e9
"""Operations a search with all spare poles may take (some seconds); larger plants have one."""


@dataclass(frozen=True, eq=False)
class NoisyRecord:
    """Lines of one experiment, or of one column of an FRF matrix.

    ``noise`` (F, 2M) or (2M,) is the power of position's and torque's noise on them, ``step`` [s] the
    sampling interval of a torque that may be held over it, 0 of none.
    """

    lines: Record
    noise: Float64
    step: float = 0.0

    @classmethod
    def of_spectra(cls, s: LineSpectra) -> NoisyRecord:
        """The lines of an experiment that carry something, ``MOST_LINES`` at most."""
        return cls(record_of(s, TRUSTED), s.floor, 1.0 / s.sample_rate_hz)

    @classmethod
    def of_column(cls, omega: Float64, column: Complex128, variance: Float64, motor: int) -> NoisyRecord:
        """A column (F, M) of an FRF matrix: the answer to one motor's torque of one."""
        torque = np.zeros(column.shape, dtype=np.complex128)
        torque[:, motor] = 1.0
        acceleration = -(omega**2)[:, None] * column
        level = np.abs(acceleration) ** 2
        spread = variance * (omega**4)[:, None] + TRUSTED**2 * (level + 0.0025 * level.mean(axis=0)) + 1e-300
        lines: Record = (omega, acceleration, torque, 1.0 / np.sqrt(spread), False)
        return cls(lines, np.concatenate((variance, np.zeros(column.shape)), axis=1))


def search_modes(
    records: Sequence[NoisyRecord], masses: Sequence[int], *, shared: bool = False
) -> tuple[Modes, float]:
    """Modes, weak ones included, and how much later than recorded the torque acts [s].

    A start for the fit: the modes carry no covariance. ``shared``: some have one pole (``modes_of``).

    Raises
    ------
    NotIdentifiableError
        There is no finite set of as many poles.
    """
    modes = sum(masses) - len(masses)
    search = _Search(records)
    if not modes:
        poles = np.zeros(0, dtype=np.complex128)
        residues = residues_of(search.raw, poles, search.motors, search.scale)
        return modes_of(poles, residues, search.scale, tuple(masses)), 0.0
    spare = 1 if search.operations(modes + SPARE) * (SPARE + 1) > MOST else SPARE
    found = search.best(spare, modes, DELAYS if any(r.step for r in records) else DELAYS[-1:])
    if found is None:
        raise NotIdentifiableError("modal fit: no start converged; measure longer or raise the amplitude")
    delay, _, poles, residues = found
    found_modes = modes_of(poles * search.scale, residues, search.scale, tuple(masses), shared=shared)
    return found_modes, delay * records[0].step


class _Search:
    """The records of one search and what a set of poles costs on them."""

    def __init__(self, records: Sequence[NoisyRecord]) -> None:
        self.records, self.raw = records, [r.lines for r in records]
        self.motors: int = self.raw[0][1].shape[1]
        self.rows = 2 * sum(w.size for w, *_ in self.raw)
        low, high = min(float(w[0]) for w, *_ in self.raw), max(float(w[-1]) for w, *_ in self.raw)
        self.band, self.scale = (low, high), float(np.sqrt(low * high))

    def operations(self, poles: int) -> float:
        """Return the number of operations of a search with so many poles, for each number that it goes
        through.
        """
        width = (self.motors + 1) * (2 * poles + 1)
        return 2.0 * self.motors * self.rows * width**2 * 5 * ROUNDS

    def best(
        self, spare: int, modes: int, delays: Sequence[float]
    ) -> tuple[float, float, Complex128, Float64] | None:
        """Delay [samples], cost, poles and residues of the delay that leaves least."""
        runs = zip(delays, parallel_map(lambda d: self.run(spare, modes, d), delays), strict=True)
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
        while True:
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

    def _relocated(self, data: Sequence[Record], poles: Complex128, times: int) -> Complex128 | None:
        for _ in range(times):
            if budget.is_spent():
                break
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
        for record, (w, acceleration, torque, _, transient) in zip(self.records, self.raw, strict=True):
            gain = np.abs(np.einsum("fn,nij->fij", fractions(w / self.scale, poles), residues)) ** 2
            noise = np.broadcast_to(record.noise, (w.size, 2 * self.motors))
            by_torque = np.einsum("fij,fj->fi", gain, noise[:, self.motors :])
            variance = (w**4)[:, None] * noise[:, : self.motors] + by_torque + 1e-300
            # ``record_of`` has taken a quarter of a sample already.
            turn = np.exp(-1j * w * (delay - 0.25) * record.step)[:, None]
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
