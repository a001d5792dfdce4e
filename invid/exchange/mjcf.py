"""MuJoCo's MJCF, written by its own spec writer.

One joint a coordinate, in the order of axes and masses; its position is the absolute position of that mass.
MuJoCo keeps the mass matrix sparse along the tree of bodies, so the bodies are nested, next to massless, and
the inertia stands in the joints (``armature``): there the nesting changes nothing, and the couplings, as
armature of tendons, have their places in the matrix. The mass matrix is L·diag(d)·Lᵀ; a column k of L with
more than its diagonal gives the coefficients of a tendon with armature d_k: that holds couplings of either
sign for every mass matrix. Springs and dampers are tendons with coefficients 1 and −1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from invid.exchange.linear_plant import LinearPlant, ParameterSpread, effect_losses, loss_comment
from invid.model.document import EffectTerm
from invid.numerics.arrays import Float64

MASSLESS = 1e-9
"""Inertia of a body over the smallest inertia of a joint: it enters the mass matrix n² times at most."""
LIGHTEST = 1e-14
"""MuJoCo takes nothing below 1e-15."""
STEPS_A_PERIOD = 60
"""Steps of the integrator (Runge–Kutta, 4th order) in a period at 1.5 times the highest mode: its phase is
off by 1e-6 there, and it adds 1e-7 to a damping ratio."""

_Numbers = dict[tuple[str, str], dict[str, float]]


def content(plant: LinearPlant, _spread: ParameterSpread, *, robot: str, losses: list[str]) -> bytes:
    """The MJCF document (XML)."""
    spec = mujoco.MjSpec()
    spec.modelname = robot or "invid"
    spec.option.gravity = [0.0, 0.0, 0.0]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.timestep = time_step(float(plant.modes[-1]))
    # Dry friction has no place in a linear answer: it stands in the joints, for whoever takes the flag away.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)
    exact: _Numbers = {}
    columns, weights = factors(plant.mass)
    joints = _joints(plant, columns, weights)
    light = max(MASSLESS * min(weights[weights > 0].min(), np.diag(plant.mass).min()), LIGHTEST)
    kind = mujoco.mjtJoint.mjJNT_SLIDE if plant.linear_axes else mujoco.mjtJoint.mjJNT_HINGE
    parent = spec.worldbody
    for name, numbers in joints.items():
        body = parent.add_body(
            name=name, mass=light, inertia=[light] * 3, ipos=[0.0] * 3, explicitinertial=True
        )
        joint = body.add_joint(name=name, type=kind, axis=[0.0, 0.0, 1.0])
        _set(joint, "joint", name, numbers, exact)
        parent = body
    for name, (pattern, numbers) in _tendons(plant, columns, weights).items():
        tendon = spec.add_tendon(name=name)
        for coordinate, coefficient in pattern.items():
            tendon.wrap_joint(coordinate, coefficient)
        _set(tendon, "fixed", name, numbers, exact)
        exact[("fixed", name)].update({f"coef {c}": v for c, v in pattern.items()})
    for i, axis in enumerate(plant.axes):
        motor = plant.coordinates[plant.motors[i]]
        actuator = spec.add_actuator(name=axis, target=motor, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gainprm[0] = plant.gain[i]
        exact[("general", axis)] = {"gainprm": float(plant.gain[i])}
        if plant.lag[i] > 0.0:
            actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
            actuator.dynprm[0] = plant.lag[i]
            exact[("general", axis)]["dynprm"] = float(plant.lag[i])
        limit = _limit(plant, axis)
        if math.isfinite(limit):
            actuator.forcerange = [-limit, limit]
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        for what, sensor in (
            ("position", mujoco.mjtSensor.mjSENS_JOINTPOS),
            ("velocity", mujoco.mjtSensor.mjSENS_JOINTVEL),
        ):
            spec.add_sensor(
                name=f"{axis}.{what}", type=sensor, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=motor
            )
    spec.compile()
    return _exactly(spec.to_xml(), exact, losses).encode()


def losses(plant: LinearPlant) -> list[str]:
    """What MJCF does not hold of the plant, or not as part of its linear answer."""
    return effect_losses(plant, _own_way)


def _own_way(term: EffectTerm) -> str | None:
    if term.cause == "coulomb_friction":
        return (
            "stands in its joint as frictionloss, switched off: take out <flag frictionloss> to simulate it"
        )
    if term.cause == "torque_saturation":
        return "stands in its actuator as forcerange"
    return None


def time_step(highest: float) -> float:
    """A round step [s] for modes up to ``highest`` [rad/s], a millisecond at most."""
    if highest <= 0.0:
        return 1e-3
    largest = 2.0 * math.pi / (1.5 * highest * STEPS_A_PERIOD)
    digit = 10.0 ** math.floor(math.log10(largest))
    return min(1e-3, float(f"{next(f for f in (5.0, 2.0, 1.0) if f * digit <= largest) * digit:.0e}"))


def factors(mass: Float64) -> tuple[Float64, Float64]:
    """L (n, n), unit lower triangular, and d (n,) > 0 with L·diag(d)·Lᵀ = mass."""
    root = np.linalg.cholesky(mass)
    diagonal = np.diag(root)
    lower: Float64 = root / diagonal
    weights: Float64 = diagonal**2
    return lower, weights


def _joints(plant: LinearPlant, columns: Float64, weights: Float64) -> dict[str, dict[str, float]]:
    """Armature, damping, stiffness, frictionloss of each joint by its name."""
    ground = plant.damping.sum(axis=1), plant.stiffness.sum(axis=1)
    dry = np.zeros(len(plant.coordinates))
    for left in plant.nonlinear:
        if left.term.cause == "coulomb_friction" and not left.reason:
            q = int((left.term.element or "mass 1").split()[1])
            at = plant.motors[plant.axes.index(left.term.axis)] + q - 1
            dry[at] += abs(left.term.value("torque"))
    made = {}
    for k, name in enumerate(plant.coordinates):
        alone = not np.any(columns[k + 1 :, k])
        made[name] = {
            "armature": float(weights[k]) if alone else 0.0,
            "damping": _beyond_rounding(ground[0][k], plant.damping[k]),
            "stiffness": _beyond_rounding(ground[1][k], plant.stiffness[k]),
            "frictionloss": float(dry[k]),
        }
    return made


def _tendons(
    plant: LinearPlant, columns: Float64, weights: Float64
) -> dict[str, tuple[dict[str, float], dict[str, float]]]:
    """Coefficients by joint, and the tendon's numbers, by its name."""
    made: dict[str, tuple[dict[str, float], dict[str, float]]] = {}
    names = plant.coordinates
    for a in range(len(names)):
        for b in range(a + 1, len(names)):
            stiffness, damping = -plant.stiffness[a, b], -plant.damping[a, b]
            if stiffness or damping:
                pattern = {names[a]: 1.0, names[b]: -1.0}
                numbers = {"stiffness": float(stiffness), "damping": float(damping)}
                made[f"{names[a]}-{names[b]}"] = (pattern, numbers)
    for k, name in enumerate(names):
        if np.any(columns[k + 1 :, k]):
            pattern = {names[j]: float(columns[j, k]) for j in range(k, len(names)) if columns[j, k]}
            made[f"{name} inertia"] = (pattern, {"armature": float(weights[k])})
    return made


def _beyond_rounding(total: float, row: Float64) -> float:
    """The part of a row's sum that goes to ground: nothing where it is rounding."""
    return float(total) if abs(total) > 1e-12 * float(np.abs(row).max(initial=0.0)) else 0.0


def _limit(plant: LinearPlant, axis: str) -> float:
    limits = [
        abs(left.term.value("limit"))
        for left in plant.nonlinear
        if left.term.cause == "torque_saturation" and left.term.axis == axis and not left.reason
    ]
    return min(limits, default=math.inf)


def _set(element: Any, tag: str, name: str, numbers: Mapping[str, float], exact: _Numbers) -> None:
    """Numbers of a joint or tendon; where MuJoCo has a polynomial, its first coefficient."""
    exact[(tag, name)] = {k: v for k, v in numbers.items() if v}
    for key, value in numbers.items():
        if isinstance(getattr(element, key), np.ndarray):
            getattr(element, key)[0] = value
        else:
            setattr(element, key, value)


def _exactly(text: str, exact: _Numbers, losses: list[str]) -> str:
    """The writer's XML with every number in full (it prints six digits) and the losses in a comment."""
    root = ElementTree.fromstring(text)
    if losses:
        root.insert(0, loss_comment(losses))
    for (tag, name), numbers in exact.items():
        element = next(e for e in root.iter(tag) if e.get("name") == name)
        for key, value in numbers.items():
            kind, _, joint = key.partition(" ")
            place = element
            if joint:
                place = next(e for e in element.iter("joint") if e.get("joint") == joint)
            if place.get(kind) is not None:
                place.set(kind, repr(value))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"
