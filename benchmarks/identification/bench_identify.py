"""Identification beside its statistical limit and beside other ways of fitting, on the same records.

    python benchmarks/identification/bench_identify.py [--draws 100] [--seed0 0] [--peers 5]

Case study of the paper without friction, all three axes shaken at once in three experiments, white noise
(torque 0.5 % of peak, position 1 µrad), steady state, simulated by code that the product does not use. First
error / Cramér-Rao bound and coverage of ±1σ and ±2σ, each beside its bar; exit status 1 where one is missed.

Then, on the first ``--peers`` records, other ways of fitting. Everybody gets the same spectra, the torque
when it acts (half a sample later than recorded), and the number of masses. FRF error: median over 0.3 to
13 Hz of |G − G_true| / |G_true| (Frobenius). Parameter error: median and largest over 18 masses, springs,
couplings.

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
from dataclasses import replace

import numpy as np

from benchmarks.shared import plant_oracle as oracle
from invid.errors import InvidError
from invid.identification.fitted_model import chains_covariance
from invid.identification.identify import identify
from invid.identification.kept_out import all_records
from invid.identification.open_holds import open_masses
from invid.identification.search_start import settled_about
from invid.likelihood.unknown_forces.descent import fit
from invid.model.chains import CoupledChains
from invid.model.document import Model, parameter_vector
from invid.model.forward import frf as chain_frf
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.signals.frf import FrfMatrix, frf_matrix
from invid.signals.record import make_record

RATE, PERIOD, SETTLE = 1000.0, 10_000, 3
"""Samples a second and a period, and periods that are left to settle."""
NOISE, POSITION_NOISE = 0.005, 1e-6
"""White noise of the torque over its peak, and of the position [rad]."""
SIZES = (3, 3, 3)
HZ = np.arange(3, 130) * 0.1
PEAK = np.array([20.0, 40.0, 60.0])
PEERS = ("refined", "paper", "subspace", "raw")
Answer = tuple[np.ndarray, np.ndarray | None]
"""G on the lines, and the parameters in the order of ``truth``."""


def measured(
    plant: oracle.OraclePlant,
    rng: np.random.Generator,
    peak: np.ndarray,
    *,
    periods: int = 3,
    top_hz: float = 13.0,
) -> Recording:
    """M experiments with all axes excited at once, P·D held by the master at the sample rate."""
    count = len(plant.masses)
    sums = np.array([sum(m) for m in plant.masses])
    gain = 20.0 * sums
    experiments = []
    for number in range(count):
        demand = np.zeros((PERIOD * (SETTLE + periods), count))
        for i in range(count):
            wave, hz = oracle.multisine(rng, PERIOD, RATE, (0.3, top_hz), odd=False)
            demand[:, i] = peak[i] * np.tile(wave, SETTLE + periods)
        damping = np.sqrt(gain * sums)
        position, torque = (
            x[SETTLE * PERIOD :]
            for x in oracle.simulate(plant, demand, RATE, gain=gain, damping=damping, in_drive=False)
        )
        position = position + POSITION_NOISE * rng.standard_normal(position.shape)
        torque = torque + NOISE * peak * rng.standard_normal(torque.shape)
        experiments.append(
            Experiment(
                f"{number:03d}", Kind.MULTISINE, Role.IDENTIFY, -1, gain, PERIOD, hz, RATE,
                np.arange(position.shape[0]) / RATE, position, torque,
            )
        )  # fmt: skip
    axes = tuple(f"A{i + 1}" for i in range(count))
    return Recording("bench", axes, "rad", "N·m", "2026-11-21T00:00:00Z", tuple(experiments))


def truth(plant: oracle.OraclePlant) -> np.ndarray:
    """Masses, springs, couplings."""
    count = len(plant.masses)
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count)]
    return np.array(
        [m for b in plant.masses for m in b]
        + [k for b in plant.springs for k in b]
        + [plant.couplings.get(p, 0.0) for p in pairs]
    )


def estimate(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard deviations in the order of ``truth``."""
    c, s = model.chains, model.std
    upper = np.triu_indices(c.branches, 1)
    return (
        np.concatenate([*c.masses, *c.springs, c.couplings[upper]]),
        np.concatenate([*s.masses, *s.springs, s.couplings[upper]]),
    )


def bound(plant: oracle.OraclePlant, recording: Recording) -> np.ndarray:
    """Cramér-Rao standard deviations: true plant, true white noise and no unknown force, timing and
    friction unknown."""
    records = []
    for r in all_records(recording):
        share = 4.0 * r.step / r.span
        level = share * np.full(PEAK.size, POSITION_NOISE) ** 2, share * (NOISE * PEAK) ** 2
        records.append(replace(r, position_noise=level[0], torque_noise=level[1]))
    couplings = np.zeros((PEAK.size, PEAK.size))
    for (i, j), value in plant.couplings.items():
        couplings[i, j] = couplings[j, i] = value
    chains = CoupledChains.build(plant.masses, plant.springs, plant.dampers, couplings, axes=recording.axes)
    end = settled_about(chains, records)
    problem, numbers = end.fit.problem, end.numbers
    alone = replace(numbers, strength=np.full_like(numbers.strength, problem.least))
    end = replace(end, fit=fit(problem, alone, 0))
    settled, covariance = chains_covariance(end, recording.axes, open_masses(end))
    deviation = dict(zip(parameter_vector(settled)[0], np.sqrt(np.diag(covariance)), strict=True))
    ordered = [n for kind in (".mass.", ".spring.", ".coupling") for n in deviation if kind in n]
    return np.array([deviation[n] for n in ordered])


def covered(z: np.ndarray, e: np.ndarray) -> bool:
    """Coverage of the stated standard deviations and error over the bound, beside their bars."""
    one, two = float(np.mean(np.abs(z) < 1)), float(np.mean(np.abs(z) < 2))
    slack = 3 * np.sqrt(0.22 / z.size)  # three standard deviations of a share of 0.68 of z.size
    over, bar = float(np.sqrt(np.mean(e**2))), 3 / np.sqrt(2 * e.size)
    print(
        f"white: {z.shape[0]} seeds: error/CRB {over:.3f} (bar 1.1 ± {bar:.2f}), ±1σ {one:.3f} (0.63–0.73 ± "
        f"{slack:.2f}), ±2σ {two:.3f} (0.92–0.98 ± {slack / 2:.2f}), z rms {np.sqrt(np.mean(z**2)):.2f}"
    )
    inside = 0.63 - slack < one < 0.73 + slack and 0.92 - slack / 2 < two < 0.98 + slack / 2
    return over < 1.1 + bar and inside


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


def answer(peer: str, recording: Recording, refined: Model) -> Answer:
    """What one way of fitting says; ``refined`` is that of the product, fitted already."""
    if peer == "subspace":
        return by_subspace(recording, HZ)
    if peer == "raw":
        found = measured_frf(recording)
        return found.frf[np.abs(found.frequency_hz[:, None] - HZ).argmin(axis=0)], None
    model = refined if peer == "refined" else identify(recording, masses=SIZES, method="paper")
    return np.asarray(chain_frf(model.chains, 2 * np.pi * HZ)), estimate(model)[0]


def main() -> int:
    """Print the figures and the table of peers."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", "--seeds", type=int, default=100)
    parser.add_argument("--seed0", "--first", type=int, default=0)
    parser.add_argument("--peers", type=int, default=5, help="records on which the others fit as well")
    given, _ = parser.parse_known_args()
    plant = oracle.case_study()
    real, exact = plant.frf(HZ), truth(plant)
    errors, deviations, ratios = [], [], []
    rows: dict[str, list[tuple[float, float, float, float]]] = defaultdict(list)
    for n in range(given.draws):
        recording = measured(plant, np.random.default_rng(given.seed0 + n), PEAK)
        started = time.process_time()
        refined = identify(recording, masses=SIZES)
        spent = time.process_time() - started
        limit, (values, std) = bound(plant, recording), estimate(refined)
        errors.append((values - exact) / limit)
        deviations.append((values - exact) / std)
        ratios.append(np.median(std / limit))
        for peer in PEERS if n < given.peers else ():
            started = time.process_time()
            try:
                g, fitted = answer(peer, recording, refined)
            except (InvidError, ValueError, np.linalg.LinAlgError) as error:
                print(f"{peer}: seed {given.seed0 + n}: {str(error)[:90]}")
                continue
            took = time.process_time() - started + spent * (peer == "refined")
            off = np.linalg.norm(g - real, axis=(1, 2)) / np.linalg.norm(real, axis=(1, 2))
            wrong = np.full(1, np.nan) if fitted is None else np.abs(fitted / exact - 1.0)
            rows[peer].append((float(np.median(off)), float(np.median(wrong)), float(np.max(wrong)), took))
    print(f"white: stated/CRB {np.median(ratios):.3f}")
    met = covered(np.array(deviations), np.array(errors))
    print("all bars met" if met else "a bar is missed")
    print(f"{'':<14}{'FRF error':>12}{'parameters':>12}{'worst':>12}{'CPU s':>8}   (medians)")
    for peer, each in rows.items():
        *shares, took = np.median(np.array(each), axis=0)
        shown = [f"{100 * v:.3g} %" if np.isfinite(v) else "none" for v in shares]
        print(f"{peer:<14}" + "".join(f"{word:>12}" for word in shown) + f"{took:8.2f}")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
