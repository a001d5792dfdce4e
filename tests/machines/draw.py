"""One machine drawn from a seed: its motion as a logger would have it, and what is true of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from machines import integrate as law
from machines.motion import KINDS, band_noise

RATES = (100, 200, 400, 500, 1000, 2000)
SCENARIOS = (
    "nothing", "viscous", "dry", "dry and wet", "dry, wet, offset", "stribeck", "asymmetric",
    "gravity and dry", "gravity, dry, wet", "loaded", "drag", "ripple", "hum",
)  # fmt: skip
OUTSIDE = {"drag", "ripple", "hum"}
"""Mechanisms that no cause for large motions describes, or that a slow encoder may not show."""


@dataclass
class Machine:
    """Signals in SI at the samples, and the truth: axis → cause → parameters."""

    family: str
    scenario: str
    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray
    linear: bool = False
    velocity_only: bool = False
    truth: list[dict[str, dict[str, float]]] = field(default_factory=list)
    base: dict[str, float] = field(default_factory=dict)
    outside: bool = False
    split: bool = False
    """Whether the last third is named as validation data."""
    facts: dict[str, Any] = field(default_factory=dict)


def draw(seed: int, family: str | None = None) -> Machine:
    """The machine of ``seed``; families: axis, arm, spring, flexible."""
    rng = np.random.default_rng([seed, 77])
    family = family or str(rng.choice(["axis", "axis", "axis", "arm", "spring", "flexible"]))
    machine = {"axis": _axis, "arm": _arm, "spring": _spring, "flexible": _flexible}[family](rng)
    machine.split = bool(rng.random() < 0.4)
    return machine


def _measured(
    rng: np.random.Generator, position: np.ndarray, torque: np.ndarray, travel: float, facts: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Encoder counts and torque noise."""
    bits = int(rng.integers(12, 21))
    noise = float(np.exp(rng.uniform(np.log(0.005), np.log(0.1))))
    facts.update(bits=bits, noise=round(noise, 4))
    count = travel / 2**bits
    rough = noise * torque.std(axis=0) * rng.standard_normal(torque.shape)
    return np.round(position / count) * count, torque + rough


def _axis(rng: np.random.Generator) -> Machine:
    rate = float(rng.choice(RATES))
    sub = max(4, int(np.ceil(10_000 / rate)))
    dt, seconds = 1 / rate / sub, float(rng.uniform(12, 30))
    scenario = str(rng.choice(SCENARIOS))
    gravity = scenario in ("gravity and dry", "gravity, dry, wet", "loaded")
    linear = bool(rng.random() < 0.3) and not gravity
    stroke = float(np.exp(rng.uniform(np.log(0.4), np.log(4.0)))) * (0.2 if linear else 1.0)
    motion = str(rng.choice(list(KINDS)))
    reference = KINDS[motion](rng, seconds, dt, stroke)
    if gravity:
        reference = reference + rng.uniform(-1.0, 1.0)
    speed = np.gradient(reference, dt)
    mass = float(np.exp(rng.uniform(np.log(1e-3), np.log(1e2))))
    fast = float(np.sqrt(np.mean(speed**2)))
    size = mass * float(np.std(np.gradient(speed, dt)))
    x = size * float(np.exp(rng.uniform(np.log(0.15), np.log(1.5))))
    own = 2 * np.pi * float(rng.uniform(3, min(15, rate / 25)))
    row, truth = np.zeros(law.LAW), {}

    def dry(up: float, down: float) -> None:
        row[law.UP], row[law.DOWN] = up, down

    def wet(up: float, down: float) -> None:
        row[law.WET_UP], row[law.WET_DOWN] = up / fast, down / fast

    def say(cause: str, **parameters: float) -> None:
        truth[cause] = parameters

    y = x * float(rng.uniform(0.4, 1.2))
    if scenario in ("dry", "dry and wet", "dry, wet, offset", "gravity and dry", "gravity, dry, wet"):
        dry(x, x)
        say("coulomb_friction", torque=x)
    if scenario in ("viscous", "dry and wet", "dry, wet, offset", "gravity, dry, wet", "stribeck"):
        wet(y, y)
        say("viscous_friction", coefficient=y / fast)
    if scenario == "dry, wet, offset":
        row[law.OFFSET] = float(rng.choice([-1, 1])) * 0.6 * x
        say("torque_offset", torque=row[law.OFFSET])
    if scenario == "stribeck":
        dry(x, x)
        row[law.EXCESS], row[law.SLOW] = (
            x * float(rng.uniform(0.4, 1.0)),
            fast * float(rng.uniform(0.05, 0.3)),
        )
        say("stribeck_friction", static=x + row[law.EXCESS], coulomb=x, velocity=row[law.SLOW])
    if scenario == "asymmetric":
        ways = rng.permutation([1.4, 0.7]) * x, rng.permutation([1.3, 0.6]) * y
        dry(*ways[0])
        wet(*ways[1])
        say("asymmetric_friction", coulomb_positive=row[law.UP], coulomb_negative=row[law.DOWN],
            viscous_positive=row[law.WET_UP], viscous_negative=row[law.WET_DOWN])  # fmt: skip
    if gravity:
        angle, weight = float(rng.uniform(-3, 3)), x * float(rng.uniform(1.0, 4.0))
        row[law.SINE], row[law.COSINE] = weight * np.cos(angle), weight * np.sin(angle)
        say("gravity", torque=weight, angle=angle)
        if scenario == "loaded":
            row[law.LOADED] = float(rng.uniform(0.1, 0.3))
            dry(0.1 * weight, 0.1 * weight)
            say("coulomb_friction", torque=0.1 * weight)
            say("load_dependent_friction", coefficient=row[law.LOADED])
    if scenario == "drag":
        row[law.DRAG] = x / fast**2
    if scenario == "ripple":
        row[law.RIPPLE], row[law.CYCLES] = x, float(rng.uniform(15, 40)) / stroke
        if not linear:
            say("cogging", torque=x, cycles_per_rev=row[law.CYCLES])
    if scenario == "hum":
        row[law.HUM], row[law.HUM_HZ] = x, float(rng.uniform(1, 5))
    command = np.zeros(reference.size // sub)
    rows = law.one_axis(
        reference, speed, command, sub, dt, mass, mass * own**2, 1.4 * mass * own, np.inf, row
    )  # fmt: skip
    travel = 2 * np.pi if not linear else 4 * stroke
    facts: dict[str, Any] = {"motion": motion, "rate": rate, "size": round(x / size, 2)}
    position, torque = _measured(rng, rows[:, :1], rows[:, 2:], travel, facts)
    velocity_only = bool(rng.random() < 0.25)
    velocity = rows[:, 1:2]
    if velocity_only:
        step = 10.0 ** np.floor(np.log10(0.003 * fast))
        velocity = np.round((velocity + 0.003 * fast * rng.standard_normal(velocity.shape)) / step) * step
    time = np.arange(rows.shape[0]) / rate
    return Machine(
        "axis", scenario, time, position, velocity, torque, linear, velocity_only, [truth], {"mass": mass},
        scenario in OUTSIDE, facts=facts,
    )  # fmt: skip


def _arm(rng: np.random.Generator) -> Machine:
    rate = float(rng.choice([200, 400, 500, 1000]))
    sub = int(np.ceil(10_000 / rate))
    dt, seconds = 1 / rate / sub, float(rng.uniform(15, 30))
    l1, m1, m2 = rng.uniform(0.2, 0.8), rng.uniform(0.5, 5), rng.uniform(0.3, 3)
    r1, r2 = 0.5 * l1, float(rng.uniform(0.1, 0.5))
    d = m2 * r2**2 * 1.33
    inertia = np.array([m1 * r1**2 * 1.33 + m2 * l1**2 + d, m2 * l1 * r2, d])
    g = 9.81 if rng.random() < 0.7 else 0.0
    gravity = np.array([(m1 * r1 + m2 * l1) * g, m2 * r2 * g])
    motion = str(rng.choice(["trapezoids", "sines"]))
    reference = np.stack([KINDS[motion](rng, seconds, dt, float(rng.uniform(0.7, 2.0))) for _ in range(2)], 1)
    speed = np.gradient(reference, dt, axis=0)
    fast = np.sqrt(np.mean(speed**2, axis=0))
    # What a joint feels where the other is free, at the worst angle: gains for more would not be stable.
    bent = [inertia[0] + 2 * inertia[1] * c for c in (-1.0, 0.0, 1.0)]
    det = [m * d - (d + inertia[1] * c) ** 2 for m, c in zip(bent, (-1.0, 0.0, 1.0), strict=True)]
    felt = np.array([min(det) / d, min(x / m for x, m in zip(det, bent, strict=True))])
    diagonal = np.array([inertia[0], d])
    size = diagonal * np.gradient(speed, dt, axis=0).std(axis=0) + 0.3 * np.abs(gravity)
    dry = size * rng.uniform(0.1, 0.5, 2) * (rng.random(2) < 0.8)
    wet = size * rng.uniform(0.1, 0.5, 2) * (rng.random(2) < 0.5) / fast
    own = 2 * np.pi * rng.uniform(2.0, 5.0, 2)
    rows = law.two_links(
        reference, speed, sub, dt, inertia, gravity, felt * own**2, 1.4 * felt * own, dry, wet
    )
    facts: dict[str, Any] = {"motion": motion, "rate": rate}
    position, torque = _measured(rng, rows[:, :2], rows[:, 4:], 2 * np.pi, facts)
    truth: list[dict[str, dict[str, float]]] = [{}, {}]
    for i in range(2):
        if dry[i]:
            truth[i]["coulomb_friction"] = {"torque": dry[i]}
        if wet[i]:
            truth[i]["viscous_friction"] = {"coefficient": wet[i]}
        if g:
            truth[i]["gravity"] = {"torque": gravity[i], "angle": 0.0}
    base = {"inertia": d, "m11": inertia[0], "coupling": d, "carried": inertia[1]}
    return Machine(
        "arm", "gravity" if g else "level", np.arange(rows.shape[0]) / rate, position, rows[:, 2:4], torque,
        truth=truth, base=base, facts=facts,
    )  # fmt: skip


def _spring(rng: np.random.Generator) -> Machine:
    rate = float(rng.choice([200, 500, 1000, 2000]))
    sub = int(np.ceil(20_000 / rate))
    own = float(rng.uniform(0.01, 0.06)) * rate
    seconds = float(rng.uniform(150, 400)) / own
    dt = 1 / rate / sub
    linear = bool(rng.random() < 0.6)
    mass, travel = float(np.exp(rng.uniform(-6, 4))), float(np.exp(rng.uniform(-5, 0)))
    spring = mass * (2 * np.pi * own) ** 2
    bend = str(rng.choice(["straight", "harder", "softer", "harder and lopsided", "lopsided"]))
    third = {"straight": 0.0, "harder": 0.4, "softer": -0.25, "harder and lopsided": 0.5, "lopsided": 0.0}[
        bend
    ]
    third *= float(rng.uniform(0.3, 1.0))
    second = float(rng.uniform(0.1, 0.25)) * float(rng.choice([-1, 1])) if "lopsided" in bend else 0.0
    damping = float(rng.uniform(0.01, 0.05))
    row = np.zeros(law.LAW)
    row[law.WET_UP] = row[law.WET_DOWN] = 2 * damping * np.sqrt(spring * mass)
    row[law.SPRING1], row[law.SPRING2], row[law.SPRING3] = (
        spring, second * spring / travel, third * spring / travel**2,
    )  # fmt: skip
    count = int(seconds * rate)
    wave = band_noise(rng, count, 1 / rate, 0.1 * own, 2.5 * own)
    drive = spring * travel * 0.5 * damping**0.5 * wave
    zero = np.zeros(count * sub)
    rows = law.one_axis(zero, zero, drive, sub, dt, mass, 0.0, 0.0, np.inf, row)
    facts: dict[str, Any] = {"rate": rate, "own": round(own, 1), "bend": bend}
    if not np.isfinite(rows).all() or np.abs(rows[:, 0]).max() > 1.6 * travel:
        # Beyond where a softening spring holds: another excitation.
        drive *= 0.5
        rows = law.one_axis(zero, zero, drive, sub, dt, mass, 0.0, 0.0, np.inf, row)
    position, torque = _measured(rng, rows[:, :1], rows[:, 2:], 8 * travel, facts)
    truth = {"viscous_friction": {"coefficient": row[law.WET_UP]}}
    if third:
        truth["cubic_stiffness"] = {"coefficient": row[law.SPRING3]}
    if second:
        truth["quadratic_stiffness"] = {"coefficient": row[law.SPRING2]}
    time = np.arange(rows.shape[0]) / rate
    base = {"mass": mass, "stiffness": spring}
    return Machine(
        "spring", bend, time, position, rows[:, 1:2], torque, linear, False, [truth], base, facts=facts
    )


def _flexible(rng: np.random.Generator) -> Machine:
    rate = float(rng.choice([500, 1000, 2000]))
    sub = int(np.ceil(20_000 / rate))
    motor = float(np.exp(rng.uniform(-6, 1)))
    load = motor * float(rng.uniform(0.3, 3))
    own = float(rng.uniform(0.02, 0.08)) * rate
    spring = (2 * np.pi * own) ** 2 * motor * load / (motor + load)
    damper = float(rng.uniform(0.005, 0.04)) * 2 * np.sqrt(spring * motor * load / (motor + load))
    dry = bool(rng.random() < 0.5)
    periods, length = int(rng.integers(6, 14)), int(rate * rng.choice([1, 2, 4]))
    f0 = rate / length
    lines = np.arange(1, int(2.5 * own / f0))
    lines = lines[lines % 2 == 1] if rng.random() < 0.5 else lines
    t = np.arange(length) / rate
    phases = rng.uniform(0, 2 * np.pi, lines.size)
    wave = np.cos(2 * np.pi * f0 * np.outer(t, lines) + phases) @ (1 / np.sqrt(lines * f0))
    wave = wave / wave.std()
    size = float(np.exp(rng.uniform(-3, 3))) * motor
    torque = np.tile(size * wave, periods + 2)
    level = float(rng.uniform(0.05, 0.2)) * size if dry else 0.0
    wet = 0.02 * size
    rows = law.two_masses(torque, sub, 1 / rate / sub, motor, load, spring, damper, level, 0.0, 0.0)
    rows = rows[2 * length :]
    facts: dict[str, Any] = {
        "rate": rate, "own": round(own, 1), "period": length, "lines": (lines * f0).tolist(), "wet": wet,
    }  # fmt: skip
    position, measured = _measured(rng, rows[:, :1] - rows[0, 0], rows[:, 1:], 2 * np.pi / 64, facts)
    truth = {"coulomb_friction": {"torque": level}} if dry else {}
    time = np.arange(rows.shape[0]) / rate
    base = {"mass": motor, "load": load, "spring": spring}
    return Machine(
        "flexible", "dry" if dry else "plain", time, position, np.gradient(rows[:, :1], 1 / rate, axis=0),
        measured, truth=[truth], base=base, facts=facts,
    )  # fmt: skip
