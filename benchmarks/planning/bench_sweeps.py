"""What each kind of excitation tells in the same robot time under the same limits: expected uncertainty.

    python benchmarks/planning/bench_sweeps.py [--seconds 6] [--seeds N]

Case study with its sensors, holds and friction (and once without friction). Every excitation is played from
rest, fades in and out, and is scaled down until the believed motion keeps to 70 % of the torque limit and to
the window of travel and speed, hold included. What is printed is the Cramér-Rao bound of the whole record
(`invid/planning/expected_covariance.py`, the same for all), so the best that any estimator makes of it: worst
and root mean square of the relative standard deviations of masses, springs and couplings, and the robot time
to the plan's figure, which goes with their square. "As configured" is what `invid measure` plays without
`--goal`, settling and validation included in its time.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.planning.bench_plan import cell, true_belief
from invid.config import CellConfig
from invid.planning import make_plan
from invid.planning.belief import Belief
from invid.planning.expected_covariance import Noise, expected
from invid.planning.goal import plan_for_goal
from invid.planning.model import PlannedExperiment
from invid.planning.response import foretold_motion
from invid.recording.model import Kind
from invid_drivers.foretelling import sensor_noise

LOW, HIGH = 0.5, 12.0
SHARE = 0.7
FADE_S = 0.25


def played(torque: np.ndarray, excited: tuple[int, ...], kind: Kind) -> PlannedExperiment:
    """The excitation as an experiment that is recorded whole."""
    count = torque.shape[0]
    ramp = np.minimum(1.0, np.arange(count) / (1000.0 * FADE_S))
    torque = torque * (ramp * ramp[::-1])[:, None]
    lines = np.array([LOW, HIGH])
    return PlannedExperiment(kind=kind, excited=excited, torque=torque, record_to=count, frequencies_hz=lines)


def within(config: CellConfig, e: PlannedExperiment, belief: Belief) -> PlannedExperiment:
    """The experiment as strong as the limits allow; each axis keeps its share of its torque limit."""
    limits = [a.limits for a in config.axes]
    peak = np.abs(e.torque).max(axis=0)
    full = SHARE * np.array([one.torque for one in limits])
    torque = e.torque * np.where(peak > 0, full / np.maximum(peak, 1e-300), 0.0)
    for _ in range(3):  # friction makes the answer less than proportional
        motion = foretold_motion(config, replace(e, torque=torque), belief)
        ratio = max(
            float((np.abs(motion.torque).max(axis=0) / full).max()),
            float(
                (np.abs(motion.position).max(axis=0) / (0.95 * np.array([x.position for x in limits]))).max()
            ),
            float(
                (np.abs(motion.velocity).max(axis=0) / (0.95 * np.array([x.velocity for x in limits]))).max()
            ),
        )
        torque = torque / max(ratio, 1e-3)
    return replace(e, torque=torque)


def chirp(count: int, logarithmic: bool, *, down: bool = False) -> np.ndarray:
    """A sine whose frequency goes through the band once."""
    share = np.arange(count) / count
    hz = LOW * (HIGH / LOW) ** share if logarithmic else LOW + (HIGH - LOW) * share
    wave = np.sin(2 * np.pi * np.cumsum(hz) / 1000.0)
    return wave[::-1] if down else wave


def stepped(count: int, natural: np.ndarray) -> np.ndarray:
    """An expert's stepped sine: the band's ends and two frequencies about every resonance, as long each."""
    hz = np.unique(np.clip(np.concatenate(([LOW, HIGH], 0.97 * natural, 1.03 * natural)), LOW, HIGH))
    each = np.array_split(np.arange(count), hz.size)
    return np.sin(
        2
        * np.pi
        * np.cumsum(np.concatenate([np.full(k.size, f) for k, f in zip(each, hz, strict=True)]))
        / 1000.0
    )


def one_by_one(wave: Callable[[int], np.ndarray], count: int, kind: Kind) -> list[PlannedExperiment]:
    """The three axes one after the other, each for a third of the time."""
    out = []
    for axis in range(3):
        torque = np.zeros((count // 3, 3))
        torque[:, axis] = wave(count // 3)
        out.append(played(torque, (axis,), kind))
    return out


def together(waves: list[np.ndarray], kind: Kind) -> list[PlannedExperiment]:
    """All axes at once."""
    return [played(np.stack(waves, axis=1), (0, 1, 2), kind)]


def rows(
    config: CellConfig, belief: Belief, noise: Noise, seconds: float, seed: int
) -> dict[str, tuple[float, float]]:
    """Worst and rms relative standard deviation of every excitation."""
    count = round(1000 * seconds)
    chains = belief.chains
    natural = np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(chains.mass_matrix, chains.stiffness_matrix))))
    natural = np.sort(natural)[3:] / 2 / np.pi
    third = count // 3
    shifts = [np.roll(chirp(count, True), -k * third) for k in range(3)]
    plans = {
        name: list(
            plan_for_goal(config, known, noise, 5e-4, seed=seed, max_duration_s=seconds + 2).plan.experiments[
                :1
            ]
        )
        for name, known in (
            ("the plan's multisine, designed", belief),
            ("multisine, amplitude ∝ f^-1/2", replace(belief, guessed=True)),
        )
    }
    plans |= {
        "linear chirps, one axis at a time": one_by_one(lambda n: chirp(n, False), count, Kind.CHIRP),
        "logarithmic chirps, one at a time": one_by_one(lambda n: chirp(n, True), count, Kind.CHIRP),
        "linear chirps, all at once": together(
            [chirp(count, False), chirp(count, False, down=True), np.roll(chirp(count, False), count // 2)],
            Kind.CHIRP,
        ),
        "logarithmic chirps, all at once": together(shifts, Kind.CHIRP),
        "stepped sine by an expert": one_by_one(lambda n: stepped(n, natural), count, Kind.STEPPED_SINE),
    }
    out = {}
    usual = make_plan(config)
    found = expected(config, usual, belief, noise)
    relative, time = found.relative[found.goal], sum(e.cycles for e in usual.experiments) / count
    out["multisines as configured, settled"] = (
        float(np.max(relative)) * np.sqrt(time),
        float(np.sqrt(np.mean(relative**2) * time)),
    )
    for name, blocks in plans.items():
        found = expected(config, [within(config, e, belief) for e in blocks], belief, noise)
        relative = found.relative[found.goal]
        time = sum(e.cycles for e in blocks) / count
        out[name] = (float(np.max(relative)) * np.sqrt(time), float(np.sqrt(np.mean(relative**2) * time)))
    return out


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--seeds", type=int, default=3)
    options, _ = parser.parse_known_args()
    config = cell(0)
    noise = sensor_noise(config)
    belief = true_belief(config)
    still = replace(belief, coulomb=np.zeros(3), viscous=np.zeros(3))
    for title, known in (("with friction of the cell", belief), ("without friction", still)):
        tables = [rows(config, known, noise, options.seconds, seed + 1) for seed in range(options.seeds)]
        print(f"\n{title}, {options.seconds:g} s of shaking: expected relative standard deviation")
        print(f"{'':<36}{'worst':>9}{'rms':>9}{'robot time to the plan’s worst, rms':>38}")
        base = np.median([t["the plan's multisine, designed"] for t in tables], axis=0)
        for name in tables[0]:
            worst, mean = np.median([t[name] for t in tables], axis=0)
            ratio = f"{(worst / base[0]) ** 2:.2f}, {(mean / base[1]) ** 2:.2f}"
            print(f"{name:<36}{100 * worst:8.3f}%{100 * mean:8.3f}%{ratio:>38}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
