"""Whole cells: friction on every axis, drives as they are, and up to four faults at once.

Plants, laws, integration and sizes of their own: they share no code with ``invid`` nor with the other
generators. Every axis rubs at its motor (dry, viscous, Stribeck, more in one direction than in the other) and
turns its friction over within a few mrad/s. A drive follows its command through a current loop; the torque
that it reports is filtered, rounded and noisy, the encoder has counts and a sub-divisional error, the motor
ripples. One axis is shaken at a time and a P controller holds all; one record more, of all axes, is for
validation.

``Fault.db`` is the power of the missing torque that a fault leaves behind a fit of the linear model and of
the motors' friction, over that of the sensors' noise, on the lines of the excited band of the identify
records, both whitened: what stands there for whoever has the rest right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hidden.cell_plants import (
    CellPlant,
    Drives,
    Law,
    drawn_drives,
    drawn_plant,
    joint,
    march,
    multisine,
    taken,
)
from invid.model.diagnosis_document import Diagnosis, Finding
from invid.recording.model import Experiment, Kind, Outcome, Recording, Role

SETTLE, PERIODS = 2, 3
"""Periods of 8 s that are left to settle, and recorded."""
FRICTION = ("coulomb_friction", "stribeck_friction", "asymmetric_friction", "presliding_friction")
ALWAYS = {"torque_lag", "torque_delay", "viscous_friction", "torque_offset", *FRICTION}
"""What a motor's drive and joint have in every cell: friction that differs by direction is a constant torque
and dry friction, a current loop a lag or a delay."""


NAMES = {
    Law.PLAY: "backlash", Law.HARDENING: "cubic_stiffness", Law.DRY: "coulomb_friction",
    Law.WET: "viscous_friction", Law.GEAR: "transmission_error", Law.TIE: "coupling_stiffness",
    Law.WEIGHT: "gravity", Law.MODE: "extra_mode", Law.SWAY: "sway",
}  # fmt: skip
FAULTS = (Law.PLAY, Law.HARDENING, Law.DRY, Law.WET, Law.GEAR, Law.TIE, Law.MODE)


@dataclass(frozen=True)
class Fault:
    """A law at its place, its numbers, and how far it stands out [dB]."""

    law: Law
    axis: int
    a: int
    b: int
    p: tuple[float, ...]
    element: str | None
    other: int = -1
    db: float = -np.inf

    @property
    def cause(self) -> str:
        return NAMES[self.law]


@dataclass(frozen=True, eq=False)
class Cell:
    """What is true: ``faults`` alone are to be found beside each axis' friction (and ``weights``)."""

    seed: int
    axes: tuple[str, ...]
    masses: tuple[tuple[float, ...], ...]
    faults: tuple[Fault, ...]
    weights: tuple[int, ...]
    settings: dict[str, Any]


def _places(rng: np.random.Generator, plant: CellPlant, law: Law) -> Fault:
    """Where a fault sits, drawn; its numbers come later."""
    axis = int(rng.integers(plant.motors.size))
    first, size = int(plant.motors[axis]), plant.masses[axis].size
    if law in (Law.PLAY, Law.HARDENING, Law.GEAR):
        s = int(rng.integers(size - 1))
        return Fault(law, axis, first + s, first + s + 1, (), f"spring {s + 1}")
    if law is Law.TIE:
        one, other = sorted(int(i) for i in rng.choice(plant.motors.size, 2, replace=False))
        return Fault(law, one, int(plant.ends[one]), int(plant.ends[other]), (), None, other)
    element = None if law is Law.MODE and plant.motors.size == 1 else f"mass {size}"
    return Fault(law, axis, first + size - 1, -1, (), element)


def _sized(
    rng: np.random.Generator, plant: CellPlant, fault: Fault, shape: tuple[float, ...], x: float
) -> Fault:
    """The fault with the size ``x`` in its first number (the mass of a mode, and the spring with it)."""
    if fault.law in (Law.PLAY, Law.GEAR):
        k, c = -plant.stiffness[fault.a, fault.b], -plant.damping[fault.a, fault.b]
        return replace(fault, p=(x, *shape, k, c))
    if fault.law is Law.MODE:
        k = x * (2 * np.pi * shape[0]) ** 2
        return replace(fault, p=(x, k, 0.03 * np.sqrt(k * x)))
    return replace(fault, p=(x, *shape))


def _spectrum(x: np.ndarray, period: int, last: int) -> np.ndarray:
    """(F, …) mean amplitudes on lines 1 to ``last`` of whole periods (n, …)."""
    mean = x.reshape(-1, period, *x.shape[1:]).mean(axis=0)
    return (np.fft.rfft(mean, axis=0) * 2 / period)[1 : last + 1]


@dataclass(frozen=True, eq=False)
class _Strength:
    """How far a force stands out behind a fit of the linear model and of the motors' friction."""

    plant: CellPlant
    drives: Drives
    runs: list[tuple[np.ndarray, np.ndarray, np.ndarray]]
    """Torque (n, M), motion and rates (n, D) of whole periods without noise."""
    widths: np.ndarray

    def prepared(self) -> tuple[list[Any], np.ndarray]:
        """Per run the map from a place to the motors, frequencies and the motion's spectra; and what the fit
        takes, orthonormal (R, c)."""
        plant, drives = self.plant, self.drives
        last = round(drives.hz[-1] * 8 * 1.1)
        omega = 2 * np.pi * np.arange(1, last + 1) / 8.0
        dofs, motors = plant.mass.shape[0], plant.motors
        full = plant.stiffness + 1j * omega[:, None, None] * plant.damping
        full = full - omega[:, None, None] ** 2 * plant.mass
        inner = np.setdiff1d(np.arange(dofs), motors)
        w = np.zeros((omega.size, dofs, motors.size), dtype=complex)
        w[:, motors, np.arange(motors.size)] = 1.0
        w[:, inner] = -np.linalg.solve(full[:, inner][:, :, inner], full[:, inner][:, :, motors])
        z = full[:, motors] @ w
        per = 4.0 / (PERIODS * drives.period)
        loud = per * (drives.torque_noise**2 + drives.torque_step**2 / 12)
        quiet = per * (drives.step**2 / 12 + drives.error[:, 0] ** 2 / 2)
        root = np.linalg.cholesky(np.einsum("fij,j,fkj->fik", z, quiet, z.conj()) + np.diag(loud))
        out = []
        for torque, q, v in self.runs:
            white = _Whitened(root, w)
            spectra = _spectrum(q, drives.period, last)
            columns = []
            for d in range(dofs):
                columns.append(white.at(d, -(omega**2) * spectra[:, d]))
            for a in range(dofs):
                for b in range(a + 1, dofs):
                    if plant.stiffness[a, b]:
                        x = spectra[:, a] - spectra[:, b]
                        columns += [white.between(a, b, x), white.between(a, b, 1j * omega * x)]
                    elif plant.mass[a, b]:
                        both = white.at(a, -(omega**2) * spectra[:, b])
                        columns.append(both + white.at(b, -(omega**2) * spectra[:, a]))
            t = _spectrum(torque, drives.period, last)
            for i, m in enumerate(motors):
                columns.append(white.at(m, 1j * omega * t[:, i]))
                columns.append(white.at(m, -(omega**2) * t[:, i]))
                columns.append(white.at(m, 1j * omega * spectra[:, m]))
                for dry in (np.tanh(v[:, m] / self.widths[i]), np.abs(v[:, m])):
                    columns.append(white.at(m, _spectrum(dry, drives.period, last)))
            out.append((white, omega, spectra, np.stack(columns, axis=1)))
        j = np.concatenate([p[3] for p in out])
        u, s, _ = np.linalg.svd(j / np.maximum(np.linalg.norm(j, axis=0), 1e-300), full_matrices=False)
        return [p[:3] for p in out], u[:, s > 1e-9 * s[0]]

    def db(self, fault: Fault, prepared: tuple[list[Any], np.ndarray]) -> float:
        """Power of the fault's force beyond that of noise [dB]."""
        rows, u = [], prepared[1]
        for (_, q, v), (white, omega, spectra) in zip(self.runs, prepared[0], strict=True):
            if fault.law is Law.MODE:
                m, k, c = fault.p
                spring = k + 1j * omega * c
                share = -(omega**2) * m * spring / (spring - omega**2 * m)
                rows.append(white.at(fault.a, share * spectra[:, fault.a]))
                continue
            f = taken(int(fault.law), np.array(fault.p), q, v, fault.a, fault.b)
            f = _spectrum(f, self.drives.period, omega.size)
            rows.append(white.at(fault.a, f) if fault.b < 0 else white.between(fault.a, fault.b, f))
        r = np.concatenate(rows)
        left = r - u @ (u.T @ r)
        return float(10 * np.log10(max(left @ left / (r.size / 2), 1e-12)))


@dataclass(frozen=True, eq=False)
class _Whitened:
    root: np.ndarray
    w: np.ndarray

    def at(self, dof: int, f: np.ndarray) -> np.ndarray:
        """(R,) what a force (F,) on a coordinate asks of the motors, over their noise."""
        solved = np.linalg.solve(self.root, (self.w[:, dof] * f[:, None])[..., None])[..., 0].ravel()
        return np.concatenate([solved.real, solved.imag])

    def between(self, a: int, b: int, f: np.ndarray) -> np.ndarray:
        return self.at(a, f) - self.at(b, f)


def _simulated(
    plant: CellPlant, drives: Drives, wave: np.ndarray, bias: np.ndarray, faults: tuple[Fault, ...]
) -> tuple[np.ndarray, ...]:
    """Readings, reported and commanded torque (n, M), motion and rates (n, D) of the recorded periods."""
    for mode in (f for f in faults if f.law is Law.MODE):
        plant = plant.grown(mode.a, mode.p)
    laws = [f for f in faults if f.law is not Law.MODE]
    par = np.zeros((len(laws), 7))
    for row, f in zip(par, laws, strict=True):
        row[: len(f.p)] = f.p
    out = march(
        wave, SETTLE + PERIODS, drives.sub, 1.0 / drives.rate / drives.sub, np.linalg.inv(plant.mass),
        plant.damping, plant.stiffness, plant.motors, bias, drives.kp, drives.loop, drives.filt, drives.step,
        drives.error, np.array([int(f.law) for f in laws]),
        np.array([(f.a, f.b) for f in laws]).reshape(-1, 2), par,
    )  # fmt: skip
    return tuple(x[SETTLE * drives.period :] for x in out)


def draw(
    seed: int,
    *,
    motors: int | None = None,
    masses: tuple[int, ...] | None = None,
    faults: tuple[Law, ...] | None = None,
    db: float | None = None,
    gravity: bool = True,
) -> tuple[Recording, Cell]:
    """One whole cell: 1 to 3 axes of 2 or 3 masses, 0 to 4 ``faults``, each of ``db`` (None: 3 to 35)."""
    rng = np.random.default_rng([seed, 26])
    count = int(rng.integers(1, 4)) if motors is None else motors
    sizes = tuple(int(n) for n in rng.integers(2, 4, count)) if masses is None else masses
    count = len(sizes)
    plant = drawn_plant(rng, sizes)
    drives = drawn_drives(rng, plant)
    axes = tuple(f"J{i + 1}" for i in range(count))
    waves = []
    for i in range(count):
        waves.append(np.zeros((drives.period, count)))
        waves[-1][:, i] = drives.peak[i] * multisine(rng, drives)
    both = [0.7 * drives.peak[i] * multisine(rng, drives) for i in range(count)]
    waves.append(np.stack(both, axis=1))
    own, bias, weights = [], np.zeros(count), []
    none = np.zeros(count)
    smooth = [
        Fault(Law.WET, i, int(m), -1, (0.3 * drives.peak[i],), None) for i, m in enumerate(plant.motors)
    ]
    rough = [_simulated(plant, drives, w, none, tuple(smooth)) for w in waves[:count]]
    for i, m in enumerate(plant.motors):
        speed, travel = float(rough[i][4][:, m].std()), float(rough[i][3][:, m].std())
        own.append(Fault(Law.JOINT, i, int(m), -1, joint(rng, drives.peak[i], speed), "mass 1"))
        for cycles, share in ((6.0, 2e-3), (24.0, 2e-3)):
            ripple = (share * rng.uniform(0.2, 1.0) * drives.peak[i], cycles, rng.uniform(0, 6.28))
            own.append(Fault(Law.RIPPLE, i, int(m), -1, ripple, None))
        if gravity and rng.uniform() < 0.35:
            weight = drives.peak[i] * rng.uniform(0.2, 0.6) * min(1.0, 0.1 / max(travel, 1e-3))
            angle = rng.uniform(-1.2, 1.2)
            own.append(Fault(Law.WEIGHT, i, int(plant.ends[i]), -1, (weight, angle), None))
            bias[i], _ = weight * np.sin(angle), weights.append(i)
    runs = [_simulated(plant, drives, w, bias, tuple(own)) for w in waves[:count]]
    widths = np.array([f.p[6] for f in own if f.law is Law.JOINT])
    strength = _Strength(plant, drives, [(r[1], r[3], r[4]) for r in runs], widths)
    prepared = strength.prepared()
    if faults is None:
        number = int(rng.choice([0, 1, 2, 3, 4], p=[0.2, 0.3, 0.25, 0.15, 0.1]))
        known = [f for f in FAULTS if f is not Law.TIE or count > 1]
        faults = tuple(known[int(i)] for i in rng.permutation(len(known))[:number])
    found: list[Fault] = []
    for law in faults:
        fault = _places(rng, plant, law)
        goal = float(rng.uniform(3.0, 35.0)) if db is None else db
        found.append(_at_db(rng, plant, drives, strength, prepared, fault, goal))
    every = (*own, *found)
    results = [_simulated(plant, drives, w, bias, every) for w in waves]
    dofs = plant.mass.shape[0]
    again = [(r[1], r[3][:, :dofs], r[4][:, :dofs]) for r in results[:count]]
    strength = replace(strength, runs=again)
    prepared = strength.prepared()
    found = [replace(f, db=strength.db(f, prepared)) for f in found]
    demand = bool(rng.uniform() < 0.5)
    recording = _recording(rng, plant, drives, axes, results, demand)
    settings = {"rate": drives.rate, "sizes": sizes, "demand": demand, "loop_s": drives.loop.tolist()}
    settings["friction"] = [f.p for f in own if f.law is Law.JOINT]
    truth = Cell(seed, axes, tuple(tuple(m) for m in plant.masses), tuple(found), tuple(weights), settings)
    return recording, truth


def _at_db(
    rng: np.random.Generator, plant: CellPlant, drives: Drives, strength: _Strength, prepared: Any,
    fault: Fault,
    goal: float,
) -> Fault:  # fmt: skip
    """The fault with the size that stands ``goal`` dB out, or as near as its bounds allow."""
    q = max((r[1] for r in strength.runs), key=lambda q: q[:, fault.a].std())
    x = q[:, fault.a] - (q[:, fault.b] if fault.b >= 0 else 0.0)
    deflection, travel = float(x.std()), float(q[:, fault.a].std())
    speed = max(float(r[2][:, fault.a].std()) for r in strength.runs)
    peak = drives.peak[fault.axis]
    k = -plant.stiffness[fault.a, fault.b] if fault.b >= 0 else 0.0
    shape: tuple[float, ...] = ()
    if fault.law is Law.PLAY:
        low, high = 1e-3 * deflection, 1.5 * deflection
    elif fault.law is Law.HARDENING:
        low, high = 1e-4 * k / deflection**2, 0.5 * k / deflection**2
    elif fault.law is Law.DRY:
        low, high, shape = 1e-4 * peak, 0.15 * peak, (rng.uniform(1.5e-3, 6e-3),)
    elif fault.law is Law.WET:
        low, high = 1e-4 * peak / speed, 0.3 * peak / speed
    elif fault.law is Law.GEAR:
        low, high = 1e-4 * deflection, 0.3 * deflection
        shape = (max(2.0, round(rng.uniform(0.5, 2.5) / travel)), rng.uniform(0, 6.28))
    elif fault.law is Law.TIE:
        stiff = float(np.concatenate([*plant.springs]).min())
        low, high = 1e-4 * stiff, 0.3 * stiff
    elif fault.law is Law.MODE:
        low, high, shape = 1e-3 * plant.mass[fault.a, fault.a], 0.3 * plant.mass[fault.a, fault.a], ()
        shape = (rng.uniform(4.0, 14.0),)
    else:
        low, high = 1e-4 * peak / (travel * speed), 0.3 * peak / (travel * speed)
    for _ in range(12):
        middle = float(np.sqrt(low * high))
        trial = _sized(rng, plant, fault, shape, middle)
        now = strength.db(trial, prepared)
        if abs(now - goal) < 0.5:
            break
        low, high = (middle, high) if now < goal else (low, middle)
    return trial


def _recording(
    rng: np.random.Generator, plant: CellPlant, drives: Drives, axes: tuple[str, ...], results: list[Any],
    demand: bool,
) -> Recording:  # fmt: skip
    """What the sensors saw."""
    count, clock, experiments = len(axes), 0.0, []
    for number, (reading, torque, command, _, _) in enumerate(results):
        noisy = torque + drives.torque_noise * rng.standard_normal(torque.shape)
        clock += SETTLE * drives.period / drives.rate
        experiments.append(
            Experiment(
                key=f"{number:03d}",
                kind=Kind.MULTISINE,
                role=Role.IDENTIFY if number < count else Role.VALIDATE,
                excited_axis=number if number < count else (0 if count == 1 else -1),
                hold_gain=drives.kp.copy(),
                period_samples=drives.period,
                frequencies_hz=drives.hz,
                sample_rate_hz=drives.rate,
                time=clock + np.arange(reading.shape[0]) / drives.rate,
                position=np.round(reading / drives.step) * drives.step,
                torque=np.round(noisy / drives.torque_step) * drives.torque_step,
                torque_demand=command.copy() if demand else None,
            )
        )
        clock += PERIODS * drives.period / drives.rate + 1.0
    return Recording(
        robot="cell",
        axes=axes,
        position_unit="rad",
        torque_unit="N·m",
        created="2026-11-24T10:00:00Z",
        experiments=tuple(experiments),
        masses_per_axis=tuple(m.size for m in plant.masses),
        rated_torque=drives.rated,
        encoder_resolution=drives.step,
        outcome=Outcome.COMPLETED,
        source="cell",
    )


def is_true(truth: Cell, f: Finding) -> bool:
    """Whether a finding names something that is there, at its place."""
    e = f.effect
    axis = truth.axes.index(e.axis)
    if e.cause in ALWAYS and e.element in (None, "mass 1"):
        return True
    if e.cause == "gravity":
        return axis in truth.weights
    if e.cause == "cogging":
        cycles = e.parameters["cycles_per_rev"]
        return any(abs(cycles.value - n) < max(0.1 * n, 3.0 * (cycles.std or 0.0)) for n in (6, 24))
    return any(_names(truth, fault, f) for fault in truth.faults)


def _names(truth: Cell, fault: Fault, f: Finding) -> bool:
    e, law = f.effect, fault.cause
    same = e.cause == law or (law == "coulomb_friction" and e.cause in FRICTION)
    if fault.law is Law.SWAY and e.table is not None:
        same = set(e.table.quantities) == {"velocity", "position"}
    if fault.other >= 0:
        return same and {e.axis, e.other_axis} == {truth.axes[fault.axis], truth.axes[fault.other]}
    here = e.axis == truth.axes[fault.axis]
    return same and here and (fault.element is None or e.element == fault.element)


def scored(truth: Cell, d: Diagnosis) -> dict[str, Any]:
    """What was named of what there is, what was named wrongly, what is left."""
    rubs = {f.effect.axis for f in d.findings if f.effect.cause in FRICTION and f.effect.element == "mass 1"}
    wrong = [f for f in d.findings if not is_true(truth, f)]

    def told(f: Finding) -> str:
        return f"{f.effect.cause} {f.effect.axis} {f.effect.element} {f.confidence:.2f}"

    return {
        "seed": truth.seed,
        "sizes": list(truth.settings["sizes"]),
        "verdict": str(d.verdict),
        "faults": [
            [
                f.cause,
                truth.axes[f.axis],
                f.element,
                round(f.db, 1),
                any(_names(truth, f, g) for g in d.findings),
            ]
            for f in truth.faults
        ],
        "friction": [len(rubs), len(truth.axes)],
        "gravity": [
            sum(f.effect.cause == "gravity" and is_true(truth, f) for f in d.findings),
            len(truth.weights),
        ],
        "wrong": [told(f) for f in wrong],
        "sure_and_wrong": [told(f) for f in wrong if f.confidence >= 0.9],
        "named": [told(f) for f in d.findings],
        "floors": [round(r.after / r.noise_floor, 2) for r in d.residual],
        "before": [round(r.before / r.noise_floor, 1) for r in d.residual],
        "explained": d.explained_fraction,
    }
