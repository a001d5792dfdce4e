"""Modal fit of an FRF matrix: vector-fitted poles, then weighted least squares over all modes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from invid.arrays import Bool, Complex128, Float64
from invid.errors import InputError, NotIdentifiableError
from invid.modes.model import Modes, high_gain_pairs, lag_functions, mode_shape_functions, pairs
from invid.modes.vector_fit import relocate_poles

_MOST_VALUES = 12_000  # for the pole search alone; beyond that lines add time, not poles
_STARTING_DAMPING = 0.01
_GOOD = 2.0
"""χ²/dof at which the search for poles ends: no other start can do more than halve it."""
_MODEL_ERRORS = (0.0, 0.02, 0.1)
"""Relative model errors the pole search is tried with: friction makes the FRF wrong by more than its
noise, and then noise weights alone would spend every pole on the lowest lines."""


@dataclass(frozen=True, eq=False)
class _Data:
    w: Float64  # (F,)
    g: Complex128  # (F, P) symmetric part
    variance: Float64  # (F, P)
    count: int
    masses: tuple[int, ...]

    @property
    def modes(self) -> int:
        return sum(self.masses) - self.count

    def weight(self, model_error: float) -> Float64:
        rows, columns = pairs(self.count)
        size = np.abs(self.g)
        diagonal = np.flatnonzero(rows == columns)
        own = size[:, diagonal]
        # a cross entry that happens to be small is not better known than the entries around it
        scale = np.maximum(size**2, 0.01 * own[:, rows] * own[:, columns])
        weight: Float64 = 1.0 / np.sqrt(self.variance + model_error**2 * scale)
        return weight


def fit_modes(
    frequency_hz: npt.ArrayLike,
    frf: npt.ArrayLike,
    frf_variance: npt.ArrayLike,
    masses: Sequence[int],
) -> Modes:
    """Modes of a measured receptance matrix, with covariance; needs no start values.

    Parameters
    ----------
    frequency_hz
        (F,) lines [Hz], > 0.
    frf
        (F, M, M) receptance Θ = G T [rad/(N·m) or m/N].
    frf_variance
        (F, M, M) or (F, M·M) variance E|n|² of each entry.
    masses
        (M,) masses per branch: fixes the number of modes Σ(N_i − 1).

    Raises
    ------
    InputError
        Shapes that do not fit, values that are not finite.
    NotIdentifiableError
        Fewer lines than unknowns.
    """
    data = _checked(frequency_hz, frf, frf_variance, masses)
    best: tuple[float, _Fit] | None = None
    for model_error, order in _attempts(data):
        weight = data.weight(model_error)
        for poles in _pole_candidates(data, weight, order):
            fit = _levenberg(data, weight, _residue_start(data, weight, poles), 20)
            if data.modes and _reduced(data, data.weight(0.0), fit) > _GOOD:
                fit = _levenberg(data, weight, replace(fit, lag=np.zeros(fit.shapes.shape)), 20)
            # candidates are compared under one weight that no candidate was favoured by
            cost = _robust_cost(data, fit)
            if best is None or cost < best[0]:
                best = (cost, fit)
        if best is not None and _reduced(data, data.weight(0.0), best[1]) < _GOOD:
            break
    if best is not None and data.modes and _reduced(data, data.weight(0.0), best[1]) > _GOOD:
        best = _moved_to_the_misfit(data, best)
    if best is None:
        raise NotIdentifiableError("modal fit: no start converged; measure longer or raise the amplitude")
    return _finish(data, best[1])


def _checked(
    frequency_hz: npt.ArrayLike, frf: npt.ArrayLike, variance: npt.ArrayLike, masses: Sequence[int]
) -> _Data:
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
    data = _Data(
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


def _attempts(data: _Data) -> Iterator[tuple[float, int]]:
    """Model error and number of searched poles of one attempt after another."""
    for model_error in _MODEL_ERRORS:
        yield model_error, data.modes
    # equal or symmetric branches share poles: fewer of them, with residues of higher rank
    chain = max(data.masses) - 1
    tried = {data.modes - 1, data.modes - 2, data.modes - chain, 2 * chain, chain}
    for order in sorted(tried, reverse=True):
        if 0 < order < data.modes:
            yield _MODEL_ERRORS[0], order


# --- poles -----------------------------------------------------------------------------------------
def _pole_candidates(data: _Data, weight: Float64, n: int) -> list[Complex128]:
    if n == 0:
        return [np.zeros(0, dtype=complex)]
    pick = _search_lines(data, max(_MOST_VALUES // data.g.shape[1], 12 * n))
    scale = float(np.sqrt(data.w[0] * data.w[-1]))  # near 1: conditioning
    w = data.w[pick] / scale
    acceleration = -(data.w[pick, None] ** 2) * data.g[pick]
    inverse = weight[pick] / data.w[pick, None] ** 2
    found = []
    starting = _starting_frequencies(data, pick, n)
    for start in starting if n == data.modes else starting[:1]:
        poles = ((start / scale) * (-_STARTING_DAMPING + 1j)).astype(np.complex128)
        found.append(relocate_poles(w, acceleration, inverse, poles, 25) * scale)
    return found


def _peakedness(data: _Data, pick: npt.NDArray[np.intp]) -> Float64:
    """(…,) summed acceleration gain of lines, each entry relative to its own median."""
    size = np.abs(data.g[pick]) * data.w[pick, None] ** 2
    total: Float64 = np.sum((size / np.maximum(np.median(size, axis=0), np.finfo(float).tiny)) ** 2, axis=1)
    return total


def _search_lines(data: _Data, most: int) -> npt.NDArray[np.intp]:
    """At most about ``most`` lines: half spread evenly, half where the response is largest."""
    every = np.arange(data.w.size)
    if every.size <= most:
        return every
    even = np.linspace(0, data.w.size - 1, most // 2).astype(np.intp)
    return np.union1d(even, np.argsort(_peakedness(data, every))[::-1][: most // 2])


def _starting_frequencies(data: _Data, pick: npt.NDArray[np.intp], n: int) -> list[Float64]:
    w = data.w[pick]
    linear = np.linspace(w[0], w[-1], n + 2)[1:-1] if n > 1 else np.array([np.sqrt(w[0] * w[-1])])
    geometric = np.geomspace(w[0], w[-1], n + 2)[1:-1]
    total = _peakedness(data, pick)
    inside = np.flatnonzero((total[1:-1] > total[:-2]) & (total[1:-1] >= total[2:])) + 1
    peaks = w[inside[np.argsort(total[inside])[::-1][:n]]]
    if peaks.size < n:
        peaks = np.concatenate((peaks, linear[: n - peaks.size] * 1.01))
    return [np.sort(peaks), linear, geometric]


def _moved_to_the_misfit(data: _Data, best: tuple[float, _Fit]) -> tuple[float, _Fit]:
    """The weakest mode tried where the misfit is largest: a missed peak is found there."""
    weight = data.weight(0.01)
    rows, columns = pairs(data.count)
    tried: list[float] = []
    for _ in range(4):
        fit = best[1]
        misfit = np.sum((weight * _misfit(data, fit)) ** 2, axis=1)
        misfit = np.convolve(misfit, np.ones(3) / 3, mode="same")
        for known in tried:
            misfit[np.abs(np.log(data.w / known)) < 0.02] = 0.0
        target = float(data.w[int(np.argmax(misfit))])
        tried.append(target)
        functions = mode_shape_functions(data.w, fit.omega, fit.damping)
        energy = np.einsum("fp,fr->rp", weight**2, np.abs(functions) ** 2)
        strength = np.sum(energy * (fit.shapes[:, rows] * fit.shapes[:, columns]) ** 2, axis=1)
        poles = (fit.omega * (-np.minimum(fit.damping, 0.5) + 1j)).astype(np.complex128)
        for weakest in np.argsort(strength)[:2]:
            moved = poles.copy()
            moved[weakest] = target * (-_STARTING_DAMPING + 1j)
            fresh = _residue_start(data, weight, moved)
            fresh = _levenberg(data, weight, replace(fresh, lag=np.zeros(fresh.shapes.shape)), 30)
            cost = _robust_cost(data, fresh)
            if cost < best[0]:
                best = (cost, fresh)
        if _reduced(data, data.weight(0.0), best[1]) < _GOOD:
            break
    return best


# --- all modes -------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class _Fit:
    omega: Float64
    damping: Float64
    shapes: Float64  # (n, M)
    high: Float64  # (allowed,)
    friction: Float64  # (P,)
    lag: Float64 | None = None  # (n, M) where complex modes are fitted


def _model(data: _Data, fit: _Fit, allowed: Bool) -> Complex128:
    rows, columns = pairs(data.count)
    g = mode_shape_functions(data.w, fit.omega, fit.damping) @ (fit.shapes[:, rows] * fit.shapes[:, columns])
    g = g - 1j * fit.friction / data.w[:, None] ** 3
    g[:, allowed] -= fit.high / data.w[:, None] ** 2
    if fit.lag is not None:
        turned = fit.shapes[:, rows] * fit.lag[:, columns] + fit.lag[:, rows] * fit.shapes[:, columns]
        g = g + lag_functions(data.w, fit.omega, fit.damping) @ turned
    out: Complex128 = g
    return out


def _residue_start(data: _Data, weight: Float64, poles: Complex128) -> _Fit:
    """Symmetric real residues by linear least squares for fixed poles, cut to n terms of rank one.

    A pole that several modes share has a residue of higher rank: the n strongest eigenvectors of all
    residues, by what they add to the weighted response, become the modes.
    """
    n, count = poles.size, data.count
    rows, columns = pairs(count)
    allowed = high_gain_pairs(data.masses)
    omega = np.abs(poles)
    damping = np.clip(-poles.real / np.maximum(omega, np.finfo(float).tiny), 1e-5, 0.7)
    functions = mode_shape_functions(data.w, omega, damping)
    residue = np.zeros((n, count, count))
    high, friction = np.zeros(rows.size), np.zeros(rows.size)
    for p in range(rows.size):
        columns_p = [functions, (-1j / data.w**3)[:, None]]
        if allowed[p]:
            columns_p.append((-1.0 / data.w**2 + 0j)[:, None])
        left = weight[:, p : p + 1] * np.concatenate(columns_p, axis=1)
        stacked = np.concatenate((left.real, left.imag))
        target = weight[:, p] * data.g[:, p]
        norm = np.linalg.norm(stacked, axis=0)
        norm[norm == 0] = 1.0
        solution = (
            np.linalg.lstsq(stacked / norm, np.concatenate((target.real, target.imag)), rcond=1e-10)[0] / norm
        )
        residue[:, rows[p], columns[p]] = residue[:, columns[p], rows[p]] = solution[:n]
        friction[p] = solution[n]
        if allowed[p]:
            high[p] = solution[n + 1]
    strength, pole, shapes = [], [], []
    energy = np.einsum("fp,fr->rp", weight**2, np.abs(functions) ** 2)
    for r in range(n):
        values, vectors = np.linalg.eigh(residue[r])
        for value, vector in zip(values, vectors.T, strict=True):
            shape = np.sqrt(max(value, 1e-6 * max(np.abs(values).max(), 1e-30))) * vector
            strength.append(float(energy[r] @ (shape[rows] * shape[columns]) ** 2))
            pole.append(r)
            shapes.append(shape)
    strongest = np.argsort(strength)[::-1][: data.modes]
    chosen = np.array(pole, dtype=int)[strongest]
    # modes that share a pole must not start at exactly one point
    split = 1.0 + 1e-4 * np.arange(chosen.size)
    return _Fit(
        omega[chosen] * split,
        damping[chosen],
        np.array(shapes).reshape(-1, count)[strongest],
        high[allowed],
        friction,
    )


def _pack(fit: _Fit) -> Float64:
    lag = np.zeros(0) if fit.lag is None else fit.lag.ravel()
    packed: Float64 = np.concatenate(
        (np.log(fit.omega), np.log(fit.damping), fit.shapes.ravel(), fit.high, fit.friction, lag)
    )
    return packed


def _unpack(x: Float64, like: _Fit) -> _Fit:
    n, count = like.shapes.shape
    a, b = 2 * n, 2 * n + n * count
    c = b + like.high.size
    d = c + like.friction.size
    lag = None if like.lag is None else x[d:].reshape(n, count)
    return _Fit(np.exp(x[:n]), np.exp(x[n:a]), x[a:b].reshape(n, count), x[b:c], x[c:d], lag)


def _normal_equations(
    data: _Data, weight: Float64, fit: _Fit, allowed: Bool
) -> tuple[float, Float64, Float64]:
    """Cost, gradient and Gauss–Newton matrix, entry by entry so that memory stays small."""
    n, count = fit.shapes.shape
    rows, columns = pairs(count)
    w = data.w
    functions = mode_shape_functions(w, fit.omega, fit.damping)
    receptance = functions - 1.0 / w[:, None] ** 2
    squared = receptance**2
    by_omega = -squared * (2 * fit.omega**2 + 2j * fit.damping * fit.omega * w[:, None])
    by_damping = -squared * (2j * fit.damping * fit.omega * w[:, None])
    residual = weight * (_model(data, fit, allowed) - data.g)
    after_shapes = 2 * n + n * count
    after_high = after_shapes + int(allowed.sum())
    after_friction = after_high + rows.size
    size = after_friction + (0 if fit.lag is None else n * count)
    quarter = lag_functions(w, fit.omega, fit.damping)
    gradient, hessian = np.zeros(size), np.zeros((size, size))
    place = np.cumsum(allowed) - 1
    for p, (i, j) in enumerate(zip(rows, columns, strict=True)):
        product = fit.shapes[:, i] * fit.shapes[:, j]
        blocks = [by_omega * product, by_damping * product, functions * fit.shapes[:, j]]
        index = [np.arange(2 * n), 2 * n + np.arange(n) * count + i]
        if i == j:
            blocks[-1] = 2 * blocks[-1]
        else:
            blocks.append(functions * fit.shapes[:, i])
            index.append(2 * n + np.arange(n) * count + j)
        if allowed[p]:
            blocks.append(-1.0 / w[:, None] ** 2 + 0j)
            index.append(np.array([after_shapes + place[p]]))
        blocks.append(-1j / w[:, None] ** 3)
        index.append(np.array([after_high + p]))
        if fit.lag is not None:
            # d/dφ and d/dχ of φ_iχ_j + χ_iφ_j; its dependence on ω_r and ζ_r is of second order
            blocks[2] = blocks[2] + quarter * fit.lag[:, j] * (2 if i == j else 1)
            blocks.append(quarter * fit.shapes[:, j] * (2 if i == j else 1))
            index.append(after_friction + np.arange(n) * count + i)
            if i != j:
                blocks[3] = blocks[3] + quarter * fit.lag[:, i]
                blocks.append(quarter * fit.shapes[:, i])
                index.append(after_friction + np.arange(n) * count + j)
        jacobian = weight[:, p : p + 1] * np.concatenate(blocks, axis=1)
        at = np.concatenate(index)
        gradient[at] += (jacobian.conj().T @ residual[:, p]).real
        hessian[np.ix_(at, at)] += (jacobian.conj().T @ jacobian).real
    if fit.lag is not None:
        prior = _lag_prior(fit)
        at = after_friction + np.arange(n * count)
        gradient[at] += prior * fit.lag.ravel()
        hessian[at, at] += prior
    return _cost(data, weight, fit, allowed), gradient, hessian


def _lag_prior(fit: _Fit) -> Float64:
    """Inverse variance of χ before any data: half the size of its mode's shape. Dampers that turn a
    mode further than that make it no mode; only what no motor sees is decided by it."""
    size = np.sqrt(np.mean(fit.shapes**2, axis=1))
    prior: Float64 = np.repeat(1.0 / (0.5 * np.maximum(size, 1e-12)) ** 2, fit.shapes.shape[1])
    return prior


def _cost(data: _Data, weight: Float64, fit: _Fit, allowed: Bool) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        cost = float(np.sum(np.abs(weight * (_model(data, fit, allowed) - data.g)) ** 2))
    if fit.lag is not None:
        cost += float(np.sum(_lag_prior(fit) * fit.lag.ravel() ** 2))
    return cost


def _levenberg(data: _Data, weight: Float64, start: _Fit, iterations: int = 60) -> _Fit:
    allowed = high_gain_pairs(data.masses)
    n = start.omega.size
    x, trust = _pack(start), 1e-3
    cost, gradient, hessian = _normal_equations(data, weight, start, allowed)
    for _ in range(iterations):
        scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
        normal = hessian / np.outer(scale, scale)
        improved = False
        for _ in range(8):
            step = -np.linalg.solve(normal + trust * np.eye(x.size), gradient / scale) / scale
            step[: 2 * n] = np.clip(step[: 2 * n], -1.0, 1.0)  # log steps: at most a factor e
            trial = x + step
            trial[n : 2 * n] = np.clip(trial[n : 2 * n], np.log(1e-7), np.log(2.0))
            fit = _unpack(trial, start)
            fresh = _cost(data, weight, fit, allowed)
            if np.isfinite(fresh) and fresh < cost:
                improved = True
                break
            trust *= 6.0
        if not improved:
            break
        gain, x, trust = cost - fresh, trial, max(trust / 5.0, 1e-12)
        cost, gradient, hessian = _normal_equations(data, weight, fit, allowed)
        if gain < 1e-6 * cost:
            break
    return _unpack(x, start)


def _misfit(data: _Data, fit: _Fit) -> Float64:
    difference: Float64 = np.abs(_model(data, fit, high_gain_pairs(data.masses)) - data.g)
    return difference


def _robust_cost(data: _Data, fit: _Fit) -> float:
    return float(np.mean(np.log1p((data.weight(0.01) * _misfit(data, fit)) ** 2)))


def _reduced(data: _Data, weight: Float64, fit: _Fit) -> float:
    dof = max(2 * data.g.size - _pack(fit).size, 1)
    return float(2 * np.sum((weight * _misfit(data, fit)) ** 2) / dof)


def _with_complex_modes(data: _Data, fit: _Fit) -> _Fit:
    """The fit with complex modes where the data ask for them: χ² falls by more than twice what as many
    parameters of pure noise would take."""
    if fit.omega.size == 0:
        return fit
    weight = data.weight(0.0)
    if fit.lag is None:
        start, plain = replace(fit, lag=np.zeros(fit.shapes.shape)), fit
    else:
        start, plain = fit, _levenberg(data, weight, replace(fit, lag=None))
    before = _reduced(data, weight, plain)
    turned = _levenberg(data, data.weight(0.01), start) if before > 4.0 else start
    turned = _levenberg(data, weight, turned)
    dof = 2 * data.g.size
    fall = dof * (before - _reduced(data, weight, turned))
    scale = max(_reduced(data, weight, turned), 1.0)
    return turned if fall > 4.0 * scale * fit.shapes.size else plain


def _finish(data: _Data, fit: _Fit) -> Modes:
    """Last iterations under the noise, or under the model error that makes χ²/dof = 1."""
    model_error = 0.0
    fit = _levenberg(data, data.weight(0.0), fit) if _reduced(data, data.weight(0.0), fit) < 4.0 else fit
    fit = _with_complex_modes(data, fit)
    if _reduced(data, data.weight(0.0), fit) > 1.5:
        for _ in range(3):
            low, high = 1e-6, 1.0
            for _ in range(40):
                model_error = float(np.sqrt(low * high))
                if _reduced(data, data.weight(model_error), fit) > 1.0:
                    low = model_error
                else:
                    high = model_error
            fit = _levenberg(data, data.weight(model_error), fit)
    allowed = high_gain_pairs(data.masses)
    _, _, hessian = _normal_equations(data, data.weight(model_error), fit, allowed)
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    # a complex variance E|n|² puts half into each part, hence 2 × the information
    covariance = (
        0.5 * np.linalg.pinv(hessian / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    )
    order = np.argsort(fit.omega)
    n, count = fit.shapes.shape
    tail = 2 * n + n * count + fit.high.size + fit.friction.size
    index = np.concatenate(
        (
            order,
            n + order,
            (2 * n + order[:, None] * count + np.arange(count)).ravel(),
            np.arange(2 * n + n * count, tail),
            [] if fit.lag is None else (tail + order[:, None] * count + np.arange(count)).ravel(),
        )
    ).astype(int)
    rows, columns = pairs(count)
    high_gain, friction = np.zeros((count, count)), np.zeros((count, count))
    high_gain[rows[allowed], columns[allowed]] = high_gain[columns[allowed], rows[allowed]] = fit.high
    friction[rows, columns] = friction[columns, rows] = fit.friction
    return Modes(
        omega=fit.omega[order],
        damping=fit.damping[order],
        shapes=fit.shapes[order],
        high_gain=high_gain,
        friction=friction,
        masses=data.masses,
        covariance=covariance[np.ix_(index, index)],
        chi2=float(2 * np.sum((data.weight(0.0) * _misfit(data, fit)) ** 2)),
        dof=2 * data.g.size - covariance.shape[0],
        model_error=model_error,
        lag=np.zeros((n, count)) if fit.lag is None else fit.lag[order],
    )
