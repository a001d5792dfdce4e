"""Chains that follow a motor's own stiffness |Z|, from many starts at once.

    Z_i = −ω² m_i + κ_i Z_{i+1}/(κ_i + Z_{i+1}),   κ_i = k_i + jω c_i,   Z_n = −ω² m_n + k_g,
    Z = Z_1 + jω d,

with k_g of springs between the load and those of axes that stand, d of the motor's friction (for random
phases the best linear friction is viscous, dry friction too) and Σ √((ln|Z|/|Z measured|)² + ε²) as the loss:
what friction and the other axes' modes bend on a few lines counts by its size alone.
"""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Complex128, Float64

ROUNDED = 0.005
"""ε: deviations of the logarithm below which the loss is a parabola; friction bends more, noise less."""
LOSS = 3e-2
"""Damping ratio of a spring at the start: blunt, so that a mode is felt from afar."""
NOTHING, SOME, ALL = 1e-9, 0.1, 1.0
"""At the start, of the stiffness: motor's friction at the middle line, k_g at the lowest; none, or free to be
what they are, k_g from all that there is."""
LOOSE = 1e-3
"""Curvature of the prior of each number's logarithm, in lines: holds what the lines do not show."""
ITERATIONS, LARGEST_STEP = 40, 0.5
FIRST, LESS, MORE = 1e-2, 0.3, 5.0
"""Damping of numbers scaled to unit curvature: at the start, and its factors."""


def follow(
    omega: Float64, size: Float64, start: Float64, friction: float = NOTHING, ground: float = NOTHING
) -> tuple[Float64, Float64]:
    """(S, 2n) masses, springs and k_g that follow |Z| = ``size`` (F,) on ``omega`` best about each ``start``
    (S, 2n − 1), and their loss (S,), a mean over the lines; ``friction`` and ``ground``: those to start
    from."""
    level = np.log(size)
    held = np.full((len(start), 1), np.log(ground * size[int(np.argmin(omega))]))
    x = _with_dampers(
        np.concatenate((np.log(start), held), axis=1), np.log(friction * np.median(size / omega))
    )
    centre = x.copy()
    damping = np.full(len(x), FIRST)
    miss, slope = _miss(omega, level, x)
    loss = _loss(miss, x - centre)
    for _ in range(ITERATIONS):
        weight = 1.0 / np.sqrt(miss**2 + ROUNDED**2)
        gradient = np.einsum("sf,sfp->sp", weight * miss, slope) + LOOSE * (x - centre)
        curvature = np.einsum("sf,sfp,sfq->spq", weight, slope, slope, optimize=True)
        index = np.arange(x.shape[1])
        curvature[:, index, index] += LOOSE
        unit = np.sqrt(curvature[:, index, index])
        curvature = curvature / unit[:, :, None] / unit[:, None, :]
        curvature[:, index, index] += damping[:, None]
        step = -np.linalg.solve(curvature, (gradient / unit)[..., None])[..., 0] / unit
        step *= np.minimum(1.0, LARGEST_STEP / (np.abs(step).max(axis=1) + 1e-300))[:, None]
        tried_miss, tried_slope = _miss(omega, level, x + step)
        tried = _loss(tried_miss, x + step - centre)
        falls = tried < loss
        x[falls] += step[falls]
        miss[falls], slope[falls], loss[falls] = tried_miss[falls], tried_slope[falls], tried[falls]
        damping = np.where(falls, damping * LESS, damping * MORE)
    return np.exp(x[:, : start.shape[1] + 1]), loss / omega.size


def _with_dampers(x: Float64, friction: float) -> Float64:
    masses = x.shape[1] // 2
    mass, spring = np.exp(x[:, :masses]), np.exp(x[:, masses:-1])
    damper = 2 * LOSS * np.sqrt(spring / (1 / mass[:, :-1] + 1 / mass[:, 1:]))
    return np.concatenate((x, np.log(damper), np.full((len(x), 1), friction)), axis=1)


def _loss(miss: Float64, off: Float64) -> Float64:
    out: Float64 = (np.sqrt(miss**2 + ROUNDED**2) - ROUNDED).sum(axis=1) + 0.5 * LOOSE * (off**2).sum(axis=1)
    return out


def _miss(omega: Float64, level: Float64, x: Float64) -> tuple[Float64, Float64]:
    """(S, F) ln|Z| less ``level`` and (S, F, p) its derivative by the logarithms ``x`` of masses, springs,
    k_g, dampers and friction.

    Z = uᵀD u with the motion u of all masses for a motor's motion of one, which is stationary: a mass adds
    −ω² u², a spring the square of what it is bent.
    """
    masses = x.shape[1] // 3
    values = np.exp(x)[:, :, None]
    at = np.cumsum((masses, masses - 1, 1, masses - 1))
    mass, spring, ground, damper, friction = np.split(values, at, axis=1)
    inertia: Complex128 = -(omega**2) * mass + 0j
    link = spring + 1j * omega * damper
    beyond = inertia[:, -1] + ground[:, 0]
    passed: list[Complex128] = []
    for i in range(masses - 2, -1, -1):
        passed.append(link[:, i] / (link[:, i] + beyond))
        beyond = inertia[:, i] + passed[-1] * beyond
    rubbed = 1j * omega * friction
    whole = beyond + rubbed[:, 0]
    motion = np.cumprod(np.stack((np.ones_like(beyond), *passed[::-1]), axis=1), axis=1)
    bent = motion[:, :-1] - motion[:, 1:]
    held = ground * motion[:, -1:] ** 2
    parts = (inertia * motion**2, spring * bent**2, held, 1j * omega * damper * bent**2, rubbed)
    slope = np.concatenate(parts, axis=1) / whole[:, None]
    return np.log(np.abs(whole)) - level, slope.real.transpose(0, 2, 1)
