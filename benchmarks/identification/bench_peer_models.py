"""The parameters that other ways of fitting give, on the same records: FRF error, parameter error, time.

    python benchmarks/identification/bench_peer_models.py [--seeds N] [--first S] [--periods P]
                                                          [--peers NAME …]

Case study of the paper without friction, all three axes shaken at once in three experiments, white noise
(torque 0.5 % of peak, position 1 µrad), steady state. Everybody gets the same spectra, the torque when it
acts (half a sample later than recorded), and the number of masses. FRF error: median over 0.3 to 13 Hz of
|G − G_true| / |G_true| (Frobenius). Parameter error: median and largest over 18 masses, springs, couplings.

refined    invid identify
paper      invid identify --method paper: the paper's inverse on resonances measured near the fit
subspace   a black-box state space of the true order by frequency-domain subspace identification (McKelvey,
           Akçay, Ljung 1996) on the FRF matrix, weighted by its noise: no parameters
raw        the FRF matrix as measured, for scale
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.identification.bench_identify import RATE, estimate, measure, truth
from benchmarks.shared import plant_oracle as oracle
from invid.errors import InvidError
from invid.identification.identify import identify
from invid.model.forward import frf as chain_frf
from invid.recording.model import Recording
from invid.signals.frf import FrfMatrix, frf_matrix
from invid.signals.record import make_record

SIZES = (3, 3, 3)
HZ = np.arange(3, 130) * 0.1
PEAK = np.array([20.0, 40.0, 60.0])
Answer = tuple[np.ndarray, np.ndarray | None]
"""G on the lines, and the parameters in the order of ``truth``."""


def by_invid(method: str) -> Callable[[Recording, np.ndarray], Answer]:
    def run(recording: Recording, hz: np.ndarray) -> Answer:
        model = identify(recording, masses=SIZES, method="paper" if method == "paper" else "refined")
        return np.asarray(chain_frf(model.chains, 2 * np.pi * hz)), estimate(model)[0]

    return run


def measured_frf(recording: Recording) -> FrfMatrix:
    """As measured, by the torque when it acts."""
    found = frf_matrix([make_record(e, recording.encoder_resolution) for e in recording.experiments])
    return replace(found, frf=found.frf * np.exp(1j * np.pi * found.frequency_hz / RATE)[:, None, None])


def by_subspace(recording: Recording, hz: np.ndarray, *, blocks: int = 20) -> Answer:
    """Subspace identification on the lines (McKelvey, Akçay, Ljung 1996, non-uniform lines), true order.

    On the acceleration, whose order is that of the elastic modes alone, weighted by its noise; continuous
    time by the bilinear map. A fifth of the error that MOESP on decimated samples had.
    """
    measured = measured_frf(recording)
    order, motors = 2 * (sum(SIZES) - len(SIZES)), len(SIZES)
    omega = 2 * np.pi * measured.frequency_hz
    corner = 0.6 * omega[-1]
    z = (1 + 1j * omega / corner) / (1 - 1j * omega / corner)
    acceleration = -(omega**2)[:, None, None] * measured.frf
    weight = 1.0 / np.sqrt((omega**4)[:, None, None] * measured.variance).mean(axis=(1, 2))
    weight /= weight.mean()
    size = np.sqrt(np.diag(np.sqrt(np.mean(np.abs(acceleration) ** 2, axis=0))))
    scaled = acceleration / size[:, None] / size

    def stacked(values: np.ndarray) -> np.ndarray:
        """(blocks·M, 2·F·M) of the values times 1, z, z², … beside each other, weighted."""
        powers = z ** np.arange(blocks)[:, None] * weight
        out = np.einsum("qf,fij->qifj", powers, values).reshape(blocks * motors, -1)
        return np.concatenate((out.real, out.imag), axis=1)

    unit = np.broadcast_to(np.eye(motors), scaled.shape)
    triangle = np.linalg.qr(np.concatenate((stacked(unit), stacked(scaled))).T, mode="r").T
    rows = blocks * motors
    left, _, _ = np.linalg.svd(triangle[rows:, rows:], full_matrices=False)
    observability = left[:, :order]
    c = observability[:motors]
    a = np.linalg.lstsq(observability[:-motors], observability[motors:], rcond=None)[0]

    def gain(at: np.ndarray) -> np.ndarray:
        return c @ np.linalg.inv(at[:, None, None] * np.eye(order) - a)

    matrix = (np.concatenate((gain(z), unit), axis=2) * weight[:, None, None]).reshape(-1, order + motors)
    target = (scaled * weight[:, None, None]).reshape(-1, motors)
    x = np.linalg.lstsq(
        np.concatenate((matrix.real, matrix.imag)), np.concatenate((target.real, target.imag)), rcond=None
    )[0]
    at = 2 * np.pi * hz
    g = gain((1 + 1j * at / corner) / (1 - 1j * at / corner)) @ x[:order] + x[order:]
    return g * size[:, None] * size / -(at**2)[:, None, None], None


def raw(recording: Recording, hz: np.ndarray) -> Answer:
    """What everybody starts from."""
    measured = measured_frf(recording)
    return measured.frf[np.abs(measured.frequency_hz[:, None] - hz).argmin(axis=0)], None


PEERS: dict[str, Callable[[Recording, np.ndarray], Answer]] = {
    "refined": by_invid("refined"),
    "paper": by_invid("paper"),
    "subspace": by_subspace,
    "raw": raw,
}


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", "--draws", type=int, default=5)
    parser.add_argument("--first", "--seed0", type=int, default=0)
    parser.add_argument("--periods", type=int, default=3)
    parser.add_argument("--peers", nargs="+", choices=list(PEERS), default=list(PEERS))
    arguments, _ = parser.parse_known_args()
    plant = oracle.case_study()
    rows: dict[str, list[tuple[float, float, float, float]]] = defaultdict(list)
    failed: dict[str, list[str]] = defaultdict(list)
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        recording = measure(
            plant, np.random.default_rng(seed), period=10_000, periods=arguments.periods, settle=3,
            band=(0.3, 13.0), peak=PEAK,
        )  # fmt: skip
        for name in dict.fromkeys(("refined", *arguments.peers)):
            started = time.process_time()
            try:
                g, values = PEERS[name](recording, HZ)
            except (InvidError, ValueError, np.linalg.LinAlgError) as error:
                failed[name].append(f"seed {seed}: {str(error)[:90]}")
                continue
            off = float(
                np.median(
                    np.linalg.norm(g - plant.frf(HZ), axis=(1, 2))
                    / np.linalg.norm(plant.frf(HZ), axis=(1, 2))
                )
            )
            wrong = np.full(1, np.nan) if values is None else np.abs(values / truth(plant) - 1.0)
            rows[name].append(
                (off, float(np.median(wrong)), float(np.max(wrong)), time.process_time() - started)
            )
    print(f"{'':<14}{'FRF error':>12}{'parameters':>12}{'worst':>12}{'CPU s':>8}   (medians)")
    for name in PEERS:
        if rows[name]:
            off, middle, worst, took = np.median(np.array(rows[name]), axis=0)
            shown = [f"{100 * v:.3g} %" if np.isfinite(v) else "none" for v in (off, middle, worst)]
            print(f"{name:<14}{shown[0]:>12}{shown[1]:>12}{shown[2]:>12}{took:8.2f}")
        for text in dict.fromkeys(failed[name]):
            print(f"{name:<14}{text}")
    best = np.median(np.array(rows["refined"]), axis=0)
    others = {n: np.median(np.array(rows[n]), axis=0) for n in PEERS if n != "refined" and rows[n]}
    better = [n for n, row in others.items() if row[2] < best[2]]
    print("better than refined in the worst parameter: " + (", ".join(better) or "none"))
    print("faster than refined: " + (", ".join(n for n, r in others.items() if r[3] < best[3]) or "none"))
    return 1 if better else 0


if __name__ == "__main__":
    sys.exit(main())
