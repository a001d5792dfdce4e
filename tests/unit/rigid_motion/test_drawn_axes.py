"""Axes drawn at random behind a loop that differentiates its encoder, judged on the truth they were given.

The axis is integrated by Heun's rule and its dry friction by the impulse that stops it, in steps of a
twentieth of a sample; the product knows neither.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from large_motion import experiment, recording

from invid.diagnosis.rigid import diagnose_trajectory
from invid.identification.machine_kind import rigid_missed_share
from invid.model.diagnosis_document import Diagnosis, Verdict
from invid.recording import Experiment, Kind, Role
from invid.rigid_motion.analysis import analyse
from invid.rigid_motion.record_kind import is_trajectory, reversal_rate

RATE, SUB, COUNT, NOISE = 250.0, 20, 2 * np.pi / 2**20, 0.01


@dataclass
class Axis:
    """One axis; friction opposes the motion, (forward, backward)."""

    mass: float
    dry: tuple[float, float] = (0.0, 0.0)
    wet: tuple[float, float] = (0.0, 0.0)
    static: float = 0.0
    slow: float = 1.0
    drag: float = 0.0
    seen: list[Experiment] = field(default_factory=list)

    def record(
        self, rng: np.random.Generator, reference: np.ndarray, role: Role = Role.IDENTIFY, kind=Kind.OTHER
    ) -> None:
        """Add an experiment along a reference (n,) [rad]."""
        dt = 1.0 / (RATE * SUB)
        stiff, damp = self.mass * (2 * np.pi * 6.0) ** 2, self.mass * 2 * 0.7 * 2 * np.pi * 6.0
        q, v, last, before = float(reference[0]), 0.0, None, float(reference[0])
        rows = np.zeros((reference.size, 2))
        for k, wanted in enumerate(reference):
            read = round(q / COUNT) * COUNT
            rate = 0.0 if last is None else (read - last) * RATE
            command = stiff * (wanted - read) + damp * ((wanted - before) * RATE - rate)
            rows[k] = read, command
            last, before = read, wanted
            for _ in range(SUB):
                first = (command - self.smooth(v)) / self.mass
                second = (command - self.smooth(v + dt * first)) / self.mass
                free = v + 0.5 * dt * (first + second)
                dry = self.dry[0] if free > 0 else self.dry[1]
                if self.static:
                    dry += (self.static - dry) * math.exp(-((free / self.slow) ** 2))
                brake = dt * dry / self.mass
                w = 0.0 if abs(free) <= brake else free - math.copysign(brake, free)
                q += 0.5 * dt * (v + w)
                v = w
        time = (np.arange(reference.size) + sum(e.samples for e in self.seen)) / RATE
        torque = rows[:, 1] + NOISE * rng.standard_normal(reference.size)
        key = f"{len(self.seen):03d}"
        self.seen.append(experiment(time, rows[:, :1], torque[:, None], kind, key, role))

    def smooth(self, v: float) -> float:
        """What resists beside dry friction; the drag grows with the square of the speed."""
        return (self.wet[0] if v > 0 else self.wet[1]) * v + self.drag * v * abs(v)

    def diagnosis(self) -> Diagnosis:
        return diagnose_trajectory(recording(*self.seen))


def wander(rng: np.random.Generator, seconds: float = 25.0, span: float = 1.5) -> np.ndarray:
    """A smooth motion of five drawn tones that begins and ends at rest."""
    t = np.arange(int(seconds * RATE)) / RATE
    path = np.zeros(t.size)
    for _ in range(5):
        f = rng.uniform(0.05, 0.5)
        path += rng.uniform(0.4, 1) * np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi)) / (1 + f / 0.3)
    path *= 0.5 - 0.5 * np.cos(np.pi * np.clip(np.minimum(t, t[-1] - t) / 1.5, 0, 1))
    return span * path / np.abs(path).max()


def steady(speed: float, seconds: float = 4.0, turns: int = 0) -> np.ndarray:
    """One speed with run-in and run-out, turned round ``turns`` times on the way."""
    n = int(seconds * RATE)
    way = np.where((np.arange(n) * (turns + 1) // n) % 2 == 0, speed, -speed)
    smooth = np.hanning(40)
    return np.cumsum(np.convolve(way, smooth / smooth.sum(), "same")) / RATE


def found(diagnosis: Diagnosis) -> dict[str, dict[str, tuple[float, float]]]:
    return {
        f.effect.cause: {n: (p.value, p.std or np.nan) for n, p in f.effect.parameters.items()}
        for f in diagnosis.findings
    }


def of_torque(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


@pytest.mark.campaign
def test_sizes_lie_within_their_standard_deviations_and_the_rest_at_the_floor():
    distance, floors = [], []
    for seed in range(6):
        rng = np.random.default_rng(7100 + seed)
        dry, wet = of_torque(rng, 0.5, 3.0), of_torque(rng, 0.5, 3.0)
        axis = Axis(of_torque(rng, 0.4, 3.0), (dry, dry), (wet, wet))
        for role in (Role.IDENTIFY, Role.IDENTIFY, Role.VALIDATE):
            axis.record(rng, wander(rng), role)
        diagnosis = axis.diagnosis()
        assert diagnosis.verdict is Verdict.EXPLAINED, (seed, diagnosis.sentences)
        causes = found(diagnosis)
        assert set(causes) == {"coulomb_friction", "viscous_friction"}
        model = diagnosis.model
        for (value, std), truth in (
            (causes["coulomb_friction"]["torque"], dry),
            (causes["viscous_friction"]["coefficient"], wet),
            ((model.chains.masses[0][0], model.std.masses[0][0]), axis.mass),
        ):
            assert value == pytest.approx(truth, rel=2e-3)
            distance.append((value - truth) / std)
        floors.append(diagnosis.residual[0].after / diagnosis.residual[0].noise_floor)
    assert np.sqrt(np.mean(np.square(distance))) < 2.0, distance
    assert np.abs(distance).max() < 4.5, distance
    # Torque that answers the counts of the encoder is no noise: floors were three to twenty times too high.
    assert 0.85 < np.mean(floors) < 1.15, floors


@pytest.mark.campaign
def test_a_drag_with_the_square_of_the_speed_is_a_law_without_a_name():
    laws = 0
    for seed in range(5):
        rng = np.random.default_rng(7250 + seed)
        axis = Axis(of_torque(rng, 0.5, 2.0), drag=of_torque(rng, 0.5, 2.0))
        for role in (Role.IDENTIFY, Role.IDENTIFY, Role.VALIDATE):
            axis.record(rng, wander(rng), role)
        diagnosis = axis.diagnosis()
        assert diagnosis.verdict in (Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED), (
            seed,
            diagnosis.sentences,
        )
        assert "velocity-dependent" in diagnosis.unexplained.character
        for law in diagnosis.findings:
            laws += 1
            assert (law.cause, law.effect.table.over) == ("empirical_law", "velocity")
            at, value = (np.array(v) for v in (law.effect.table.at, law.effect.table.value))
            drag = axis.drag * at * np.abs(at)
            assert value == pytest.approx(drag, abs=0.1 * np.abs(drag).max())
    assert laws >= 4  # where validation is faster than what was fitted, no law need hold


@pytest.mark.campaign
@pytest.mark.parametrize("turns", [0, 1, 4], ids=["one way", "forth and back", "several times"])
@pytest.mark.parametrize("kept_out", [0, 2], ids=["all identify", "two validate"])
def test_constant_speeds_show_friction_however_they_are_cut_into_records(turns: int, kept_out: int):
    rng = np.random.default_rng(7400 + 10 * turns + kept_out)
    dry, wet = of_torque(rng, 0.5, 3.0), of_torque(rng, 0.5, 3.0)
    axis = Axis(of_torque(rng, 0.5, 2.0), (dry, dry), (wet, wet))
    speeds = np.geomspace(0.2, 1.5, 14 if turns == 0 else 6)
    for k, speed in enumerate(rng.permutation(speeds)):
        role = Role.VALIDATE if 2 <= k < 2 + kept_out else Role.IDENTIFY
        way = 1 if k % 2 else -1
        axis.record(rng, steady(way * speed, 4.0 + 3.0 * turns, turns), role, Kind.CONSTANT_VELOCITY)
    diagnosis = axis.diagnosis()
    causes = found(diagnosis)
    assert {"coulomb_friction", "viscous_friction"} == set(causes), diagnosis.sentences
    assert causes["coulomb_friction"]["torque"][0] == pytest.approx(dry, rel=5e-3)
    assert causes["viscous_friction"]["coefficient"][0] == pytest.approx(wet, rel=5e-3)
    assert diagnosis.explained_fraction > 0.99


def arm(rng: np.random.Generator, seconds: float = 15.0, pace: float = 1.0) -> list[Experiment]:
    """Three motions of two drawn links that fall and rub: the torque that each motion asks for.

    Every record moves the joints by amounts of its own.
    """
    m1, m2, b = rng.uniform(0.5, 1.0), rng.uniform(0.3, 0.6), rng.uniform(0.1, 0.2)
    w1, w2 = rng.uniform(3, 6), rng.uniform(1, 2)
    dry = rng.uniform(0.3, 0.6, 2)
    records = []
    for k, spans in enumerate(([0.4, 2.5], [1.5, 0.6], [2.5, 0.4])):
        t = np.arange(int(seconds * RATE)) / RATE
        q, v, a = np.zeros((3, t.size, 2))
        for i in (0, 1):
            for _ in range(4):
                w, phase = 2 * np.pi * pace * rng.uniform(0.2, 0.8), rng.uniform(0, 2 * np.pi)
                size = spans[i] * rng.uniform(0.3, 0.6)
                q[:, i] += size * np.sin(w * t + phase)
                v[:, i] += size * w * np.cos(w * t + phase)
                a[:, i] -= size * w**2 * np.sin(w * t + phase)
        c, s = b * np.cos(q[:, 1]), b * np.sin(q[:, 1])
        torque = np.empty_like(q)
        torque[:, 0] = (m1 + 2 * c) * a[:, 0] + (m2 + c) * a[:, 1] - s * (2 * v[:, 0] + v[:, 1]) * v[:, 1]
        torque[:, 1] = (m2 + c) * a[:, 0] + m2 * a[:, 1] + s * v[:, 0] ** 2
        torque[:, 0] += w1 * np.sin(q[:, 0])
        torque += (w2 * np.sin(q[:, 0] + q[:, 1]))[:, None] + dry * np.sign(v)
        # As on a real arm something small is left that no cause has: here what depends on time.
        torque += 0.01 * torque.std(axis=0) * np.sin(2 * np.pi * 0.31 * t + k)[:, None]
        q = np.round(q / COUNT) * COUNT
        records.append(experiment(t, q, torque + NOISE * rng.standard_normal(q.shape), key=f"{k:03d}"))
    return records


def test_an_arm_that_is_stated_to_be_one_mass_a_joint_is_rigid_however_fast_it_swings():
    data = recording(*arm(np.random.default_rng(7501), pace=3.6))
    assert reversal_rate(data) > 5.0
    stated = replace(data, masses_per_axis=(1, 1))
    assert is_trajectory(stated)
    assert rigid_missed_share(analyse(stated)) < 0.02
