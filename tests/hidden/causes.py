"""Every hidden cause: where it may sit, how its size is drawn, how it enters the plant.

``range`` bounds the factor on the drawn size; ``motors`` is the least number of axes it needs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hidden.integrator import Law
from hidden.plants import Plant

Law_ = tuple[Law, int, int, tuple[float, ...]]
Built = tuple[np.ndarray, np.ndarray, np.ndarray, list[Law_]]


@dataclass(frozen=True, eq=False)
class Scales:
    """Rms motion of the linear plant and the plan's times, to draw sizes that matter from."""

    position: np.ndarray  # (dofs,)
    velocity: np.ndarray  # (dofs,)
    pair: np.ndarray  # (dofs, dofs) rms of the difference
    command: np.ndarray  # (M,) rms torque
    peak: np.ndarray  # (M,)
    rate: float
    duration: float
    period: float
    spans: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Cause:
    """One mechanism."""

    name: str
    where: str  # "mass", "motor", "spring", "load", "axis", "axes"
    draw: Callable[..., dict[str, float]]
    enter: Callable[..., Built]
    scaled: tuple[str, ...]
    range: tuple[float, float] = (1e-4, 30.0)
    motors: int = 1
    rotary: bool = False
    alone: bool = False
    resize_with: Callable[[dict[str, float], float], dict[str, float]] | None = None

    def place(self, rng: np.random.Generator, plant: Plant) -> tuple[int, int, int]:
        """Axis (from 0), element (from 1, 0 none), other axis (−1 none), drawn."""
        axis = int(rng.integers(plant.count))
        n = len(plant.chains.masses[axis])
        other = -1
        if self.where == "axes":
            axis, other = sorted(int(i) for i in rng.choice(plant.count, 2, replace=False))
            return axis, 0, other
        if self.where == "mass":
            return axis, 1 if rng.uniform() < 0.6 else int(rng.integers(1, n + 1)), other
        if self.where == "any_mass":
            return axis, int(rng.integers(1, n + 1)), other
        if self.where == "base":
            return axis, 0, other
        if self.where == "spring":
            return axis, int(rng.integers(1, n)), other
        return axis, {"motor": 1, "load": n, "axis": 0}[self.where], other

    def element_name(self, plant: Plant, axis: int, element: int) -> str | None:
        """As the contract writes it; None where any element (or none) is right."""
        if self.where == "any_mass" and plant.count == 1:
            return None  # seen from one motor, a side branch at any mass makes the same poles and zeros
        if self.where in ("mass", "any_mass"):
            return f"mass {element}"
        if self.where == "spring":
            return f"spring {element}"
        return None

    def resize(self, parameters: dict[str, float], factor: float) -> dict[str, float]:
        """Parameters of the same effect, ``factor`` times as large."""
        if self.resize_with is not None:
            parameters = self.resize_with(parameters, factor)
        else:
            parameters = {k: v * factor if k in self.scaled else v for k, v in parameters.items()}
        return {k: float(v) for k, v in parameters.items()}

    def build(
        self, plant: Plant, m: Any, c: Any, k: Any, axis: int, element: int, other: int, p: Any
    ) -> Built:
        """Matrices and laws with the effect in."""
        return self.enter(plant, m, c, k, axis, element, other, p)

    def pairs_with(self, first: Cause) -> bool:
        """Whether both at once can be told apart at all."""
        return self.name != first.name and not self.alone and self.where != first.where


def _law(law: Law, *names: str) -> Callable[..., Built]:
    """A law on the mass (or motor number, for actuators) at the place, parameters in this order."""

    def enter(plant: Plant, m: Any, c: Any, k: Any, axis: int, element: int, other: int, p: Any) -> Built:
        if Law.SATURATION <= law <= Law.ECCENTRICITY:
            a, b = axis, -1
        else:
            a = plant.dof(axis, max(element, 1))
            b = -1
        return m, c, k, [(law, a, b, tuple(p[n] for n in names))]

    return enter


def _pair_law(law: Law, *names: str) -> Callable[..., Built]:
    """A law of the spring at the place; ``K`` and ``D`` stand for its stiffness and damping."""

    def enter(plant: Plant, m: Any, c: Any, k: Any, axis: int, element: int, other: int, p: Any) -> Built:
        a = plant.dof(axis, element)
        own = {"K": plant.chains.springs[axis][element - 1], "D": plant.chains.dampers[axis][element - 1]}
        return m, c, k, [(law, a, a + 1, tuple(p[n] if n in p else float(own[n]) for n in names))]

    return enter


def _cross_law(law: Law, *names: str) -> Callable[..., Built]:
    """A law between the final masses of two axes."""

    def enter(plant: Plant, m: Any, c: Any, k: Any, axis: int, element: int, other: int, p: Any) -> Built:
        return m, c, k, [(law, int(plant.ends[axis]), int(plant.ends[other]), tuple(p[n] for n in names))]

    return enter


def _viscous(plant: Plant, m: Any, c: Any, k: Any, axis: int, element: int, other: int, p: Any) -> Built:
    c = c.copy()
    a = plant.dof(axis, element)
    c[a, a] += p["coefficient"]
    return m, c, k, []


def _spring_damping(
    plant: Plant, m: Any, c: Any, k: Any, axis: int, element: int, other: int, p: Any
) -> Built:
    c = c.copy()
    a = plant.dof(axis, element)
    c[a : a + 2, a : a + 2] += p["coefficient"] * np.array([[1, -1], [-1, 1]])
    return m, c, k, []


def _coupling(plant: Plant, m: Any, c: Any, k: Any, axis: int, element: int, other: int, p: Any) -> Built:
    k = k.copy()
    at = np.ix_([plant.ends[axis], plant.ends[other]], [plant.ends[axis], plant.ends[other]])
    k[at] += p["stiffness"] * np.array([[1, -1], [-1, 1]])
    return m, c, k, []


def _extra_mode(plant: Plant, m: Any, c: Any, k: Any, axis: int, element: int, other: int, p: Any) -> Built:
    a, n = plant.dof(axis, element), m.shape[0]

    def grow(x: np.ndarray) -> np.ndarray:
        out = np.zeros((n + 1, n + 1))
        out[:n, :n] = x
        return out

    m, c, k = grow(m), grow(c), grow(k)
    m[n, n] = p["mass"]
    at = np.ix_([a, n], [a, n])
    k[at] += p["stiffness"] * np.array([[1, -1], [-1, 1]])
    c[at] += 0.02 * np.sqrt(p["stiffness"] * p["mass"]) * np.array([[1, -1], [-1, 1]])
    return m, c, k, []


def _base(plant: Plant, m: Any, c: Any, k: Any, axis: int, element: int, other: int, p: Any) -> Built:
    """The loads' inertia is that of their own motion and their share of the base's, coordinate n."""
    n, ends = m.shape[0], list(plant.ends)
    own = np.zeros((plant.count, n + 1))
    own[range(plant.count), ends] = 1.0
    own[:, n] = [p[f"share_{i + 1}"] for i in range(plant.count)]
    m, c, k = (np.pad(x, (0, 1)) for x in (m, c, k))
    inertia = m[np.ix_(ends, ends)].copy()
    m[np.ix_(ends, ends)] -= inertia
    m += own.T @ inertia @ own
    m[n, n] += p["mass"]
    k[n, n] += p["stiffness"]
    c[n, n] += 0.04 * np.sqrt(p["stiffness"] * m[n, n])
    return m, c, k, []


def _nothing(plant: Plant, m: Any, c: Any, k: Any, axis: int, element: int, other: int, p: Any) -> Built:
    return m, c, k, []


# --- sizes ------------------------------------------------------------------------------------------
def _torque(share: float) -> Callable[..., dict[str, float]]:
    def draw(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
        return {"torque": share * s.peak[axis]}

    return draw


def _draw_viscous(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    return {"coefficient": 0.05 * s.peak[axis] / s.velocity[plant.dof(axis, element)]}


def _draw_stribeck(
    rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int
) -> dict[str, float]:
    coulomb = 0.04 * s.peak[axis]
    return {
        "static": coulomb * rng.uniform(1.4, 2.5),
        "coulomb": coulomb,
        "velocity": s.velocity[plant.dof(axis, element)] * rng.uniform(0.1, 0.4),
    }


def _draw_presliding(
    rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int
) -> dict[str, float]:
    torque = 0.05 * s.peak[axis]
    return {
        "stiffness": torque / (s.position[plant.dof(axis, element)] * rng.uniform(0.15, 0.7)),
        "torque": torque,
    }


def _draw_asymmetric(
    rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int
) -> dict[str, float]:
    base = 0.05 * s.peak[axis]
    viscous = 0.03 * s.peak[axis] / s.velocity[plant.dof(axis, element)]
    c = (base, base * rng.uniform(0.3, 0.7))
    b = (viscous, viscous * rng.uniform(0.3, 0.8))
    c, b = (c[::-1] if rng.uniform() < 0.5 else c), (b[::-1] if rng.uniform() < 0.5 else b)
    return {
        "coulomb_positive": c[0],
        "coulomb_negative": c[1],
        "viscous_positive": b[0],
        "viscous_negative": b[1],
    }


def _cycles(rng: Any, rms: float) -> float:
    """Whole cycles a revolution, such that the rms motion is 0.5 to 2.5 rad of phase."""
    return float(max(2, round(rng.uniform(0.5, 2.5) / rms)))


def _draw_cogging(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    return {
        "torque": 0.05 * s.peak[axis],
        "cycles_per_rev": _cycles(rng, s.position[plant.dof(axis, 1)]),
        "phase": float(rng.uniform(-np.pi, np.pi)),
    }


def _draw_offset(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    return {"torque": 0.05 * s.peak[axis] * float(rng.choice([-1.0, 1.0]))}


def _draw_te(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    a = plant.dof(axis, element)
    return {
        "amplitude": 0.05 * s.pair[a, a + 1],
        "cycles_per_rev": _cycles(rng, s.position[a]),
        "phase": float(rng.uniform(-np.pi, np.pi)),
    }


def _draw_hysteresis(
    rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int
) -> dict[str, float]:
    a = plant.dof(axis, element)
    torque = 0.1 * plant.chains.springs[axis][element - 1] * s.pair[a, a + 1]
    return {"stiffness": torque / (s.pair[a, a + 1] * rng.uniform(0.15, 0.6)), "torque": torque}


def _draw_cubic(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    a = plant.dof(axis, element)
    return {"coefficient": 0.05 * plant.chains.springs[axis][element - 1] / s.pair[a, a + 1] ** 2}


def _draw_backlash(
    rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int
) -> dict[str, float]:
    a = plant.dof(axis, element)
    return {"gap": 0.1 * s.pair[a, a + 1]}


def _draw_spring_damping(
    rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int
) -> dict[str, float]:
    return {"coefficient": 2.0 * plant.chains.dampers[axis][element - 1]}


def _draw_gravity(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    return {"torque": 0.1 * s.peak[axis], "angle": float(rng.uniform(-np.pi, np.pi))}


def _draw_extra(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    mass = 0.05 * plant.chains.masses[axis][element - 1]
    return {"mass": mass, "stiffness": mass * (2 * np.pi * rng.uniform(2.5, 9.0)) ** 2}


def _draw_base(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    """Five times as heavy as the loads, moving as one axis does and in part as the others."""
    mass = 5.0 * sum(float(m[-1]) for m in plant.chains.masses)
    shares = rng.uniform(-0.9, 0.9, plant.count)
    shares[axis] = 1.0
    own = {f"share_{i + 1}": float(share) for i, share in enumerate(shares)}
    return {"mass": mass, "stiffness": mass * (2 * np.pi * rng.uniform(2.5, 9.0)) ** 2, **own}


def _resize_base(p: dict[str, float], factor: float) -> dict[str, float]:
    """Factor 1 is the base as drawn; a lighter one moves more."""
    return {n: v if n.startswith("share") else v / factor for n, v in p.items()}


def _draw_coupling(
    rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int
) -> dict[str, float]:
    ends = min(plant.chains.masses[axis][-1], plant.chains.masses[other][-1])
    return {"stiffness": 0.05 * ends * (2 * np.pi * 3.0) ** 2}


def _draw_payload(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    """Between two experiments, or in the midst of one that is not the first."""
    between = len(s.spans) > 1 and rng.uniform() < 0.5
    number = (
        int(rng.integers(0, len(s.spans) - 1))
        if between
        else int(rng.integers(min(1, len(s.spans) - 1), len(s.spans)))
    )
    start, end = s.spans[number]
    when = end + 0.3 if between else start + rng.uniform(0.3, 0.7) * (end - start)
    return {"mass": 0.05 * plant.chains.masses[axis][-1], "time": float(when)}


def _draw_drift(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    return {"rate": -0.05 * plant.chains.springs[axis][element - 1] / s.duration}


def _resize_gain(p: dict[str, float], factor: float) -> dict[str, float]:
    return {"gain": 1.0 + (p["gain"] - 1.0) * factor}


def _resize_limit(p: dict[str, float], factor: float) -> dict[str, float]:
    """Factor 1 is a limit at ``limit``; the deeper the cut, the larger."""
    return {"limit": p["limit"] * factor**-0.15}


def _resize_delay(p: dict[str, float], factor: float) -> dict[str, float]:
    return {"delay": p["delay"] * factor}


CATALOGUE: dict[str, Cause] = {
    c.name: c
    for c in (
        Cause(
            "coulomb_friction",
            "mass",
            _torque(0.05),
            lambda plant, m, c, k, axis, element, other, p: (
                m,
                c,
                k,
                [(Law.DRY, plant.dof(axis, element), -1, (p["torque"], p["torque"], 0.0, 0.0))],
            ),
            ("torque",),
            (1e-4, 6.0),
        ),
        Cause("viscous_friction", "mass", _draw_viscous, _viscous, ("coefficient",)),
        Cause(
            "stribeck_friction",
            "mass",
            _draw_stribeck,
            _law(Law.STRIBECK, "static", "coulomb", "velocity"),
            ("static", "coulomb"),
            (1e-4, 4.0),
        ),
        Cause(
            "presliding_friction",
            "mass",
            _draw_presliding,
            _law(Law.BRISTLE, "stiffness", "torque"),
            ("stiffness", "torque"),
            (1e-4, 6.0),
        ),
        Cause(
            "asymmetric_friction",
            "mass",
            _draw_asymmetric,
            _law(Law.DRY, "coulomb_positive", "coulomb_negative", "viscous_positive", "viscous_negative"),
            ("coulomb_positive", "coulomb_negative", "viscous_positive", "viscous_negative"),
            (1e-4, 5.0),
        ),
        Cause(
            "torque_offset", "motor", _draw_offset, _law(Law.CONSTANT, "torque"), ("torque",), (1e-3, 10.0)
        ),
        Cause(
            "cogging",
            "motor",
            _draw_cogging,
            _law(Law.RIPPLE, "torque", "cycles_per_rev", "phase"),
            ("torque",),
            (1e-4, 5.0),
        ),
        Cause(
            "torque_delay",
            "axis",
            lambda rng, plant, s, axis, element, other: {"delay": 2.0 / s.rate},
            _law(Law.DELAY, "delay"),
            ("delay",),
            (0.7, 6.0),
            resize_with=_resize_delay,
        ),
        Cause(
            "torque_lag",
            "axis",
            lambda rng, plant, s, axis, element, other: {"time_constant": 2.0 / s.rate},
            _law(Law.LAG, "time_constant"),
            ("time_constant",),
            (0.2, 8.0),
        ),
        Cause(
            "torque_gain",
            "axis",
            lambda rng, plant, s, axis, element, other: {"gain": 1.0 + float(rng.choice([-0.05, 0.05]))},
            _law(Law.GAIN, "gain"),
            ("gain",),
            (1e-3, 8.0),
            motors=2,
            resize_with=_resize_gain,
        ),
        Cause(
            "torque_saturation",
            "axis",
            lambda rng, plant, s, axis, element, other: {"limit": 1.8 * s.command[axis]},
            _law(Law.SATURATION, "limit"),
            ("limit",),
            (0.01, 30.0),
            resize_with=_resize_limit,
        ),
        Cause(
            "encoder_eccentricity",
            "axis",
            lambda rng, plant, s, axis, element, other: {
                "amplitude": 0.01,
                "phase": float(rng.uniform(-np.pi, np.pi)),
            },
            _law(Law.ECCENTRICITY, "amplitude", "phase"),
            ("amplitude",),
            (1e-3, 10.0),
            rotary=True,
        ),
        Cause(
            "dropped_samples",
            "axis",
            lambda rng, plant, s, axis, element, other: {
                "fraction": float(np.exp(rng.uniform(np.log(0.002), np.log(0.1))))
            },
            _nothing,
            (),
            (1.0, 1.0),
            alone=True,
        ),
        Cause(
            "spring_damping", "spring", _draw_spring_damping, _spring_damping, ("coefficient",), (0.1, 10.0)
        ),
        Cause(
            "cubic_stiffness",
            "spring",
            _draw_cubic,
            _pair_law(Law.CUBIC_SPRING, "coefficient"),
            ("coefficient",),
            (1e-4, 10.0),
        ),
        Cause(
            "backlash",
            "spring",
            _draw_backlash,
            _pair_law(Law.BACKLASH, "gap", "K", "D"),
            ("gap",),
            (1e-4, 15.0),
        ),
        Cause(
            "spring_hysteresis",
            "spring",
            _draw_hysteresis,
            _pair_law(Law.SPRING_SLIDER, "stiffness", "torque"),
            ("stiffness", "torque"),
            (1e-4, 4.0),
        ),
        Cause(
            "transmission_error",
            "spring",
            _draw_te,
            _pair_law(Law.TRANSMISSION_ERROR, "amplitude", "cycles_per_rev", "phase", "K"),
            ("amplitude",),
            (1e-4, 6.0),
        ),
        Cause(
            "gravity",
            "load",
            _draw_gravity,
            lambda plant, m, c, k, axis, element, other, p: (
                m,
                c,
                k,
                [(Law.RIPPLE, int(plant.ends[axis]), -1, (p["torque"], 1.0, p["angle"]))],
            ),
            ("torque",),
            (1e-4, 8.0),
            rotary=True,
        ),
        Cause("extra_mode", "any_mass", _draw_extra, _extra_mode, ("mass", "stiffness"), (1e-3, 8.0)),
        Cause(
            "coupling_stiffness", "axes", _draw_coupling, _coupling, ("stiffness",), (1e-4, 10.0), motors=2
        ),
        Cause(
            "payload_change",
            "load",
            _draw_payload,
            _law(Law.ADDED_MASS, "mass", "time"),
            ("mass",),
            (1e-3, 10.0),
            alone=True,
        ),
        Cause(
            "parameter_drift",
            "spring",
            _draw_drift,
            _pair_law(Law.STIFFNESS_DRIFT, "rate"),
            ("rate",),
            (1e-3, 8.0),
            alone=True,
        ),
    )
}


def _draw_deflection_damping(
    rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int
) -> dict[str, float]:
    """As strong as a damper of twice the spring's own at the rms deflection."""
    a = plant.dof(axis, element)
    own = plant.chains.dampers[axis][element - 1]
    return {"coefficient": 2.0 * own / s.pair[a, a + 1] ** 2}


def _draw_worn_place(
    rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int
) -> dict[str, float]:
    """Drag around one place of the travel."""
    a = plant.dof(axis, element)
    return {
        "coefficient": 0.1 * s.peak[axis] / s.velocity[a],
        "position": s.position[a] * float(rng.uniform(-1, 1)),
        "width": s.position[a] * float(rng.uniform(0.6, 1.5)),
    }


TWO: dict[str, Cause] = {
    c.name: c
    for c in (
        Cause(
            "deflection_damping",
            "spring",
            _draw_deflection_damping,
            _pair_law(Law.DEFLECTION_DAMPING, "coefficient"),
            ("coefficient",),
            (1e-3, 10.0),
            alone=True,
        ),
        Cause(
            "worn_place",
            "mass",
            _draw_worn_place,
            _law(Law.WORN_PLACE, "coefficient", "position", "width"),
            ("coefficient",),
            (1e-3, 8.0),
            alone=True,
        ),
    )
}
"""Laws over two quantities of one place, by name alone as well."""


BASE = Cause(
    "base_compliance", "base", _draw_base, _base, ("mass", "stiffness"), (0.02, 8.0), resize_with=_resize_base
)
"""By name alone, not among those that ``make_case`` draws from."""


# --- outside the catalogue ----------------------------------------------------------------------------
def _draw_drag(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    """Power 3 and more: at most 60 % of it looks viscous, none of it like dry friction."""
    power = float(rng.uniform(3.0, 4.0))
    return {
        "coefficient": 0.03 * s.peak[axis] / (s.velocity[plant.dof(axis, element)] * 1.5) ** power,
        "power": power,
    }


def _draw_cross(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    return {"coefficient": 0.05 * s.peak[axis] / s.velocity[plant.ends[other]] ** 2}


def _draw_periodic(
    rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int
) -> dict[str, float]:
    """On a line of the record (elsewhere it would be noise): a fan, a neighbouring machine."""
    line = int(rng.integers(8, 40))
    force = 0.02 * s.peak[axis]
    return {
        "force": force,
        "hertz": line / s.period,
        "phase": float(rng.uniform(-3, 3)),
        "third": force * float(rng.uniform(0.2, 0.6)),
    }


def _draw_turning(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    return {"inertia": 0.1 * plant.chains.masses[axis][-1], "phase": float(rng.uniform(1.2, 1.9))}


def _draw_position_damping(
    rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int
) -> dict[str, float]:
    a = plant.dof(axis, element)
    return {"coefficient": 0.05 * s.peak[axis] / (s.velocity[a] * s.position[a])}


def _draw_saturating(
    rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int
) -> dict[str, float]:
    amplitude = s.pair[plant.ends[axis], plant.ends[other]]
    force = 0.05 * min(s.peak[axis], s.peak[other])
    return {"stiffness": force * 10.0 / amplitude, "force": force}


def _draw_impact(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    a = plant.dof(axis, element)
    duration = float(rng.uniform(0.02, 0.06))
    return {
        "impulse": 0.3 * s.peak[axis] * duration,
        "position": s.position[a] * float(rng.uniform(-1, 1)),
        "duration": duration,
    }


def _draw_stop(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    at = s.position[plant.dof(axis, 1)] * float(rng.uniform(0.7, 1.3))
    return {"stiffness": 0.2 * s.peak[axis] / s.position[plant.dof(axis, 1)], "position": at}


def _draw_gyro(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    return {
        "coefficient": 0.05
        * min(s.peak[axis], s.peak[other])
        / max(s.velocity[plant.ends[axis]], s.velocity[plant.ends[other]])
    }


def _draw_square(rng: Any, plant: Plant, s: Scales, axis: int, element: int, other: int) -> dict[str, float]:
    a = plant.dof(axis, element)
    return {"coefficient": 0.05 * plant.chains.springs[axis][element - 1] / s.pair[a, a + 1]}


OUTSIDE: dict[str, Cause] = {
    c.name: c
    for c in (
        Cause(
            "power_drag",
            "mass",
            _draw_drag,
            _law(Law.POWER_DRAG, "coefficient", "power"),
            ("coefficient",),
            (1e-3, 8.0),
        ),
        Cause(
            "cross_drag",
            "axes",
            _draw_cross,
            _cross_law(Law.CROSS_DRAG, "coefficient"),
            ("coefficient",),
            (1e-3, 8.0),
            motors=2,
        ),
        Cause(
            "time_periodic",
            "load",
            _draw_periodic,
            _law(Law.TIME_PERIODIC, "force", "hertz", "phase", "third"),
            ("force", "third"),
            (1e-3, 8.0),
        ),
        Cause(
            "turning_inertia",
            "load",
            _draw_turning,
            _law(Law.TURNING_INERTIA, "inertia", "phase"),
            ("inertia",),
            (1e-3, 8.0),
            rotary=True,
        ),
        Cause(
            "position_damping",
            "mass",
            _draw_position_damping,
            lambda plant, m, c, k, axis, element, other, p: (
                m,
                c,
                k,
                [
                    (
                        Law.POSITION_DAMPING,
                        plant.dof(axis, element),
                        plant.dof(axis, element),
                        (p["coefficient"],),
                    )
                ],
            ),
            ("coefficient",),
            (1e-3, 4.0),
        ),
        Cause(
            "saturating_spring",
            "axes",
            _draw_saturating,
            _cross_law(Law.SATURATING_SPRING, "stiffness", "force"),
            ("stiffness", "force"),
            (1e-3, 6.0),
            motors=2,
        ),
        Cause(
            "impact",
            "mass",
            _draw_impact,
            _law(Law.IMPACT, "impulse", "position", "duration"),
            ("impulse",),
            (1e-3, 10.0),
        ),
        Cause(
            "end_stop",
            "motor",
            _draw_stop,
            _law(Law.END_STOP, "stiffness", "position"),
            ("stiffness",),
            (1e-3, 20.0),
        ),
        Cause(
            "gyroscopic",
            "axes",
            _draw_gyro,
            _cross_law(Law.GYROSCOPIC, "coefficient"),
            ("coefficient",),
            (1e-3, 8.0),
            motors=2,
        ),
        Cause(
            "square_spring",
            "spring",
            _draw_square,
            _pair_law(Law.SQUARE_SPRING, "coefficient"),
            ("coefficient",),
            (1e-3, 4.0),
        ),
    )
}
for _cause in OUTSIDE.values():
    object.__setattr__(_cause, "alone", True)


def available(causes: dict[str, Cause], motors: int, linear: bool) -> list[str]:
    """Names that a plant of this kind can have."""
    return [n for n, c in causes.items() if c.motors <= motors and not (linear and c.rotary)]
