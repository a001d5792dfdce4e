"""Plain models of the same recording, split and samples: what a skilled hand fits by least squares.

Each predicts the held-out torque of an axis from the measured motion of all; ridge and order are chosen on a
quarter of the identification data that is kept out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, lfilter, sosfiltfilt

from invid.numerics.compiled import compiled
from invid.recording import Experiment, Recording, Role

RIDGES = 10.0 ** np.arange(-8.0, 1.0)
ORDERS = (1, 2, 4, 8, 16)
"""Samples each way of FIR, past ones of ARX."""
RIPPLES = (2, 3, 4, 6, 8, 12, 16, 24, 36, 48, 72, 100)
"""Cycles a unit of position that a ripple may have; the ridge weighs what is not there."""
YIELDS = np.geomspace(1e-4, 0.3, 6)
"""Travel at which elasto-plastic elements slide, over the travel of the axis."""
Columns = list[np.ndarray]


@dataclass(frozen=True)
class Signals:
    """Even samples of one experiment: motion (n, M) differentiated below the band, torque as recorded."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray
    step: float


def signals(e: Experiment, below_hz: float) -> Signals:
    """The samples of an experiment on even instants."""
    step = float(e.time[-1] - e.time[0]) / (e.samples - 1)
    even = np.linspace(e.time[0], e.time[-1], e.samples)
    q, u = (np.stack([np.interp(even, e.time, c) for c in x.T], axis=1) for x in (e.position, e.torque))
    smooth = low_passed(q, step, below_hz)
    v = np.gradient(smooth, step, axis=0)
    return Signals(q, v, np.gradient(v, step, axis=0), u, step)


def low_passed(x: np.ndarray, step: float, below_hz: float) -> np.ndarray:
    """Samples without what lies above the band, at no phase."""
    out: np.ndarray = sosfiltfilt(butter(4, min(2 * below_hz * step, 0.9), output="sos"), x, axis=0)
    return out


def missed(parts: list[tuple[np.ndarray, np.ndarray, float]], below_hz: float) -> float:
    """Rms of what predictions miss below the band over that of the torque, every sample of every part."""
    pairs = [(low_passed(u - p, step, below_hz), low_passed(u, step, below_hz)) for u, p, step in parts]
    return float(np.sqrt(sum(np.sum(a**2) for a, _ in pairs) / sum(np.sum(b**2) for _, b in pairs)))


@compiled
def elasto_plastic(position: np.ndarray, reach: float) -> np.ndarray:
    """Displacement of a slider that yields at ``reach`` (Prandtl's element), over it."""
    out, z = np.zeros_like(position), 0.0
    for k in range(1, position.size):
        z = min(max(z + position[k] - position[k - 1], -reach), reach)
        out[k] = z / reach
    return out


def rigid(s: Signals, axis: int, _: float) -> np.ndarray:
    """Inertia and couplings, friction, weights of the axis and of those beside it in the chain."""
    v = s.velocity[:, axis]
    own = [v, np.tanh(v / (0.01 * np.abs(v).max())), np.ones_like(v)]
    count = s.position.shape[1]
    angles = [
        s.position[:, i : j + 1].sum(axis=1)
        for i in range(count)
        for j in range(i, count)
        if i <= axis + 1 and j >= axis
    ]
    pairs = (
        [s.velocity[:, i] * s.velocity[:, j] for i in range(count) for j in range(i, count)]
        if count > 1
        else []
    )
    return np.column_stack([s.acceleration, *own, *(f(a) for a in angles for f in (np.sin, np.cos)), *pairs])


def with_memory(s: Signals, axis: int, travel: float) -> np.ndarray:
    """The same with ripple of the position and elasto-plastic elements."""
    q = s.position[:, axis]
    ripple = [f(k * q) for k in RIPPLES for f in (np.sin, np.cos)]
    return np.column_stack(
        [rigid(s, axis, travel), *ripple, *(elasto_plastic(q, y * travel) for y in YIELDS)]
    )


def ridged(a: np.ndarray, b: np.ndarray, ridge: float) -> np.ndarray:
    """Coefficients, every column of the same size."""
    size = np.maximum(np.sqrt(np.mean(a**2, axis=0)), 1e-300)
    normal = (a / size).T @ (a / size) / len(b)
    out: np.ndarray = np.linalg.solve(normal + ridge * np.eye(len(normal)), (a / size).T @ b / len(b)) / size
    return out


def static(
    build: Callable[[Signals, int, float], np.ndarray], s: Signals, axis: int, travel: float, order: int
) -> np.ndarray:
    """Columns of a model, or with an order those of neighbouring samples as well (FIR)."""
    a = build(s, axis, travel)
    if order == 0:
        return a
    long = np.pad(s.position[:, axis] - s.position[:, axis].mean(), order, mode="edge")
    return np.column_stack([a, np.lib.stride_tricks.sliding_window_view(long, 2 * order + 1)])


def shares(recording: Recording, below_hz: float) -> dict[str, list[float]]:
    """Share of each axis' held-out torque that each model misses (1: all of it)."""
    fit, held = (
        [signals(e, below_hz) for e in recording.with_role(r)] for r in (Role.IDENTIFY, Role.VALIDATE)
    )
    found: dict[str, list[float]] = {"rigid": [], "+ ripple, memory": [], "FIR or ARX": []}
    for axis in range(recording.axis_count):
        travel = max(float(np.ptp(s.position[:, axis])) for s in fit)
        for name, build, orders in (
            ("rigid", rigid, (0,)),
            ("+ ripple, memory", with_memory, (0,)),
            ("FIR or ARX", rigid, ORDERS),
        ):
            trials = []
            for order in orders:
                own, other = ([static(build, s, axis, travel, order) for s in part] for part in (fit, held))
                for past in {0, min(order, 4)}:
                    trials.append(_figures((own, fit), (other, held), axis, past, below_hz))
            found[name].append(min(trials)[1])
    return found


Part = tuple[Columns, list[Signals]]


def _figures(own: Part, other: Part, axis: int, past: int, below_hz: float) -> tuple[float, float]:
    """Share missed of the quarter kept out, and of the held-out data by the same ridge fitted to all."""

    def cut(part: Part, rows: Callable[[int], slice]) -> list[tuple[np.ndarray, np.ndarray, float]]:
        return [(a[rows(len(a))], s.torque[rows(len(a)), axis], s.step) for a, s in zip(*part, strict=True)]

    quarter = cut(own, lambda n: slice(0, 3 * n // 4)), cut(own, lambda n: slice(3 * n // 4, n))
    whole = cut(own, slice), cut(other, slice)
    best = min(RIDGES, key=lambda r: _of_ridge(*quarter, past, r, below_hz))
    return _of_ridge(*quarter, past, best, below_hz), _of_ridge(*whole, past, best, below_hz)


def _of_ridge(train: list, test: list, past: int, ridge: float, below_hz: float) -> float:
    """Share missed of the test; with past torques (ARX) simulated, so that it sees no torque it predicts."""

    def lagged(a: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.column_stack([*(np.concatenate([np.zeros(k), u[:-k]]) for k in range(1, past + 1)), a])

    x = ridged(
        np.concatenate([lagged(a, u) for a, u, _ in train]), np.concatenate([u for _, u, _ in train]), ridge
    )
    poles = np.concatenate([[1.0], -x[:past]])
    if past and np.abs(np.roots(poles)).max() >= 1.0:
        return np.inf
    return missed([(u, lfilter([1.0], poles, a @ x[past:]), step) for a, u, step in test], below_hz)
