"""Shapes of a smooth curve that rows can tell, from the smoothest to the roughest."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Float64

LEAST_SEEN = 1e-4
"""Singular value over the largest below which a shape is not seen (numerical)."""
STRAIGHT = 1e-12
"""Roughness of a shape of unit length that is straight (numerical)."""


def smooth_parts(
    columns: Float64, residual: Float64, price: float, most: int, across: int = 1
) -> tuple[Float64, Float64]:
    """Return the shapes (k, n) of a curve that pay for themselves in a regression of ``residual`` (m,), and
    their sizes (n,); n is 0 where none does.

    The curve is given by its values at k knots, of which ``columns`` (m, k) are the rows; a surface by those
    at the knots of two quantities, ``across`` of the second at each of the first. The shapes are orthonormal
    in the rows and in the order of their roughness, the second differences of these values along each
    quantity (Demmler and Reinsch, Numer. Math. 24, 1975); ``price`` is the gain that each must bring, and at
    most ``most`` are taken. At knots that the rows do not see they go on as smoothly as they can.
    """
    left, size, right = np.linalg.svd(columns, full_matrices=False)
    seen = size > LEAST_SEEN * max(float(size[0]), 1e-300)
    unit = right[seen].T / size[seen]
    unseen = right[~seen].T
    bends = _bends(columns.shape[1] // across, across)
    free = bends @ unseen
    unit = unit - unseen @ np.linalg.solve(
        free.T @ free + STRAIGHT * np.eye(free.shape[1]), free.T @ bends @ unit
    )
    bend = bends @ unit
    _, order = np.linalg.eigh(bend.T @ bend)
    order = order[:, :most]
    along = order.T @ (left.T @ residual)[seen]
    worth = np.cumsum(along**2 - price)
    count = int(np.argmax(worth)) + 1 if worth.size and worth.max() > 0.0 else 0
    return unit @ order[:, :count], along[:count]


def _bends(first: int, second: int) -> Float64:
    """(r, first·second) second differences of values of a curve, or of a surface along both quantities."""
    down, over = (np.diff(np.eye(n), 2, axis=0) if n > 2 else np.zeros((0, n)) for n in (first, second))
    return np.concatenate((np.kron(down, np.eye(second)), np.kron(np.eye(first), over)))
