"""How far each hidden element of a MuJoCo cell stands out, and what a diagnosis document says of it.

A hidden element's force, its law over the plant's own motion, less what the masses, springs and dampers
around it would answer to, is referred to the motors by the linear plant that MuJoCo compiles, and compared
with the noise of torque and encoder: power over power on the excited band, in decibels.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from machines.mujoco_cells import FRICTION, HIGH, LOW, PERIODS, RATE, Cell, Hidden, Run, mjcf

SURE = 0.9
SAME = {
    **dict.fromkeys(
        FRICTION, ("coulomb_friction", "stribeck_friction", "presliding_friction", "asymmetric_friction")
    ),
    "viscous": ("viscous_friction",),
    "cogging": ("cogging",),
    "cubic": ("cubic_stiffness",),
    "plastic": ("spring_hysteresis",),
    "play": ("backlash",),
    "delay": ("torque_delay", "torque_lag"),
    "lag": ("torque_delay", "torque_lag"),
    "mode": ("extra_mode",),
    "weight": ("gravity", "torque_offset"),
    "base": ("base_compliance",),
}
"""Causes of the catalogue that say what an element does. Friction is one family, a short lag is a delay, and
a weight that hardly turns is a constant torque."""


def with_strengths(cell: Cell, runs: list[Run]) -> Cell:
    """The cell with every element's ``db``."""
    plain = replace(cell, hidden=())
    model = mujoco.MjModel.from_xml_string(mjcf(plain))
    names = [model.joint(j).name for j in range(model.njnt)]
    motors = [names.index(f"q{i + 1}_1") for i in range(len(cell.inertia))]
    matrices = _linear(model)
    strong = [replace(h, db=_strength(cell, h, runs, names, motors, matrices)) for h in cell.hidden]
    return replace(cell, hidden=tuple(strong))


def _linear(model: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass, damping and stiffness of the compiled model about where it is at rest."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    out = []
    for at in ("qvel", "qpos"):
        columns = np.zeros((model.nv, model.nv))
        for k in range(model.nv):
            for sign in (1.0, -1.0):
                mujoco.mj_resetData(model, data)
                getattr(data, at)[k] = sign * 1e-4
                mujoco.mj_forward(model, data)
                columns[:, k] -= sign * data.qfrc_passive / 2e-4
        out.append(columns)
    return mass, out[0], out[1]


def _force(cell: Cell, h: Hidden, run: Run, i: int) -> tuple[np.ndarray, dict[str, float], np.ndarray]:
    """Force (n,), coordinates it acts on, and the columns (n, k) that a linear chain has for it."""
    q = {n: run.q[:, k] for k, n in enumerate(run.names)}
    v = {n: run.v[:, k] for k, n in enumerate(run.names)}

    def slope(x: np.ndarray) -> np.ndarray:
        return np.gradient(x, 1.0 / RATE)

    p, n = h.numbers, len(cell.inertia[i])
    one = np.ones(run.q.shape[0])
    here = f"q{i + 1}_{h.element}"
    if h.kind in (*FRICTION, "viscous"):
        if h.kind == "viscous":
            f = p["damping"] * v[here]
            return f, {here: 1.0}, np.stack([one, slope(v[here])], axis=1)
        f = p["torque"] * np.tanh(v[here] / 1e-3)
        return f, {here: 1.0}, np.stack([one, v[here], slope(v[here])], axis=1)
    if h.kind in ("cubic", "plastic", "play"):
        a, b = here, f"q{i + 1}_{h.element + 1}"
        x, u = q[a] - q[b], v[a] - v[b]
        if h.kind == "cubic":
            f = p["cubic"] * x**3
        elif h.kind == "plastic":
            z, f = x[0], np.zeros(x.size)
            for k, at in enumerate(x):
                z = min(max(z, at - p["yield"]), at + p["yield"])
                f[k] = p["stiffness"] * (at - z)
        else:
            f = -cell.springs[i][h.element - 1] * np.clip(x, -p["gap"] / 2, p["gap"] / 2)
        return f, {a: 1.0, b: -1.0}, np.stack([one, x, u], axis=1)
    first, last = f"q{i + 1}_1", f"q{i + 1}_{n}"
    if h.kind == "cogging":
        f = p["torque"] * np.sin(p["poles"] * q[first] + p["phase"])
        return f, {first: 1.0}, np.stack([one, v[first], slope(v[first])], axis=1)
    if h.kind in ("delay", "lag"):
        f = p["seconds"] * slope(run.torque[:, i])
        return f, {first: 1.0}, np.stack([one, v[first], slope(v[first])], axis=1)
    if h.kind == "weight":
        return (
            p["torque"] * np.sin(q[last] + p["angle"]),
            {last: 1.0},
            np.stack([one, slope(v[last])], axis=1),
        )
    if h.kind == "mode":
        f = p["mass"] * slope(v[last] + v[f"mode{i + 1}"])
        return f, {last: 1.0}, np.stack([one, slope(v[last])], axis=1)
    loads = {f"q{j + 1}_{len(m)}": 1.0 for j, m in enumerate(cell.inertia)}
    f = cell.inertia[0][-1] * slope(v["base"])
    return f, loads, np.stack([one, *(slope(v[name]) for name in loads)], axis=1)


def _strength(
    cell: Cell, h: Hidden, runs: list[Run], names: list[str], motors: list[int],
    matrices: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> float:  # fmt: skip
    mass, damping, stiffness = matrices
    inner = [k for k in range(len(names)) if k not in motors]
    power = bins = 0.0
    for run in (r for r in runs if r.role == "identify"):
        force, places, columns = _force(cell, h, run, h.axis)
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        force = force - columns @ np.linalg.lstsq(columns, force, rcond=None)[0]
        if run.period:
            count, window = run.period, np.ones(run.period)
            force = force[: PERIODS * count].reshape(PERIODS, count).mean(axis=0)
            per = count / PERIODS
        else:
            count, window = force.size, np.hanning(force.size)
            per = float((window**2).sum())
        hz = np.fft.rfftfreq(count, 1.0 / RATE)
        band = (hz >= LOW) & (hz <= HIGH)
        f = np.fft.rfft(force * window)[band]
        w = 2j * np.pi * hz[band][:, None, None]
        whole = stiffness + w * damping + w**2 * mass
        to = np.zeros((f.size, len(names), len(motors)), dtype=complex)
        to[:, motors, range(len(motors))] = 1.0
        if inner:
            to[:, inner] = -np.linalg.solve(whole[:, inner][:, :, inner], whole[:, inner][:, :, motors])
        z = whole[:, motors] @ to
        loud = np.array(cell.noise) ** 2 + np.array(cell.step) ** 2 / 12
        quiet = np.array(cell.count) ** 2 / 12
        noise = per * (loud + (np.abs(z) ** 2 * quiet).sum(axis=2))
        pattern = np.array([places.get(n, 0.0) for n in names])
        seen = np.abs(f[:, None] * np.einsum("fqm,q->fm", to, pattern)) ** 2
        power += float((seen / noise).sum())
        bins += seen.size
    return 10 * math.log10(max(power / bins, 1e-12))


def scored(cell: Cell, document: dict[str, Any]) -> dict[str, Any]:
    """What a diagnosis (JSON) names of what is there; the keys are those of ``hidden.cells.scored``."""
    findings = document["findings"]
    wrong = [f for f in findings if not any(names(cell, h, f) for h in cell.hidden)]

    def told(f: dict[str, Any]) -> str:
        return f"{f['cause']} {f['axis']} {f['element']} {f['confidence']:.2f}"

    rows = document["residual"]
    return {
        "seed": cell.seed,
        "sizes": [len(m) for m in cell.inertia],
        "motion": cell.motion,
        "verdict": document["verdict"],
        "faults": [
            [h.kind, cell.axes[h.axis], h.element, round(h.db, 1), any(names(cell, h, f) for f in findings)]
            for h in cell.hidden
        ],
        "friction": [0, 0],
        "gravity": [0, 0],
        "wrong": [told(f) for f in wrong],
        "sure_and_wrong": [told(f) for f in wrong if f["confidence"] >= SURE],
        "named": [told(f) for f in findings],
        "alternatives": [a["cause"] for f in findings for a in f["alternatives"]],
        "floors": [round(r["after"] / r["noise_floor"], 2) if r["noise_floor"] else 0.0 for r in rows],
        "before": [round(r["before"] / r["noise_floor"], 1) if r["noise_floor"] else 0.0 for r in rows],
        "explained": document["explained_fraction"],
    }


def names(cell: Cell, h: Hidden, finding: dict[str, Any]) -> bool:
    """Whether a finding names this element at its place, or lists it among what it cannot tell apart."""
    for f in (finding, *finding["alternatives"]):
        if f["cause"] not in SAME[h.kind]:
            continue
        if h.kind == "base":
            return True
        if f["axis"] != cell.axes[h.axis]:
            continue
        if h.kind in (*FRICTION, "viscous"):
            at = f"mass {h.element}"
        elif h.kind in ("cubic", "plastic", "play"):
            at = f"spring {h.element}"
        else:
            at = None
        if at is None or f["element"] in (None, at):
            return True
    return False
