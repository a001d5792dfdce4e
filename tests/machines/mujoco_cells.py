"""Robot cells drawn in MuJoCo, of its own elements, and recorded as drives record them.

The physics is MuJoCo's: frictionloss (soft as by default, and hard), joint damping, a passive ``dcmotor`` for
LuGre and cogging, tendons with cubic stiffness, with ``springyield`` beside them, with a dead band or a
second joint with limits for play, a delayed or filtered actuator, a hidden child joint, a centre of mass off
its axis, a base on a spring. Links are carried by one another (their hinges meet in one point, so that the
mass matrix does not depend on the pose), rotors stand on the ground, ``position`` actuators hold. Nothing is
shared with ``invid``: what comes out is arrays, and a file in the documented format.
"""

import json
import math
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import mujoco
import numpy as np
from mujoco import rollout

RATE, SUB = 1000, 16
"""Samples a second, steps of the engine a sample. Its Euler step takes the damping of a step ago: with
four steps that alone stood 400 times over the noise's power beside a clamped resonance, and was named a
mode."""
PERIOD, SETTLE, PERIODS = 4.0, 2, 4
LENGTH = 16.0
"""Seconds of a chirp and of production motion."""
LOW, HIGH = 0.5, 45.0
"""Excited band [Hz]."""
G = 9.81
FRICTION = ("soft dry", "hard dry", "lugre")
SPRING = ("cubic", "plastic", "play")
SIZES = {
    "soft dry": (4e-3, 0.2),  # of the rms torque
    "hard dry": (4e-3, 0.2),
    "lugre": (4e-3, 0.2),
    "viscous": (3e-3, 0.1),  # of the damping that would brake the axis in a second
    "cogging": (3e-3, 0.1),
    "cubic": (
        2e-4,
        0.03,
    ),  # of the spring, where the torque alone would bend it; resonance bends it ten times as far
    "plastic": (0.01, 0.2),  # of the spring
    "play": (0.02, 1.0),  # of the rms deflection
    "delay": (1.5e-3, 4e-3),  # seconds; within a sample it is a convention of sampling
    "lag": (1.5e-3, 4e-3),
    "mode": (0.02, 0.3),  # of the link's inertia
    "weight": (0.02, 0.5),
    "base": (1.0, 30.0),  # base's inertia over that of the links
}
"""Sizes are drawn evenly in their logarithm."""


@dataclass(frozen=True)
class Hidden:
    """One element beyond the linear chain: ``element`` as the product counts masses and springs, ``size`` as
    ``SIZES`` says, ``numbers`` in SI."""

    kind: str
    axis: int
    element: int
    size: float
    numbers: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Cell:
    """One cell: ``inertia[i]`` [kg·m²] of the masses of axis i, ``springs[i]`` and ``dampers[i]`` between."""

    seed: int
    inertia: tuple[tuple[float, ...], ...]
    springs: tuple[tuple[float, ...], ...]
    dampers: tuple[tuple[float, ...], ...]
    carried: tuple[bool, ...]
    """Whether an axis' link stands on the link of the axis before."""
    tilt: float
    motion: str
    torque: tuple[float, ...]
    """Rms of the shaking torque [N·m]."""
    hidden: tuple[Hidden, ...]
    count: tuple[float, ...]
    """Encoder's count [rad]."""
    noise: tuple[float, ...]
    step: tuple[float, ...]
    """Torque's noise and steps [N·m]."""

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(f"R{i + 1}" for i in range(len(self.inertia)))

    def of(self, kind: str, axis: int | None = None) -> Hidden | None:
        return next((h for h in self.hidden if h.kind == kind and axis in (None, h.axis)), None)

    def load(self, axis: int) -> float:
        """Inertia that an axis turns, with what its link carries."""
        total = sum(self.inertia[axis])
        later = axis + 1
        while later < len(self.inertia) and self.carried[later]:
            total += self.inertia[later][-1]
            later += 1
        return total


@dataclass(frozen=True, eq=False)
class Run:
    """One experiment: readings (n, M), and what the plant did (n, nq) without noise."""

    kind: str
    excited: int
    role: str
    lines: np.ndarray
    period: int
    position: np.ndarray
    torque: np.ndarray
    q: np.ndarray
    v: np.ndarray
    names: tuple[str, ...]


def drawn(
    seed: int, *, kinds: tuple[str, ...] | None = None, motion: str | None = None,
    sizes: tuple[int, ...] | None = None, size: float | None = None,
) -> Cell:  # fmt: skip
    """One to three axes of one to three masses with none to three hidden elements (or ``kinds``, at the place
    ``size`` of their range, 0 to 1)."""
    rng = np.random.default_rng([seed, 39])
    sizes = tuple(int(n) for n in rng.integers(1, 4, rng.integers(1, 4))) if sizes is None else sizes
    inertia, springs, dampers = [], [], []
    for n in sizes:
        masses = 10 ** rng.uniform(-0.5, 0.7) * rng.dirichlet(np.full(n, 8.0))
        pair = masses[:-1] * masses[1:] / (masses[:-1] + masses[1:])
        k = pair * (2 * np.pi * rng.uniform(6.0, 25.0, n - 1)) ** 2
        inertia.append(tuple(masses.tolist()))
        springs.append(tuple(k.tolist()))
        dampers.append(tuple((2 * rng.uniform(0.005, 0.03, n - 1) * np.sqrt(k * pair)).tolist()))
    axes = len(sizes)
    carried = (False, *(bool(c) for c in rng.random(axes - 1) < 0.7))
    motion = motion or str(rng.choice(["multisine", "chirp", "production"], p=[0.5, 0.25, 0.25]))
    resolution = 2 * np.pi / 2.0 ** rng.integers(17, 21, axes)
    cell = Cell(
        seed, tuple(inertia), tuple(springs), tuple(dampers), carried,
        math.acos(rng.uniform(0.2, 0.95) * rng.choice([-1, 1])), motion, (0.0,) * axes, (),
        tuple(resolution.tolist()), (0.0,) * axes, (0.0,) * axes,
    )  # fmt: skip
    torque = [float(cell.load(i) * rng.uniform(6.0, 15.0)) for i in range(axes)]
    noise = [t * float(rng.uniform(1e-3, 5e-3)) for t in torque]
    cell = replace(cell, torque=tuple(torque), noise=tuple(noise), step=tuple(3 * t * 1e-3 for t in torque))
    if kinds is None:
        number = int(rng.choice([0, 1, 2, 3], p=[0.2, 0.35, 0.3, 0.15]))
        kinds = tuple(str(k) for k in rng.permutation(list(SIZES)))
    else:
        number = len(kinds)
    found: list[Hidden] = []
    for kind in kinds:
        if len(found) == number:
            break
        low, high = SIZES[kind]
        at = rng.uniform() if size is None else size
        made = _placed(rng, cell, kind, low * (high / low) ** at, found)
        if made is not None:
            found.append(made)
            if kind == "weight":  # what turns with a weight carries nothing and is carried by nothing
                free = (made.axis, made.axis + 1)
                cell = replace(cell, carried=tuple(c and i not in free for i, c in enumerate(cell.carried)))
    return replace(cell, hidden=tuple(found))


def _placed(
    rng: np.random.Generator, cell: Cell, kind: str, size: float, others: list[Hidden]
) -> Hidden | None:
    """The element at a place that is free for it, or None."""
    axes = range(len(cell.inertia))
    taken = {(h.kind, h.axis, h.element) for h in others}
    if kind in FRICTION or kind == "viscous":
        group = ("viscous",) if kind == "viscous" else FRICTION
        places = [(i, m + 1) for i in axes for m in range(len(cell.inertia[i])) if kind != "lugre" or m == 0]
        places = [p for p in places if not any((k, *p) in taken for k in group)]
        places = [p for p in places if p[1] == 1] if rng.random() < 0.6 else places
    elif kind in SPRING:
        places = [(i, s + 1) for i in axes for s in range(len(cell.springs[i]))]
        places = [p for p in places if not any((k, *p) in taken for k in SPRING)]
    elif kind == "mode":  # on a link that nothing carries: else it hangs on two axes
        places = [(i, len(cell.inertia[i])) for i in axes if not cell.carried[i]]
    elif kind == "weight":
        places = [] if any(h.kind in ("base", "mode") for h in others) else [(i, 0) for i in axes]
    elif kind == "base":
        barred = any(h.kind == "weight" for h in others)
        places = [] if barred else [(0, 0)]
    elif kind in ("delay", "lag") and cell.motion == "production":
        places = []
    else:
        places = [(i, 1) for i in axes]
    if not places:
        return None
    axis, element = places[int(rng.integers(len(places)))]
    torque, load = cell.torque[axis], cell.load(axis)
    numbers: dict[str, float] = {}
    if kind in FRICTION:
        numbers = {"torque": size * torque}
        if kind == "lugre":
            numbers |= {"static": numbers["torque"] * rng.uniform(1.0, 1.5), "stribeck": 0.02}
            numbers["stiffness"] = numbers["torque"] / 10 ** rng.uniform(-4.0, -2.7)
    elif kind == "viscous":
        numbers = {"damping": size * load}
    elif kind == "cogging":
        poles = float(rng.integers(4, 25))
        numbers = {"torque": size * torque, "poles": poles, "phase": float(rng.uniform(0, 6.28))}
    elif kind in SPRING:
        k = cell.springs[axis][element - 1]
        moved = torque / k * 0.5  # about the rms deflection
        if kind == "cubic":
            numbers = {"cubic": size * k / moved**2}
        elif kind == "plastic":
            numbers = {"stiffness": size * k, "yield": moved * float(rng.uniform(0.1, 0.8))}
        else:
            numbers = {"gap": size * moved, "joint": float(rng.random() < 0.5)}
    elif kind in ("delay", "lag"):
        numbers = {"seconds": size}
    elif kind == "mode":
        mass = size * cell.inertia[axis][element - 1]
        hz = float(rng.uniform(8.0, 35.0))
        k = mass * (2 * np.pi * hz) ** 2
        numbers = {"mass": mass, "stiffness": k, "damping": 2 * 0.02 * math.sqrt(k * mass)}
    elif kind == "weight":
        numbers = {"torque": size * torque, "angle": float(rng.uniform(-1.2, 1.2))}
    else:
        mass = size * sum(m[-1] for m in cell.inertia)
        k = mass * (2 * np.pi * float(rng.uniform(5.0, 30.0))) ** 2
        numbers = {"mass": mass, "stiffness": k, "damping": 2 * 0.02 * math.sqrt(k * mass)}
    return Hidden(kind, axis, element, size, numbers)


def users(cell: Cell) -> str:
    """The XML that a user would have of the cell: a motor an axis under the axis' name, no holds."""
    text = re.sub(r"<sensor>.*</sensor>|<position [^>]*/>", "", mjcf(cell))
    for i, axis in enumerate(cell.axes):
        text = text.replace(f'name="shake{i + 1}"', f'name="{axis}"')
    return text


def urdf(cell: Cell, *, gear: float = 1.0, rotor: bool = False, more: str = "") -> str:
    """The cell as a user's URDF: numbers of the joints, behind gears from which the motors are recorded.

    Of an axis of several masses the link stands on its own; ``rotor``: the motor's inertia in the drive.
    """
    out = ""
    links, n2 = {}, gear**2
    for i, masses in enumerate(cell.inertia):
        for q, inertia in enumerate(masses):
            name, weight = f"q{i + 1}_{q + 1}", cell.of("weight", i)
            hung = i > 0 and cell.carried[i]
            axis = (math.sin(cell.tilt), 0.0, math.cos(cell.tilt)) if hung else (0.0, 0.0, 1.0)
            parent = f"q{i + 1}_{q}" if q else f"q{i}_1" if i and cell.carried[i] else "base"
            mass, at, own = 1.0, "0 0 0", 0.0 if rotor and q == 0 else inertia * n2
            if weight is not None:
                mass, axis = 400.0 * inertia, (0.0, 1.0, 0.0)
                arm, angle = weight.numbers["torque"] / (mass * G), weight.numbers["angle"]
                at, own = f"{arm * math.sin(angle)} 0 {arm * math.cos(angle)}", own - mass * arm**2
            links[name] = (mass, at, max(own, 1e-9))
            dry = sum(h.numbers["torque"] for h in cell.hidden if h.kind == "hard dry" and h.axis == i)
            damping = cell.dampers[i][q - 1] * n2 if q else 0.0
            out += (
                f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{name}"/>'
                f'<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'
                f'<dynamics damping="{damping}" friction="{dry * gear if q == 0 else 0.0}"/></joint>'
            )
            if q:
                k = cell.springs[i][q - 1] * n2
                out += f'<gazebo reference="{name}"><springStiffness>{k}</springStiffness></gazebo>'
        inertia_of_rotor = f'<drake:rotor_inertia value="{masses[0]}"/>' if rotor else ""
        out += (
            f'<transmission name="t{i}"><type>transmission_interface/SimpleTransmission</type>'
            f'<joint name="q{i + 1}_1"/><actuator name="{cell.axes[i]}"><mechanicalReduction>{gear}'
            f"</mechanicalReduction>{inertia_of_rotor}</actuator></transmission>"
        )
    for name, (mass, at, own) in links.items():
        out += (
            f'<link name="{name}"><visual><geometry><mesh filename="package://none/{name}.stl"/></geometry>'
            f'</visual><inertial><origin xyz="{at}"/><mass value="{mass}"/><inertia ixx="{own}" iyy="{own}" '
            f'izz="{own}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
    spaces = 'xmlns:drake="http://drake.mit.edu"' if rotor else ""
    return f'<robot name="cell" {spaces}><!-- my robot --><link name="base"/>{out}{more}</robot>'


def wrong(cell: Cell, share: float) -> Cell:
    """The cell with nothing hidden and every number off by up to a share."""
    rng = np.random.default_rng(cell.seed)

    def off(rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        return tuple(tuple(x * float(np.exp(rng.uniform(-share, share))) for x in row) for row in rows)

    return replace(
        cell, hidden=(), inertia=off(cell.inertia), springs=off(cell.springs), dampers=off(cell.dampers)
    )


def mjcf(cell: Cell, production: bool = False) -> str:
    """The cell as MuJoCo's XML; the gains of the holds depend on the motion."""
    direction = (math.sin(cell.tilt), 0.0, math.cos(cell.tilt))
    loose: list[str] = []
    tendons: list[str] = []
    actuators: list[str] = []
    passive: list[str] = []
    sensors: list[str] = []
    links = ""
    for i in reversed(range(len(cell.inertia))):
        n = len(cell.inertia[i])
        weight = cell.of("weight", i)
        for m in range(n):
            name, inner = f"q{i + 1}_{m + 1}", ""
            last = m == n - 1
            for s in (h for h in cell.hidden if h.kind == "play" and h.axis == i and h.element == m):
                if s.numbers["joint"]:
                    half, light = s.numbers["gap"] / 2, 1e-3 * cell.inertia[i][m]
                    inner += _body(
                        f"play{i + 1}_{m}", light, "AXIS",
                        f'range="{-half} {half}" solreflimit="0.0006 1" solimplimit="0.9999 0.9999 0.001" '
                        f'damping="{1e-4 * cell.springs[i][m - 1] / 100}"',
                    )  # fmt: skip
            if last:
                mode = cell.of("mode", i)
                if mode is not None:
                    p = mode.numbers
                    hanging = f'stiffness="{p["stiffness"]}" damping="{p["damping"]}"'
                    inner += _body(f"mode{i + 1}", p["mass"], "AXIS", hanging)
                if i + 1 < len(cell.inertia) and cell.carried[i + 1]:
                    inner, links = inner + links, ""
            axis = direction if last and i > 0 else (0.0, 0.0, 1.0)
            axis = (0.0, 1.0, 0.0) if last and weight is not None else axis
            words = " ".join(map(str, axis))
            made = _body(
                name, cell.inertia[i][m], words, _rubbing(cell, i, m + 1), inner, weight if last else None
            )
            made = made.replace("AXIS", words)
            if last:
                links = made + links
            else:
                loose.append(made)
        tendons += [_spring(cell, i, s) for s in range(n - 1)]
        actuators.append(_drive(cell, i, production))
        passive.append(_passive(cell, i))
        sensors.append(
            f'<jointpos joint="q{i + 1}_1"/>'
            f'<actuatorfrc actuator="shake{i + 1}"/><actuatorfrc actuator="hold{i + 1}"/>'
        )
    base = cell.of("base")
    if base is not None:
        p = base.numbers
        links = _body(
            "base", p["mass"], "0 0 1", f'stiffness="{p["stiffness"]}" damping="{p["damping"]}"', links
        )
    return f"""<mujoco model="cell {cell.seed}"><compiler angle="radian"/>
    <option timestep="{1.0 / RATE / SUB}" gravity="0 0 {-G}" integrator="Euler">
    <flag contact="disable" eulerdamp="disable"/></option>
    <worldbody>{"".join(loose)}{links}</worldbody><tendon>{"".join(tendons)}</tendon>
    <actuator>{"".join([*reversed(actuators), *passive])}</actuator>
    <sensor>{"".join(reversed(sensors))}</sensor></mujoco>"""


def _body(
    name: str, inertia: float, axis: str, joint: str, inner: str = "", weight: Hidden | None = None
) -> str:
    mass, at, own = 1.0, "0 0 0", inertia
    if weight is not None:
        mass = 400.0 * inertia
        arm, angle = weight.numbers["torque"] / (mass * G), weight.numbers["angle"]
        at, own = f"{arm * math.sin(angle)} 0 {arm * math.cos(angle)}", inertia - mass * arm**2
    return (
        f'<body name="{name}"><inertial pos="{at}" mass="{mass}" diaginertia="{own} {own} {own}"/>'
        f'<joint name="{name}" axis="{axis}" {joint}/>{inner}</body>'
    )


def _rubbing(cell: Cell, axis: int, element: int) -> str:
    words = []
    for h in (h for h in cell.hidden if h.axis == axis and h.element == element):
        if h.kind == "viscous":
            words.append(f'damping="{h.numbers["damping"]}"')
        elif h.kind in ("soft dry", "hard dry"):
            words.append(f'frictionloss="{h.numbers["torque"]}"')
            if h.kind == "hard dry":
                words.append('solreffriction="0.0006 1" solimpfriction="0.9999 0.9999 0.001"')
    return " ".join(words)


def _spring(cell: Cell, i: int, s: int) -> str:
    k, c = cell.springs[i][s], cell.dampers[i][s]
    here = [h for h in cell.hidden if h.axis == i and h.element == s + 1]
    cubic = sum(h.numbers["cubic"] for h in here if h.kind == "cubic")
    joints = f'<joint joint="q{i + 1}_{s + 1}" coef="1"/><joint joint="q{i + 1}_{s + 2}" coef="-1"/>'
    plain = joints
    band = ""
    for h in (h for h in here if h.kind == "play"):
        if h.numbers["joint"]:
            joints += f'<joint joint="play{i + 1}_{s + 1}" coef="-1"/>'
        else:
            band = f'springlength="{-h.numbers["gap"] / 2} {h.numbers["gap"] / 2}"'
    out = f'<fixed name="s{i + 1}_{s + 1}" stiffness="{k} 0 {cubic}" damping="{c}" {band}>{joints}</fixed>'
    for h in (h for h in here if h.kind == "plastic"):
        p = h.numbers
        out += f'<fixed stiffness="{p["stiffness"]}" springyield="{p["yield"]}">{plain}</fixed>'
    return out


def _drive(cell: Cell, i: int, production: bool) -> str:
    hz, load = (5.0 if production else 0.25), cell.load(i)
    kp, kv = load * (2 * math.pi * hz) ** 2, 2 * 0.7 * load * 2 * math.pi * hz
    joint = f'joint="q{i + 1}_1"'
    lag, late = cell.of("lag", i), cell.of("delay", i)
    path = "" if lag is None else f'dyntype="filterexact" dynprm="{lag.numbers["seconds"]}"'
    if late is not None:
        buffer = math.ceil(late.numbers["seconds"] * RATE * SUB) + 2
        path += f' delay="{late.numbers["seconds"]}" interp="linear" nsample="{buffer}"'
    out = f'<general name="shake{i + 1}" {joint} {path}/>'
    return out + f'<position name="hold{i + 1}" {joint} kp="{kp}" kv="{kv}"/>'


def _passive(cell: Cell, i: int) -> str:
    """LuGre and cogging of a motor: actuators without an input, behind those that have one."""
    out = ""
    for h in (h for h in cell.hidden if h.axis == i and h.kind in ("lugre", "cogging")):
        p = h.numbers
        what = (
            f'cogging="{-p["torque"]} {p["poles"]} {p["phase"]}"' if h.kind == "cogging"
            else f'lugre="{p["stiffness"]} 0 {p["torque"]} {p["static"]} {p["stribeck"]}"'
        )  # fmt: skip
        out += f'<dcmotor joint="q{i + 1}_1" input="none" motorconst="0" resistance="1" {what}/>'
    return out


def measured(cell: Cell) -> list[Run]:
    """Every experiment of the cell: one an axis and one of all axes for validation; or four of production."""
    rng = np.random.default_rng([cell.seed, 40])
    axes = len(cell.inertia)
    if cell.motion == "production":
        return [_run(cell, rng, -1, "validate" if e == 3 else "identify") for e in range(4)]
    runs = [_run(cell, rng, i, "identify") for i in range(axes)]
    return [*runs, _run(cell, rng, -1 if axes > 1 else 0, "validate")]


def _wave(rng: np.random.Generator, motion: str) -> tuple[np.ndarray, np.ndarray]:
    """Shaking torque of rms 1 on the engine's steps, and its lines [Hz]."""
    if motion == "multisine":
        n = round(PERIOD * RATE * SUB)
        lines = np.arange(round(LOW * PERIOD), round(HIGH * PERIOD) + 1)
        best = None
        for _ in range(20):  # of a few phases the flattest
            spectrum = np.zeros(n // 2 + 1, dtype=complex)
            spectrum[lines] = np.exp(2j * np.pi * rng.random(lines.size)) / (1 + (lines / PERIOD / 15.0))
            wave = np.fft.irfft(spectrum, n)
            wave /= wave.std()
            if best is None or np.abs(wave).max() < np.abs(best).max():
                best = wave
        assert best is not None
        return np.tile(best, SETTLE + PERIODS), lines / PERIOD
    t = np.arange(round(LENGTH * RATE * SUB)) / (RATE * SUB)
    growth = np.log(HIGH / LOW) / LENGTH
    ends = np.clip(np.minimum(t, LENGTH - t) / 0.5, 0, 1)
    phase = 2 * np.pi * LOW * np.expm1(growth * t) / growth + rng.uniform(0, 6.28)
    return np.sqrt(2) * ends * np.sin(phase), np.zeros(0)


def _moves(rng: np.random.Generator) -> np.ndarray:
    """Reference of production: moves of least jerk from point to point, with pauses."""
    t = np.arange(round(LENGTH * RATE * SUB)) / (RATE * SUB)
    out, now, at = np.zeros(t.size), 0.0, 0.2
    while at < LENGTH:
        goal, lasts = float(rng.uniform(-0.8, 0.8)), float(rng.uniform(0.35, 1.0))
        x = np.clip((t - at) / lasts, 0, 1)
        out[t >= at] = now + (goal - now) * (x**3 * (10 - 15 * x + 6 * x**2))[t >= at]
        now, at = goal, at + lasts + float(rng.uniform(0.0, 0.4))
    return out


def _run(cell: Cell, rng: np.random.Generator, excited: int, role: str) -> Run:
    production = cell.motion == "production"
    model = mujoco.MjModel.from_xml_string(mjcf(cell, production))
    axes = len(cell.inertia)
    lines = np.zeros(0)
    seconds = PERIOD * (SETTLE + PERIODS) if cell.motion == "multisine" else LENGTH
    control = np.zeros((round(seconds * RATE * SUB), model.nu))
    for i in range(axes):
        shake, hold = (model.actuator(f"{w}{i + 1}").id for w in ("shake", "hold"))
        if production:
            control[:, hold] = _moves(rng)
        elif excited in (-1, i):
            wave, lines = _wave(rng, cell.motion)
            control[:, shake] = wave * cell.torque[i] * (1.0 if excited == i else 0.7)
        weight = cell.of("weight", i)
        if weight is not None:
            control[:, shake] -= weight.numbers["torque"] * math.sin(weight.numbers["angle"])
    data = mujoco.MjData(model)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, start, kind)
    # a sample's torque stands from its instant on, as a drive holds its command
    held = np.repeat(control[::SUB], SUB, axis=0)
    state, sensed = rollout.rollout(model, data, start[None], held[None])
    kept = slice(SUB - 1, None, SUB)
    q = state[0, kept, 1 : 1 + model.nq]
    v = state[0, kept, 1 + model.nq : 1 + model.nq + model.nv]
    # A drive reports the mean torque of its cycle, and the encoder at its end.
    forces = sensed[0].reshape(-1, SUB, sensed.shape[2]).mean(axis=1)
    sensed_all = sensed[0]
    sensed, held = sensed_all[kept], held[kept]
    if cell.motion == "multisine":
        first = round(SETTLE * PERIOD * RATE)
        q, v, sensed, forces, held = (x[first:] for x in (q, v, sensed, forces, held))
    assert np.isfinite(q).all(), f"cell {cell.seed}: the engine ran away"
    position, torque = sensed[:, 0::3].copy(), forces[:, 1::3] + forces[:, 2::3]
    for i in range(axes):
        path = cell.of("lag", i) or cell.of("delay", i)
        if path is not None:  # the drive reports its command, that which gave the hold's torque with it
            hold, late = sensed_all[:, 3 * i + 2], path.numbers["seconds"]
            t = np.arange(hold.size) / (RATE * SUB)
            hold = hold + late * np.gradient(hold, t) if path.kind == "lag" else np.interp(t + late, t, hold)
            hold = hold.reshape(-1, SUB).mean(axis=1)[-held.shape[0] :]
            torque[:, i] = held[:, model.actuator(f"shake{i + 1}").id] + hold
    position = np.round(position / cell.count) * cell.count
    torque = torque + rng.normal(0.0, cell.noise, torque.shape)
    torque = np.round(torque / cell.step) * cell.step
    period = round(PERIOD * RATE) if cell.motion == "multisine" else 0
    kinds = {"multisine": "multisine", "chirp": "chirp", "production": "other"}
    names = tuple(model.joint(j).name for j in range(model.njnt))
    return Run(kinds[cell.motion], excited, role, lines, period, position, torque, q, v, names)


def write(cell: Cell, runs: list[Run], path: Path) -> None:
    """The recording, by h5py alone."""
    axes = len(cell.inertia)
    with h5py.File(path, "w") as f:
        top: dict[str, Any] = {
            "format": "invid-recording", "format_version": 1, "created": "2026-11-25T10:00:00Z",
            "robot": f"MuJoCo cell {cell.seed}", "axes": json.dumps(cell.axes), "position_unit": "rad",
            "torque_unit": "N·m", "masses_per_axis": [len(m) for m in cell.inertia],
            "rated_torque": [2.0 * t for t in cell.torque], "encoder_resolution": list(cell.count),
            "outcome": "completed",
        }  # fmt: skip
        f.attrs.update(top)
        for e, run in enumerate(runs):
            g = f.create_group(f"experiments/{e:03d}")
            own: dict[str, Any] = {
                "kind": run.kind, "excited_axis": run.excited, "role": run.role,
                "hold_gain": [math.nan] * axes, "period_samples": run.period, "frequencies_hz": run.lines,
                "sample_rate_hz": float(RATE), "torque_source": "measured",
            }  # fmt: skip
            g.attrs.update(own)
            g["time"] = np.arange(run.position.shape[0]) / RATE
            g["position"], g["torque"] = run.position, run.torque
