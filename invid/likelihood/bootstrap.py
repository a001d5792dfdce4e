"""What the noise does to the estimates, by doing it again: a parametric bootstrap on all cores.

Noise of the covariance that the fit ended with is drawn and added to the lines of every record once more,
what is known beforehand is drawn as well, and everything is fitted again from the estimate. The spread is a
standard deviation that rests on no linearisation; the mean shift is the bias that the noise makes (adding it
a second time makes it a second time: simulation extrapolation, Cook and Stefanski 1994). Of a wrong model it
says nothing: the records are the same.
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

LEAST = 20
"""Draws below which a spread is worth nothing: of 20 it is known to 16 %."""


@dataclass(frozen=True)
class Spread:
    """One parameter in physical units."""

    std: float
    bias: float
    """Mean of the draws minus the estimate."""
    low: float
    high: float
    """16 % and 84 % of the draws."""


def bootstrap(fit: Fit, draws: int, *, workers: int = 1, seed: int = 0) -> dict[str, Spread]:
    """Masses, springs, couplings and dampers that moved in the fit; the same for any number of ``workers``.

    Raises
    ------
    InputError
        Fewer than 20 draws.
    NotIdentifiableError
        More than a tenth of the draws could not be fitted.
    """
    if draws < LEAST:
        raise InputError(f"a bootstrap of {draws} draws: take {LEAST} or more, 200 for a spread to 5 %")
    tried = [v for v in _all(fit, draws, workers, seed) if v is None or v.size]
    if len(tried) < draws:
        budget.leave_out(f"{draws - len(tried)} of {draws} draws of the bootstrap")
    if len(tried) < LEAST:
        return {}
    draws = len(tried)
    found = np.array([v for v in tried if v is not None])
    if found.shape[0] < 0.9 * draws:
        raise NotIdentifiableError(
            f"{draws - found.shape[0]} of {draws} draws of the bootstrap could not be fitted: the noise is "
            "as large as what the parameters are read from; raise the amplitude or measure longer"
        )
    moved = fit.solution.free[: fit.structure.count]
    low, high = np.quantile(found, (0.16, 0.84), axis=0)
    std, mean = found.std(axis=0, ddof=1), found.mean(axis=0)
    return {
        name: Spread(float(std[k]), float(mean[k] - fit.values[k]), float(low[k]), float(high[k]))
        for k, name in enumerate(fit.names)
        if moved[k]
    }


def _all(fit: Fit, draws: int, workers: int, seed: int) -> Iterator[Float64 | None]:
    """(n,) parameters of every draw."""
    if workers <= 1 or "fork" not in multiprocessing.get_all_start_methods():
        for k in range(draws):
            yield _draw(fit, seed, k)
        return
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(workers, context, initializer=_take, initargs=(fit, seed)) as pool:
        yield from pool.map(_own, range(draws), chunksize=max(1, draws // (8 * workers)))


_given: list[tuple[Fit, int]] = []
"""What a worker works on: sent once, not with every draw."""


def _take(fit: Fit, seed: int) -> None:
    _given[:] = [(fit, seed)]


def _own(number: int) -> Float64 | None:
    fit, seed = _given[0]
    return _draw(fit, seed, number)


def _draw(fit: Fit, seed: int, number: int) -> Float64 | None:
    """Parameters in physical units with noise drawn anew; none where the fit ends nowhere, empty where there
    was no time for it."""
    if budget.is_spent():
        return np.zeros(0)
    rng = np.random.default_rng([seed, number])
    with np.errstate(all="ignore"):
        try:
            found = gauss_newton(_noisier(fit, rng), fit.solution.p, iterations=30)
        except np.linalg.LinAlgError:
            return None
    values = fit.structure.physical(found.p[: fit.structure.count])
    return values if found.result == "converged" and np.isfinite(values).all() else None


def _noisier(fit: Fit, rng: np.random.Generator) -> MissingTorqueProblem:
    """The problem with noise added once more, scaled as the covariance of the fit is."""
    scale = np.sqrt(max(1.0, fit.solution.reduced))
    blocks = []
    for block in fit.problem.blocks:
        noise = scale * _complex(rng, block.noise)
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


def _complex(rng: np.random.Generator, power: Float64) -> Complex128:
    """(F, 2M) complex normal numbers of an (F, 2M) power E[|n|²]."""
    both = rng.standard_normal((2, *power.shape))
    out: Complex128 = (both[0] + 1j * both[1]) * np.sqrt(power / 2.0)
    return out
