"""Two grey-box fits of the same parameters as other tools make them: output error, prediction error.

Both know the structure (chains, couplings), get the number of masses, and are minimised by
`scipy.optimize.least_squares` with derivatives by differences. They share no code with the product.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import least_squares

from benchmarks.shared import plant_oracle as oracle
from invid.errors import InvidError
from invid.recording.model import Recording
from invid.signals.spectra import all_spectra

Array = NDArray[np.float64]
FORGET = 500
"""Samples at the start of a record in which a filter that knows no initial state finds it."""


def vector(plant: oracle.OraclePlant) -> Array:
    """Logarithms of masses, springs and dampers, then the couplings."""
    parts = [np.log(np.concatenate(p)) for p in (plant.masses, plant.springs, plant.dampers)]
    count = len(plant.masses)
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count)]
    return np.concatenate((*parts, [plant.couplings.get(p, 0.0) for p in pairs]))


def plant_of(x: Array, like: oracle.OraclePlant) -> oracle.OraclePlant:
    """The plant that ``vector`` made ``x`` of; sizes as of ``like``."""
    at, parts = 0, []
    for kind in (like.masses, like.springs, like.dampers):
        rows = []
        for branch in kind:
            rows.append([float(v) for v in np.exp(x[at : at + len(branch)])])
            at += len(branch)
        parts.append(rows)
    count = len(like.masses)
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count)]
    return oracle.OraclePlant(*parts, dict(zip(pairs, x[at:].tolist(), strict=True)))


def rough(plant: oracle.OraclePlant, rng: np.random.Generator) -> oracle.OraclePlant:
    """A start as from data sheets: masses, springs 20 % off, dampers by a factor of two, no couplings."""
    x = vector(plant)
    masses = sum(len(b) for b in plant.masses)
    springs = masses + sum(len(b) for b in plant.springs)
    couplings = x.size - len(plant.couplings)
    x[:springs] += 0.2 * rng.standard_normal(springs)
    x[springs:couplings] += 0.7 * rng.standard_normal(couplings - springs)
    x[couplings:] = 0.0
    return plant_of(x, plant)


def output_error(recording: Recording, start: oracle.OraclePlant) -> oracle.OraclePlant:
    """The plant whose motion under the recorded torque is nearest to the measured one.

    On the lines, where the drift of a free robot does no harm (over time it is all there is); the torque acts
    half a sample later than recorded. Its noise is taken for none, as output error does.
    """
    records = [
        (
            s.omega[s.excited],
            s.position[s.excited],
            s.torque[s.excited] * np.exp(-0.5j * s.omega[s.excited, None] / s.sample_rate_hz),
        )
        for s in all_spectra(recording)
    ]

    def residual(x: Array) -> Array:
        parts = []
        with np.errstate(all="ignore"):
            plant = plant_of(x, start)
        for omega, position, torque in records:
            try:
                moved = np.einsum("fij,fj->fi", plant.frf(omega / 2 / np.pi), torque)
            except np.linalg.LinAlgError:
                return np.full(2 * sum(p.size for _, p, _ in records), 1e6)
            parts.append((position - moved).ravel())
        out = np.concatenate(parts) / 1e-6
        return np.concatenate((out.real, out.imag))

    found = least_squares(residual, vector(start), x_scale="jac", max_nfev=200)
    return plant_of(found.x, start)


@numba.njit(cache=True)  # type: ignore[misc]
def _innovations(a: Array, b: Array, c: Array, k: Array, torque: Array, position: Array, x: Array) -> Array:
    """(n, M) what each position differs by from its prediction."""
    out = np.empty_like(position)
    for t in range(position.shape[0]):
        out[t] = position[t] - c @ x
        x = a @ x + b @ torque[t] + k @ out[t]
    return out


def kalman(
    recording: Recording, start: oracle.OraclePlant, torque_noise: Array, position_noise: float
) -> oracle.OraclePlant:
    """The plant whose stationary Kalman filter predicts each position best from all before.

    The noise of torque (M,) and position is given to it, in its favour; the filter follows from them and the
    parameters by the discrete Riccati equation.
    """
    h = 1.0 / recording.experiments[0].sample_rate_hz
    data = [(np.ascontiguousarray(e.torque), np.ascontiguousarray(e.position)) for e in recording.experiments]
    root: list[Array] = []

    def residual(x: Array) -> Array:
        mass, damping, stiffness, motors = plant_of(x, start).matrices
        n, m = mass.shape[0], len(motors)
        inverse = np.linalg.inv(mass)
        a = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
        b = np.concatenate((np.zeros((n, m)), inverse[:, motors]))
        block = expm(np.block([[a, b], [np.zeros((m, 2 * n + m))]]) * h)
        ad, bd = block[: 2 * n, : 2 * n], block[: 2 * n, 2 * n :]
        c = np.eye(2 * n)[motors]
        # In micro-units: with 1e-12 in R the equation is beyond what the solver can tell.
        q, r = 1e12 * (bd * torque_noise**2) @ bd.T, 1e12 * position_noise**2 * np.eye(m)
        p = solve_discrete_are(ad.T, c.T, q, r)
        s = c @ p @ c.T + r
        k = ad @ p @ c.T @ np.linalg.inv(s)
        if not root:
            root.append(np.linalg.inv(np.linalg.cholesky(s)))
        parts = []
        for torque, position in data:
            first = np.zeros(2 * n)
            first[motors] = position[0]
            e = _innovations(
                np.ascontiguousarray(ad),
                np.ascontiguousarray(bd),
                c,
                np.ascontiguousarray(k),
                torque,
                position,
                first,
            )
            parts.append((1e6 * e[FORGET:] @ root[0].T).ravel())
        return np.concatenate(parts)

    def guarded(x: Array) -> Array:
        try:
            return residual(x)
        except (np.linalg.LinAlgError, ValueError):
            return np.full(sum((p.shape[0] - FORGET) * p.shape[1] for _, p in data), 1e6)

    try:
        residual(vector(start))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise InvidError(f"no filter at the start: {error}") from None
    found = least_squares(guarded, vector(start), x_scale="jac", max_nfev=25)
    return plant_of(found.x, start)
