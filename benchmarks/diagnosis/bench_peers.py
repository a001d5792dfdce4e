"""What a generic approach gives on the same hidden effects: sparse regression on the residual.

    pip install invid[bench]
    python benchmarks/diagnosis/bench_peers.py [--trials 2] [--db 20 30]

For every cause of the catalogue that one axis can show, the missing torque under the identified linear
model is given, as a time signal, to PySINDy (STLSQ on a polynomial library of position, velocity and
acceleration to degree 3, and the same with sign(velocity) added by hand). The sparsity threshold of
STLSQ is chosen on the held-out record itself, in its favour. A third column goes further: the missing
torque under the *true* linear plant, the true motion of the load (worked out with the true masses from its
own equation, or from the sum of both where the cause sits in the spring), and a library of the physical terms
themselves of both masses (dry and viscous friction, gravity, deflection and its cube, …). Printed: share of
the held-out excess power removed, and the number of terms that a reader would have to interpret.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

CAUSES = (
    "coulomb_friction", "viscous_friction", "stribeck_friction", "presliding_friction",
    "asymmetric_friction", "cogging", "torque_lag", "torque_saturation", "cubic_stiffness", "backlash",
    "spring_hysteresis", "transmission_error", "gravity", "extra_mode",
)  # fmt: skip


def signals(recording: Any, model: Any) -> dict[str, list[tuple[np.ndarray, np.ndarray, float]]]:
    """Per role: (features (n, 3), missing torque (n,), noise power) of the one axis of each record."""
    from invid.report.spectra_data import missing_torque
    from invid.signals.spectra import all_spectra

    out: dict[str, list[tuple[np.ndarray, np.ndarray, float]]] = defaultdict(list)
    for s in all_spectra(recording):
        m = missing_torque(s, model.chains)
        band = s.frequency_hz <= 1.1 * s.frequency_hz[s.excited].max()
        count = s.time.size
        at = np.round(s.frequency_hz * count / s.sample_rate_hz).astype(int)[band]

        def wave(x: np.ndarray, at: np.ndarray = at, count: int = count) -> np.ndarray:
            spectrum = np.zeros(count // 2 + 1, dtype=complex)
            spectrum[at] = x * count / 2
            return np.fft.irfft(spectrum, count)

        jw, theta = 1j * s.omega[band], s.position[band, 0]
        features = np.stack([wave(theta), wave(jw * theta), wave(jw**2 * theta)], axis=1)
        noise = float((m.std[band, 0] ** 2).sum() / 2)
        out[str(s.role)].append((features, wave(m.torque[band, 0]), noise))
    return out


IN_THE_SPRING = {"cubic_stiffness", "backlash", "spring_hysteresis", "transmission_error"}


def physical(
    recording: Any, chains: Any, cause: str
) -> dict[str, list[tuple[np.ndarray, np.ndarray, float]]]:
    """As ``signals``, under the true plant: physical terms of true states (n, k) instead of the features."""
    from invid.report.spectra_data import missing_torque
    from invid.signals.spectra import all_spectra

    (m1, m2), (k,), (d,) = chains.masses[0], chains.springs[0], chains.dampers[0]
    out: dict[str, list[tuple[np.ndarray, np.ndarray, float]]] = defaultdict(list)
    for s in all_spectra(recording):
        missing = missing_torque(s, chains)
        band = s.frequency_hz <= 1.1 * s.frequency_hz[s.excited].max()
        count = s.time.size
        at = np.round(s.frequency_hz * count / s.sample_rate_hz).astype(int)[band]

        def wave(x: np.ndarray, at: np.ndarray = at, count: int = count) -> np.ndarray:
            spectrum = np.zeros(count // 2 + 1, dtype=complex)
            spectrum[at] = x * count / 2
            return np.fft.irfft(spectrum, count)

        jw, motor = 1j * s.omega[band], s.position[band, 0]
        load = motor * (k + jw * d) / (k + jw * d + m2 * jw**2)
        if cause in IN_THE_SPRING:
            load = (s.torque[band, 0] - m1 * jw**2 * motor) / (m2 * jw**2)
        q1, q2, v1, v2 = wave(motor), wave(load), wave(jw * motor), wave(jw * load)
        x, rate = q1 - q2, v1 - v2
        slow = 0.1 * max(v1.std(), 1e-12)
        terms = [
            np.sign(v1), v1, np.sign(v1) * np.exp(-((v1 / slow) ** 2)), np.abs(v1), np.sign(v2), v2,
            np.sin(q1), np.cos(q1), np.sin(q2), np.cos(q2), x, x**3, rate, np.sign(x), np.sign(rate),
            wave(jw**2 * motor), wave(jw**2 * load), wave(jw * s.torque[band, 0]), np.ones(count),
        ]  # fmt: skip
        columns = np.stack([t - t.mean() for t in terms[:-1]], axis=1)
        # What a force in the spring leaves at the motor, the load's share of it taken off.
        passed = np.zeros(count // 2 + 1, dtype=complex)
        passed[at] = m2 * jw**2 / (k + jw * d + m2 * jw**2)
        inside = np.isin(np.arange(columns.shape[1]), (10, 11, 12, 13, 14))
        columns[:, inside] = np.fft.irfft(
            np.fft.rfft(columns[:, inside], axis=0) * passed[:, None], count, axis=0
        )
        noise = float((missing.std[band, 0] ** 2).sum() / 2)
        out[str(s.role)].append((columns, wave(missing.torque[band, 0]), noise))
    return out


def best_of(train: tuple[np.ndarray, np.ndarray], test: Any, columns: Any) -> tuple[float, int]:
    """Held-out gain and number of terms of the best threshold of STLSQ."""
    import pysindy

    a, best = columns(train[0]), (-np.inf, 0)
    width = np.maximum(a.std(axis=0), 1e-300)
    for threshold in np.geomspace(1e-3, 0.5, 12):
        optimizer = pysindy.STLSQ(threshold=float(threshold), alpha=1e-6)
        optimizer.fit(a / width, (train[1] / train[1].std())[:, None])
        weights = np.asarray(optimizer.coef_)[0] * train[1].std() / width
        now = gain(test[1], columns(test[0]) @ weights, test[2])
        best = max(best, (now, int((weights != 0).sum())))
    return best


def gain(y: np.ndarray, predicted: np.ndarray, noise: float) -> float:
    """1 − (after² − noise²)/(before² − noise²), as in invid's own diagnosis."""
    before, after = float(np.mean(y**2)), float(np.mean((y - predicted) ** 2))
    return 1.0 - (after - noise) / max(before - noise, 1e-30)


def sindy(train: tuple[np.ndarray, np.ndarray], test: Any, *, sign: bool) -> tuple[float, int]:
    """Held-out gain and number of terms of the best threshold."""
    import pysindy

    library = pysindy.PolynomialLibrary(degree=3, include_bias=False)
    scale = train[0].std(axis=0)

    def columns(x: np.ndarray) -> np.ndarray:
        terms = np.asarray(library.fit_transform(x / scale))
        return np.column_stack([terms, np.sign(x[:, 1])]) if sign else terms

    return best_of(train, test, columns)


def joined(parts: Any) -> tuple[np.ndarray, np.ndarray]:
    """Features and missing torque of several records, one after the other."""
    return np.concatenate([x for x, _, _ in parts]), np.concatenate([y for _, y, _ in parts])


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=2)
    parser.add_argument("--db", type=float, nargs=2, default=[20.0, 30.0])
    parser.add_argument("--start", type=int, default=5000)
    parser.add_argument("--causes", nargs="+", default=CAUSES)
    arguments, _ = parser.parse_known_args()
    try:
        import pysindy  # noqa: F401
    except ImportError as error:
        print(f"NOT RUN: {error} (pip install invid[bench])")
        return 0
    from hidden.generator import make
    from hidden.scoring import score

    from invid.diagnosis.diagnose import diagnose
    from invid.identification.identify import identify

    warnings.simplefilter("ignore")
    print("held-out share of the excess explained (terms to read); invid: share, what it said\n")
    print(f"{'hidden cause':<22} {'SINDy':>12} {'SINDy+sign':>12} {'physical':>12}   invid")
    sums: dict[str, list[float]] = defaultdict(list)
    for cause in arguments.causes:
        for trial in range(arguments.trials):
            seed = arguments.start + trial
            goal = float(np.random.default_rng(seed).uniform(*arguments.db))
            recording, truth = make(cause, seed=seed, motors=1, masses=(2,), target_db=goal, moves=False)
            data = signals(recording, identify(recording))
            train = joined(data["identify"])
            test = data["validate"][0]
            if np.mean(test[1] ** 2) < 2 * test[2]:
                print(f"{cause:<22} not visible in the held-out record (seed {seed})", flush=True)
                continue
            told = physical(recording, truth.chains, cause)
            cells = [sindy(train, test, sign=False), sindy(train, test, sign=True)]
            cells.append(best_of(joined(told["identify"]), told["validate"][0], lambda x: x))
            diagnosis = diagnose(recording)
            said = score(truth, diagnosis)
            own = diagnosis.explained_fraction
            for name, (share, _) in zip(("SINDy", "SINDy+sign", "physical"), cells, strict=True):
                sums[name].append(share)
            sums["invid"].append(0.0 if own is None else own)
            shown = " ".join(f"{100 * share:6.0f} % ({terms:2d})" for share, terms in cells)
            share = "  –  " if own is None else f"{100 * own:5.1f} %"
            print(f"{cause:<22} {shown}   {share} {said.named} ({said.outcome})", flush=True)
    print("\nmedian  " + ", ".join(f"{name} {100 * np.median(v):.0f} %" for name, v in sums.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
