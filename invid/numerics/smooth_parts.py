"""Shapes of a smooth curve that rows can tell, from the smoothest to the roughest."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Float64

LEAST_SEEN = 1e-4
"""Singular value over the largest below which a shape is not seen (numerical)."""


def smooth_parts(columns: Float64, residual: Float64, price: float, most: int) -> tuple[Float64, Float64]:
    """Return the shapes (k, n) of a curve that pay for themselves in a regression of ``residual`` (m,), and
    their sizes (n,); n is 0 where none does.

    The curve is given by its values at k knots, of which ``columns`` (m, k) are the rows. The shapes are
    orthonormal in the rows and in the order of their roughness, the second differences of these values
    (Demmler and Reinsch, Numer. Math. 24, 1975); ``price`` is the gain that each must bring, and at most
    ``most`` are taken.
    """
    left, size, right = np.linalg.svd(columns, full_matrices=False)
    seen = size > LEAST_SEEN * max(float(size[0]), 1e-300)
    unit = right[seen].T / size[seen]
    bend = np.diff(unit, 2, axis=0)
    _, order = np.linalg.eigh(bend.T @ bend)
    order = order[:, :most]
    along = order.T @ (left.T @ residual)[seen]
    worth = np.cumsum(along**2 - price)
    count = int(np.argmax(worth)) + 1 if worth.size and worth.max() > 0.0 else 0
    return unit @ order[:, :count], along[:count]
