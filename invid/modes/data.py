"""A measured FRF matrix, checked, made symmetric, with its weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from invid.errors import InputError, NotIdentifiableError
from invid.modes.model import pairs
from invid.numerics.arrays import Complex128, Float64


@dataclass(frozen=True, eq=False)
class FrfData:
    """Lines [rad/s], symmetric entries and their variances, masses per branch."""

    w: Float64  # (F,)
    g: Complex128  # (F, P) symmetric part
    variance: Float64  # (F, P)
    count: int
    masses: tuple[int, ...]

    @property
    def modes(self) -> int:
        """Σ(N_i − 1)."""
        return sum(self.masses) - self.count

    def weight(self, model_error: float) -> Float64:
        """(F, P) inverse standard deviations, a relative model error added to the noise."""
        rows, columns = pairs(self.count)
        size = np.abs(self.g)
        diagonal = np.flatnonzero(rows == columns)
        own = size[:, diagonal]
        # a cross entry that happens to be small is not better known than the entries around it
        scale = np.maximum(size**2, 0.01 * own[:, rows] * own[:, columns])
        weight: Float64 = 1.0 / np.sqrt(self.variance + model_error**2 * scale)
        return weight


def checked_data(
    frequency_hz: npt.ArrayLike, frf: npt.ArrayLike, variance: npt.ArrayLike, masses: Sequence[int]
) -> FrfData:
    """Usable lines in ascending order; InputError or NotIdentifiableError says what is wrong."""
    f = np.asarray(frequency_hz, dtype=float)
    g = np.asarray(frf, dtype=complex)
    count = len(masses)
    if f.ndim != 1 or g.shape != (f.size, count, count):
        raise InputError(
            f"modal fit: {f.shape} frequencies and {count} branches need an FRF of shape "
            f"({f.size}, {count}, {count}), found {g.shape}"
        )
    var = np.asarray(variance, dtype=float)
    if var.shape == (f.size, count * count):
        var = var.reshape(f.size, count, count)
    if var.shape != g.shape:
        raise InputError(f"modal fit: the FRF variance has shape {var.shape}, need {g.shape}")
    if any(n < 1 for n in masses):
        raise InputError(f"modal fit: masses per branch are {list(masses)}; each branch has at least one")
    if not (np.isfinite(f).all() and np.all(f > 0)):
        raise InputError("modal fit: frequencies must be finite and > 0")
    sound = np.isfinite(g).all(axis=(1, 2)) & np.isfinite(var).all(axis=(1, 2)) & (var >= 0).all(axis=(1, 2))
    order = np.argsort(f[sound])
    f, g, var = f[sound][order], g[sound][order], var[sound][order]
    rows, columns = pairs(count)
    # reciprocity: both measurements of one entry, weighted by their variances
    floor = (1e-9 * np.abs(g)) ** 2 + np.finfo(float).tiny
    info, mirror = 1.0 / (var + floor), (1.0 / (var + floor)).transpose(0, 2, 1)
    mean = (g * info + g.transpose(0, 2, 1) * mirror) / (info + mirror)
    joint = 1.0 / (info + mirror)
    joint[:, np.arange(count), np.arange(count)] *= 2.0
    data = FrfData(
        2 * np.pi * f, mean[:, rows, columns], joint[:, rows, columns], count, tuple(int(n) for n in masses)
    )
    unknowns = data.modes * (count + 2) + rows.size + count
    if 2 * f.size * rows.size <= unknowns or f.size < 2 * data.modes + 2:
        raise NotIdentifiableError(
            f"modal fit: {f.size} usable lines for {data.modes} modes of {count} motors; at least "
            f"{max(2 * data.modes + 2, unknowns // (2 * rows.size) + 1)} are needed: lengthen the period or "
            "widen the band"
        )
    return data
