"""What the pictures show over frequency: receptances and missing torque, with their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.model.chains import CoupledChains
from invid.model.matrices import Condensed
from invid.numerics.arrays import Bool, Complex128, Float64, Int64
from invid.numerics.linear_algebra import least_squares, real_rows
from invid.signals.spectra import LineSpectra

BINS = 160
"""Lines are gathered in at most so many bins: more cannot be told apart in a picture."""


@dataclass(frozen=True, eq=False)
class MissingTorque:
    """Missing torque of one record on all its lines.

    ``torque`` (F, M) r = ZΘ − T, boundary terms and a sampling offset of at most a sample taken out;
    ``covariance`` (F, M, M) what measurement noise leaves; ``motion`` (F, ΣN, M) W.
    """

    spectra: LineSpectra
    torque: Complex128
    covariance: Complex128
    motion: Complex128

    @property
    def std(self) -> Float64:
        """(F, M) rms that noise alone would leave."""
        result: Float64 = np.sqrt(np.maximum(np.einsum("fii->fi", self.covariance).real, 0.0))
        return result


def missing_torque(s: LineSpectra, chains: CoupledChains, known: Complex128 | None = None) -> MissingTorque:
    """r = ZΘ − T of one record under a linear model (docs/explanations/decisions/0003).

    ``known`` (F, M) is what causes already account for: it stays in the result, but the boundary terms and
    the offset are fitted without it. Near an antiresonance, where Z is large and noise weighs little, they
    would else take a multiple of it along.
    """
    seen = Condensed.of(chains.matrices.dynamic_stiffness(1j * s.omega), chains.motor_dofs.tolist())
    z, w = seen.stiffness, seen.motion.transpose(0, 2, 1)
    needed = np.einsum("fij,fj->fi", z, s.position)
    both = np.concatenate((z, -np.broadcast_to(np.eye(s.axis_count), z.shape)), axis=2)
    cover = both @ s.covariance @ both.conj().transpose(0, 2, 1)
    weight = 1.0 / np.maximum(np.einsum("fii->fi", cover).real, 1e-300)
    if known is None:
        return MissingTorque(s, _without_nuisance(s, chains, needed, w, weight), cover, w)
    return MissingTorque(s, known + _without_nuisance(s, chains, needed - known, w, weight), cover, w)


def _without_nuisance(
    s: LineSpectra, chains: CoupledChains, needed: Complex128, w: Complex128, weight: Float64
) -> Complex128:
    """needed − T without what is no fault: weighted least squares, three Gauss-Newton steps.

    A time offset of each torque of at most one sample is sampling convention; the 2·ΣN boundary
    terms belong to a record that does not end as it began.
    """
    step, motors = 1.0 / s.sample_rate_hz, s.axis_count
    boundary = np.zeros((s.frequency_hz.size, motors, 0), dtype=complex)
    if s.transient:
        mass, damping = chains.mass_matrix, chains.damping_matrix
        at_position = damping + 1j * s.omega[:, None, None] * mass
        forces = np.concatenate((at_position, np.broadcast_to(mass, at_position.shape)), axis=2)
        boundary = w.transpose(0, 2, 1) @ forces
    root = np.sqrt(weight)[..., None]
    offset = np.zeros(motors)
    left = needed - s.torque
    for _ in range(3):
        torque = s.torque * np.exp(-1j * s.omega[:, None] * offset)
        slope = (1j * s.omega[:, None] * torque)[..., None] * np.eye(motors)
        columns = np.concatenate((boundary, slope), axis=2)
        solved = _least_squares(root * columns, root[..., 0] * (needed - torque))
        offset = np.clip(offset - solved[boundary.shape[2] :], -step, step)
        left = needed - s.torque * np.exp(-1j * s.omega[:, None] * offset)
    if s.transient:
        left = left - boundary @ _least_squares(root * boundary, root[..., 0] * left)
    return left


def _least_squares(columns: Complex128, right: Complex128) -> Float64:
    """Real coefficients of complex columns (F, M, n) that bring them closest to ``right`` (F, M)."""
    return least_squares(
        real_rows(columns.reshape(-1, columns.shape[2])), real_rows(right.ravel()), rcond=1e-12
    )


def line_numbers(s: LineSpectra) -> Int64:
    """(F,) number of each line in the transform of the averaged period."""
    return np.round(s.frequency_hz * s.time.size / s.sample_rate_hz).astype(np.int64)


def binned_floor(missing: Sequence[MissingTorque], axis: int) -> tuple[list[float], list[float]]:
    """Frequencies [Hz] and rms that noise alone would leave there."""
    hz, rms = binned([m.spectra.frequency_hz for m in missing], [m.std[:, axis] ** 2 for m in missing])
    return hz.tolist(), rms.tolist()


def binned_torque(
    missing: Sequence[MissingTorque], axis: int, used: Sequence[Bool]
) -> tuple[list[float], list[float]]:
    """Frequencies [Hz] and rms missing torque on the lines ``used`` (F,) of each record."""
    hz, rms = binned(
        [m.spectra.frequency_hz[u] for m, u in zip(missing, used, strict=True)],
        [np.abs(m.torque[u, axis]) ** 2 for m, u in zip(missing, used, strict=True)],
    )
    return hz.tolist(), rms.tolist()


def binned(hz: Sequence[Float64], power: Sequence[Float64]) -> tuple[Float64, Float64]:
    """Rms over logarithmic bins of several records' lines: centre [Hz] and √(mean power) of those filled."""
    f, p = np.concatenate(list(hz)), np.concatenate(list(power))
    good = np.isfinite(p) & (f > 0)
    f, p = f[good], p[good]
    if not f.size:
        return np.zeros(0), np.zeros(0)
    edges = np.geomspace(f.min() * 0.999, f.max() * 1.001, BINS + 1)
    at = np.clip(np.digitize(f, edges) - 1, 0, BINS - 1)
    count = np.bincount(at, minlength=BINS)
    used = count > 0
    centre = np.bincount(at, weights=f, minlength=BINS)[used] / count[used]
    mean = np.bincount(at, weights=p, minlength=BINS)[used] / count[used]
    return centre, np.sqrt(mean)
