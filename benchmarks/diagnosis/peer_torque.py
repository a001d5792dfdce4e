"""Plain models of the same recording and split: rigid with friction and weight by least squares, FIR and ARX.

Each predicts the held-out torque from the measured motion; the figure is the share of it that is missed, rms,
below the same frequency.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import butter, sosfiltfilt

from invid.recording import Experiment, Recording, Role

PEERS = ("rigid + friction + gravity", "FIR", "ARX")
ORDERS = (1, 2, 3, 4, 6, 8, 12)
"""Of FIR (samples each way) and ARX; the best on a quarter of the identification data that is kept out is
taken."""


def shares(recording: Recording, below_hz: float) -> dict[str, list[float]]:
    """Share of each axis' held-out torque that each model misses (1: all of it)."""
    fit = [e for e in recording.experiments if e.role is Role.IDENTIFY]
    held = [e for e in recording.experiments if e.role is Role.VALIDATE]
    found: dict[str, list[float]] = {name: [] for name in PEERS}
    for axis in range(recording.axis_count):
        own = [_signals(e, axis, below_hz) for e in fit]
        others = [_signals(e, axis, below_hz) for e in held]
        a = np.concatenate([_rigid(*s[:3]) for s in own])
        x = np.linalg.lstsq(a, np.concatenate([s[3] for s in own]), rcond=None)[0]
        found[PEERS[0]].append(_missed([(s[3], _rigid(*s[:3]) @ x) for s in others]))
        found["FIR"].append(_best(own, others, _fir))
        found["ARX"].append(_best(own, others, _arx))
    return found


def _signals(e: Experiment, axis: int, below_hz: float) -> tuple[np.ndarray, ...]:
    """Position, velocity, acceleration, torque at even instants, all through the same filter."""
    rate = (e.samples - 1) / float(e.time[-1] - e.time[0])
    even = np.linspace(e.time[0], e.time[-1], e.samples)
    q, u = (np.interp(even, e.time, x[:, axis]) for x in (e.position, e.torque))
    low = butter(4, min(below_hz / (0.5 * rate), 0.9), output="sos")
    q, u = sosfiltfilt(low, q), sosfiltfilt(low, u)
    v = np.gradient(q) * rate
    a = np.gradient(v) * rate
    step = max(int(rate / (4 * below_hz)), 1)
    trim = slice(5, -5, step)
    return q[trim], v[trim], a[trim], u[trim]


def _rigid(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    turning = 0.01 * np.abs(v).max()
    return np.column_stack([a, v, np.tanh(v / turning), np.ones_like(q), np.sin(q), np.cos(q)])


def _missed(pairs: list[tuple[np.ndarray, np.ndarray]]) -> float:
    left = sum(float(np.sum((u - p) ** 2)) for u, p in pairs)
    return float(np.sqrt(left / sum(float(np.sum(u**2)) for u, _ in pairs)))


Records = list[tuple[np.ndarray, ...]]


def _best(own: Records, others: Records, missed: Callable[[Records, Records, int], float]) -> float:
    """Share missed by the order that misses least of a quarter of the identification data."""
    train = [tuple(x[: 3 * x.size // 4] for x in s) for s in own]
    test = [tuple(x[3 * x.size // 4 :] for x in s) for s in own]
    return missed(own, others, min(ORDERS, key=lambda order: missed(train, test, order)))


def _fir(own: Records, others: Records, order: int) -> float:
    def window(q: np.ndarray) -> np.ndarray:
        around = np.lib.stride_tricks.sliding_window_view(q, 2 * order + 1)
        return np.column_stack([around, np.ones(around.shape[0])])

    rows = np.concatenate([window(s[0]) for s in own])
    model = np.linalg.lstsq(rows, np.concatenate([s[3][order:-order] for s in own]), rcond=None)[0]
    return _missed([(s[3][order:-order], window(s[0]) @ model) for s in others])


def _arx(own: Records, others: Records, order: int) -> float:
    model = _fitted(own, order)
    return _missed([(s[3], _run(s, order, model)) for s in others])


def _fitted(records: list[tuple[np.ndarray, ...]], order: int) -> np.ndarray:
    rows = np.concatenate([_lags(s[0], s[3], order) for s in records])
    model: np.ndarray = np.linalg.lstsq(rows, np.concatenate([s[3][order:] for s in records]), rcond=None)[0]
    return model


def _lags(q: np.ndarray, u: np.ndarray, order: int) -> np.ndarray:
    n = u.size - order
    past = [u[order - k : order - k + n] for k in range(1, order + 1)]
    motion = [q[order - k : order - k + n] for k in range(order + 1)]
    return np.column_stack([*past, *motion, np.ones(n)])


def _run(s: tuple[np.ndarray, ...], order: int, model: np.ndarray) -> np.ndarray:
    """Simulated: it sees the measured torque of the first ``order`` samples only."""
    q, out = s[0], s[3].copy()
    bound = 1e3 * np.abs(s[3]).max()
    for i in range(order, out.size):
        row = np.concatenate([out[i - order : i][::-1], q[i - order : i + 1][::-1], [1.0]])
        out[i] = np.clip(row @ model, -bound, bound)
    return out
