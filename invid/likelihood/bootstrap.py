"""Parametric bootstrap: spread and bias of the estimates by repeated fits with simulated noise.

Noise of the covariance that the fit ended with is drawn and added to the lines of every record, priors are
drawn as well, and everything is fitted again from the estimate. The spread is a standard deviation without
linearisation; the mean shift is the bias that the noise causes (adding it a second time causes it a second
time: simulation extrapolation, Cook and Stefanski 1994). It says nothing about a wrong model: the records are
the same.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from invid.errors import InputError, NotIdentifiableError
from invid.likelihood.fit import Fit
from invid.likelihood.levenberg_marquardt import gauss_newton
from invid.likelihood.residual import MissingTorqueProblem
from invid.numerics import budget
from invid.numerics.arrays import Complex128, Float64

LEAST_DRAWS = 20
"""Least number of draws (statistical: the spread of 20 is known to 16 %)."""


@dataclass(frozen=True)
class Spread:
    """Spread and bias of one parameter in physical units."""

    std: float
    bias: float
    """Mean of the draws minus the estimate."""
    low: float
    high: float
    """16 % and 84 % quantiles of the draws."""


def bootstrap(fit: Fit, draws: int, *, workers: int = 1, seed: int = 0) -> dict[str, Spread]:
    """Spread of masses, springs, couplings and dampers that were free; the same for any number of
    ``workers``.

    Raises
    ------
    InputError
        Fewer than 20 draws.
    NotIdentifiableError
        More than a tenth of the draws could not be fitted.
    """
    if draws < LEAST_DRAWS:
        raise InputError(f"a bootstrap of {draws} draws: take {LEAST_DRAWS} or more, 200 for a spread to 5 %")
    results = [v for v in _draws(fit, draws, workers, seed) if v is None or v.size]
    if len(results) < draws:
        budget.leave_out(f"{draws - len(results)} of {draws} draws of the bootstrap")
    if len(results) < LEAST_DRAWS:
        return {}
    draws = len(results)
    found = np.array([v for v in results if v is not None])
    if found.shape[0] < 0.9 * draws:
        raise NotIdentifiableError(
            f"{draws - found.shape[0]} of {draws} draws of the bootstrap could not be fitted: the noise is "
            "as large as what the parameters are read from; raise the amplitude or measure longer"
        )
    is_free = fit.solution.free[: fit.structure.count]
    low, high = np.quantile(found, (0.16, 0.84), axis=0)
    std, mean = found.std(axis=0, ddof=1), found.mean(axis=0)
    return {
        name: Spread(float(std[k]), float(mean[k] - fit.values[k]), float(low[k]), float(high[k]))
        for k, name in enumerate(fit.names)
        if is_free[k]
    }


def _draws(fit: Fit, draws: int, workers: int, seed: int) -> Iterator[Float64 | None]:
    """(n,) parameters of every draw."""
    if workers <= 1 or "fork" not in multiprocessing.get_all_start_methods():
        for k in range(draws):
            yield _draw(fit, seed, k)
        return
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(workers, context, initializer=_set_worker_task, initargs=(fit, seed)) as pool:
        yield from pool.map(_draw_in_worker, range(draws), chunksize=max(1, draws // (8 * workers)))


_worker_task: list[tuple[Fit, int]] = []
"""Task of a worker process, sent once and not with every draw."""


def _set_worker_task(fit: Fit, seed: int) -> None:
    _worker_task[:] = [(fit, seed)]


def _draw_in_worker(number: int) -> Float64 | None:
    fit, seed = _worker_task[0]
    return _draw(fit, seed, number)


def _draw(fit: Fit, seed: int, number: int) -> Float64 | None:
    """(n,) parameters in physical units fitted with one draw of noise; ``None`` where the fit fails, empty
    without time."""
    if budget.is_spent():
        return np.zeros(0)
    rng = np.random.default_rng([seed, number])
    with np.errstate(all="ignore"):
        try:
            found = gauss_newton(_add_noise(fit, rng), fit.solution.p, iterations=30)
        except np.linalg.LinAlgError:
            return None
    values = fit.structure.physical(found.p[: fit.structure.count])
    return values if found.result == "converged" and np.isfinite(values).all() else None


def _add_noise(fit: Fit, rng: np.random.Generator) -> MissingTorqueProblem:
    """The problem with noise added once more, scaled as the covariance of the fit."""
    scale = np.sqrt(max(1.0, fit.solution.reduced))
    blocks = []
    for block in fit.problem.blocks:
        noise = scale * _complex_noise(rng, block.noise)
        motors = block.position.shape[1]
        blocks.append(
            replace(
                block,
                position=block.position + noise[:, :motors],
                torque=block.torque + noise[:, motors:],
            )
        )
    priors = {
        name: (mean + scale * std * float(rng.standard_normal()), std)
        for name, (mean, std) in fit.problem.priors.items()
    }
    return replace(fit.problem, blocks=tuple(blocks), priors=priors)


def _complex_noise(rng: np.random.Generator, power: Float64) -> Complex128:
    """(F, 2M) complex normal numbers of an (F, 2M) power E[|n|²]."""
    both = rng.standard_normal((2, *power.shape))
    out: Complex128 = (both[0] + 1j * both[1]) * np.sqrt(power / 2.0)
    return out
