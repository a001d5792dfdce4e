"""A URDF as a simulator, run by MuJoCo, and its corrected copy as a URDF.

The drive convention is the URDF's own: a ``<transmission>`` of one joint and one actuator says which joint
an axis' motor drives, its ``<mechanicalReduction>`` n that the motor, where torque and position are recorded,
turns n times as far with an n-th of the torque. What URDF has no element for is taken from where other
tools put it: stiffness of a joint from Gazebo's ``<springStiffness>``, the rotor's inertia at the motor from
Drake's ``<drake:rotor_inertia>``. Joints that no axis drives and no spring holds are locked; what follows
another by ``<mimic>`` counts as inertia, damping and friction at that joint.
"""

from __future__ import annotations

import copy
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import mujoco
import numpy as np

from invid.effects.elements import AddedDamper, ForceLaw, Law
from invid.effects.elements import Element as Part
from invid.errors import InputError, ModelError
from invid.exchange.linear_plant import effect_name
from invid.model.document import Model, save_text
from invid.simulation.laws import elements_of
from invid.simulators.mujoco_correct import HARD, SpecCopy, beyond_weight, linear_copy
from invid.simulators.mujoco_engine import MujocoSimulator
from invid.simulators.mujoco_plant import MjcfPlant, mass_matrix, read_plant
from invid.simulators.plain_xml import parsed

REDUCTION = ("mechanicalReduction", "mechanical_reduction")
"""As ROS 1 and ROS 2 write it."""
ROTOR = "drake:rotor_inertia"
SPRING = "springStiffness"
NOT_SIMULATED = ("visual", "collision", "mimic", "safety_controller", "calibration")
"""Shapes would be read from other files and touch each other; joints that follow others count with them."""
_TURNING = ("revolute", "continuous", "prismatic")
STEP = 0.1
"""Step times the fastest rate of joints' springs and dampers, at most; MuJoCo's own step is 2 ms."""


@dataclass(frozen=True)
class Transmission:
    """One joint and one actuator; ``reduction`` that of the motor, ``recorded`` of what is recorded."""

    joint: str
    actuator: str
    reduction: float
    recorded: float
    rotor: float
    element: Element


@dataclass(frozen=True)
class Follower:
    """A joint that turns ``multiplier`` times as far as ``master``, and what that adds there."""

    joint: str
    master: str
    multiplier: float
    armature: float
    damping: float
    friction: float


class UrdfSimulator(MujocoSimulator):
    """A URDF; ``root`` is its XML, ``drives`` the transmission of each axis."""

    root: Element
    drives: list[Transmission]
    followers: list[Follower]

    def _read(self, path: Path) -> MjcfPlant:
        self.root = parsed(path.read_bytes(), self.path)
        if self.root.tag != "robot":
            raise InputError(f"{path}: its root is <{self.root.tag}>; a URDF has <robot>")
        if any(str(e.tag).startswith("xacro:") for e in self.root.iter()):
            raise InputError(
                f"{path}: holds xacro macros",
                # Never into the file that is read: the shell would empty it first.
                way_out=f"expand them first: xacro {path.name} > {path.name.split('.')[0]}.expanded.urdf",
                code="xacro",
            )
        self.drives = self._drives(self.root)
        self.followers = _followers(self.root, self.drives, self.path)
        spec = _spec(self.root, self.drives, self.path)
        for f in self.followers:
            joint = spec.joint(f.master)
            joint.armature += f.armature
            joint.damping[0] += f.damping
            joint.frictionloss += f.friction
        plant = read_plant(spec, self.axes, self.path, {d.joint: d.recorded for d in self.drives}, plain=True)
        if self.root.find("mujoco/option[@timestep]") is None:
            plant.step = min(plant.step, STEP / _fastest(plant.compiled))
        plant.remarks += tuple(
            f"{f.joint} follows {f.master} {f.multiplier:g} times: {f.armature:.4g} of inertia there"
            for f in self.followers
        )
        still = [j.get("name", "") for j in self.root.findall("joint") if _is_still(j, self)]
        plant.remarks += (f"{', '.join(still)}: not recorded, locked at 0",) if still else ()
        return plant

    def _drives(self, root: Element) -> list[Transmission]:
        """The transmission of each axis: by the actuators' names, else the joints', else in their order."""
        joints = {j.get("name", ""): j.get("type") for j in root.findall("joint")}
        found = list(_transmissions(root))
        named = [{t[key]: t for t in found} for key in (0, 1)]
        chosen = next(([n[a] for a in self.axes] for n in named if {*self.axes} <= n.keys()), found)
        if len(chosen) != len(self.axes):
            has = ", ".join(f"{actuator} on {joint}" for actuator, joint, _ in found) or "none"
            raise InputError(
                f"{self.path}: the recording has the axes {', '.join(self.axes)}, the URDF the transmissions "
                f"{has}; add one a motor, with the turns that the recording counts per turn of the joint (1: "
                f"it counts the joint's own): {_example(self.axes[0], next(iter(joints), 'joint'))}"
            )
        for actuator, joint, _ in chosen:
            if joints.get(joint) not in _TURNING:
                kind = joints.get(joint) or "missing"
                raise InputError(
                    f'{self.path}: <transmission> of {actuator}: joint "{joint}" is {kind}; a motor drives a '
                    "revolute, continuous or prismatic joint of this file"
                )
        return [_stated(*t, self.path) for t in chosen]

    def corrected(self, model: Model, to: Path) -> tuple[MujocoSimulator, list[str]]:
        """See ``Simulator.corrected``: numbers of inertias, dynamics, springs and rotors."""
        made = linear_copy(self.plant, model)
        for term in beyond_weight(self.plant, model):
            try:
                parts = elements_of(model.chains, term)
                reason = next((r for r in (_write(made, p) for p in parts) if r), "")
            except ModelError as error:
                reason = str(error)
            if reason and term.cause == "gravity":
                reason = (
                    "mass and centre of mass of a link make it, of which a torque tells the product alone"
                )
            if reason:
                made.lost.append(f"{effect_name(term)}: {reason}")
        root = copy.deepcopy(self.root)
        _transfer(made, root, self._drives(root), self.followers)
        save_text(to, '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n")
        return UrdfSimulator(to, self.axes), made.lost


def _transmissions(root: Element) -> Iterator[tuple[str, str, Element]]:
    """Actuator, joint and element of those of one joint and one actuator, as ROS 1 or ROS 2 write them."""
    for t in root.iter("transmission"):
        joints, actuators = t.findall("joint"), t.findall("actuator")
        if len(joints) == 1 and len(actuators) <= 1:
            joint = joints[0].get("name", "")
            named = actuators[0].get("name") if actuators else None
            yield named or t.get("name") or joint, joint, t


def _stated(actuator: str, joint: str, t: Element, source: str) -> Transmission:
    """What a transmission says; InputError where it leaves the reduction open."""
    where = f"{source}: <transmission> of {actuator}"
    stated = [e for e in t.iter() if e.tag in REDUCTION]
    if not stated:
        raise InputError(
            f"{where}: has no <mechanicalReduction>; add it to its <actuator>: {_example(actuator, joint)}"
        )
    values = {_number(e, f"{where}: <{e.tag}>") for e in stated}
    if len(values) > 1 or 0.0 in values:
        raise InputError(
            f"{where}: states the reductions {', '.join(f'{v:g}' for v in values)}; give one, not 0"
        )
    side = t.find("invid")
    recorded = "motor" if side is None else side.get("recorded", "")
    if recorded not in ("motor", "joint"):
        raise InputError(f'{where}: <invid recorded="{recorded}"/>; it is "motor" or "joint"')
    reduction = values.pop()
    rotor = _rotor(t)
    inertia = 0.0 if rotor is None else _number(rotor, f"{where}: <{ROTOR}>")
    if inertia < 0.0:
        raise InputError(f"{where}: <{ROTOR}> is {inertia:g}; an inertia is not below 0")
    return Transmission(joint, actuator, reduction, reduction if recorded == "motor" else 1.0, inertia, t)


def _rotor(transmission: Element) -> Element | None:
    return next((e for e in transmission.iter() if e.tag == ROTOR), None)


def _example(actuator: str, joint: str) -> str:
    return (
        f'<transmission name="{actuator}"><type>transmission_interface/SimpleTransmission</type><joint '
        f'name="{joint}"/><actuator name="{actuator}"><mechanicalReduction>1</mechanicalReduction></actuator>'
        "</transmission>"
    )


def _number(element: Element, where: str) -> float:
    """The number of an element's text or of its attribute ``value``; InputError where there is none."""
    said = element.get("value", element.text or "").strip()
    try:
        found = float(said)
    except ValueError:
        found = math.nan
    if not math.isfinite(found):
        raise InputError(f"{where} is {said!r}; give a number")
    return found


def _springs(root: Element) -> dict[str, Element]:
    """``<springStiffness>`` by joint."""
    found = ((g.get("reference", ""), g.find(SPRING)) for g in root.iter("gazebo"))
    return {joint: e for joint, e in found if e is not None}


def _spec(root: Element, drives: list[Transmission], source: str, *, sprung: bool = True) -> Any:
    """MuJoCo's spec of a URDF: shapes left out, springs and motors put in, all other joints locked."""
    bare = copy.deepcopy(root)
    for parent in bare.iter():
        for child in [c for c in parent if c.tag in NOT_SIMULATED]:
            parent.remove(child)
    springs = {
        j: _number(e, f'{source}: <gazebo reference="{j}"><{SPRING}>') for j, e in _springs(root).items()
    }
    springs = springs if sprung else {}
    driven = {d.joint for d in drives}
    for joint in bare.findall("joint"):
        if joint.get("name") not in driven and springs.get(joint.get("name", ""), 0.0) <= 0.0:
            joint.set("type", "fixed")
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(bare, encoding="unicode"))
    spec.compiler.fusestatic = False  # a body stays the link of its name
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    for joint in spec.joints:
        joint.stiffness[0] = springs.get(joint.name, 0.0) if joint.name not in driven else 0.0
        joint.solref_friction[:], joint.solimp_friction[:] = HARD
    for drive in drives:
        spec.joint(drive.joint).armature = drive.rotor * drive.reduction**2
        motor = spec.add_actuator(name=drive.actuator, target=drive.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gear[0] = drive.recorded
    return spec


def _is_still(joint: Element, of: UrdfSimulator) -> bool:
    name = joint.get("name", "")
    moves = {d.joint for d in of.drives} | {f.joint for f in of.followers} | set(_springs(of.root))
    return joint.get("type") in _TURNING and name not in moves


def _followers(root: Element, drives: list[Transmission], source: str) -> list[Follower]:
    """What each joint that mimics a driven one adds there, from the mass matrix where both are free."""
    driven, found = {d.joint for d in drives}, []
    for joint in root.findall("joint"):
        mimic, name = joint.find("mimic"), joint.get("name", "")
        if mimic is None or mimic.get("joint") not in driven or joint.get("type") not in _TURNING:
            continue
        master = mimic.get("joint", "")
        ratio = 1.0
        if mimic.get("multiplier") is not None:
            said = Element("multiplier", {"value": mimic.get("multiplier", "")})
            ratio = _number(said, f"{source}: <mimic> of {name}: multiplier")
        free = [Transmission(j, j, 1.0, 1.0, 0.0, joint) for j in (master, name)]
        m = _spec(root, free, source, sprung=False).compile()
        mass = mass_matrix(m)
        a, b = (int(m.jnt_dofadr[m.joint(j).id]) for j in (master, name))
        found.append(
            Follower(
                name, master, ratio,
                armature=ratio**2 * float(mass[b, b]) + 2.0 * ratio * float(mass[a, b]),
                damping=ratio**2 * float(m.dof_damping[b]),
                friction=abs(ratio) * float(m.dof_frictionloss[b]),
            )
        )  # fmt: skip
    return found


def _fastest(m: Any) -> float:
    """Largest rate [rad/s or 1/s] of the joints' springs and dampers."""
    away = np.linalg.inv(mass_matrix(m))
    stiff = np.abs(np.linalg.eigvals(away @ np.diag(m.jnt_stiffness))).max(initial=0.0)
    damped = np.abs(np.linalg.eigvals(away @ np.diag(m.dof_damping))).max(initial=0.0)
    return max(float(np.sqrt(stiff)), float(damped), 1e-9)


def _write(made: SpecCopy, part: Part) -> str:
    """Puts one element of an effect into a joint's dynamics; why not, where URDF has no room for it."""
    match part:
        case ForceLaw(Law.DRY, a, -1, p):
            along, b = made.joints_along(made.coordinate(a), -1), -1
        case AddedDamper(a, b, _):
            along = made.joints_along(made.coordinate(a), made.coordinate(b))
        case _:
            return "URDF has no element for it"
    if len(along) != 1:
        return "a URDF joint has friction and damping against the link before it alone, and this is no joint"
    joint, scale = made.spec.joint(along[0][0]), along[0][1]
    if isinstance(part, AddedDamper):
        joint.damping[0] += part.coefficient * scale**2
        return ""
    joint.frictionloss += 0.5 * (p[0] + p[1]) * abs(scale)
    is_plain = math.isclose(p[0], p[1], rel_tol=1e-3) and max(abs(p[2]), abs(p[4])) <= 1e-6 * abs(p[0])
    return (
        ""
        if is_plain
        else "the mean of its sliding friction stands in its joint; URDF has one level for all speeds"
    )


def _transfer(made: SpecCopy, root: Element, drives: list[Transmission], followers: list[Follower]) -> None:
    """Writes the numbers of a corrected spec that differ into the user's XML, less what followers add."""
    before, after = made.plant.compiled, made.spec.compile()
    added: Counter[tuple[str, str]] = Counter()
    for f in followers:
        for key in ("damping", "friction", "armature"):
            added[f.master, key] += getattr(f, key)
    for link in root.findall("link"):
        inertial = link.find("inertial")
        old, new = (m.body(link.get("name")) for m in (before, after))
        if inertial is not None and old.mass[0] > 0.0:
            _scale(inertial.find("mass"), ("value",), float(new.mass[0] / old.mass[0]))
            if old.inertia.max() > 0.0:
                _scale(inertial.find("inertia"), _MOMENTS, float(new.inertia.max() / old.inertia.max()))
    springs, joints = _springs(root), {e.get("name"): e for e in root.findall("joint")}
    for k in range(after.njnt):
        name = after.joint(k).name
        for key, field in (("damping", "dof_damping"), ("friction", "dof_frictionloss")):
            old, new = (float(getattr(m, field)[k]) for m in (before, after))
            if not _is_same(old, new):
                here = joints[name].find("dynamics")
                here = SubElement(joints[name], "dynamics") if here is None else here
                here.set(key, repr(max(new - added[name, key], 0.0)))
        if name in springs and not _is_same(before.jnt_stiffness[k], after.jnt_stiffness[k]):
            springs[name].text = repr(float(after.jnt_stiffness[k]))
            springs[name].attrib.pop("value", None)
    for drive in drives:
        armature = float(after.dof_armature[after.joint(drive.joint).id]) - added[drive.joint, "armature"]
        inertia = max(armature, 0.0) / drive.reduction**2
        if not _is_same(inertia, drive.rotor):
            actuator, rotor = drive.element.find("actuator"), _rotor(drive.element)
            if rotor is None:
                rotor = SubElement(drive.element if actuator is None else actuator, ROTOR)
            rotor.set("value", repr(inertia))
            root.attrib.setdefault("xmlns:drake", "http://drake.mit.edu")


_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def _is_same(old: float, new: float) -> bool:
    return math.isclose(old, new, rel_tol=1e-9)


def _scale(element: Element | None, names: tuple[str, ...], factor: float) -> None:
    if element is not None and not _is_same(factor, 1.0):
        for name in names:
            element.set(name, repr(float(element.get(name, "0")) * factor))


def opened(path: Path, axes: tuple[str, ...]) -> Any:
    """The simulator."""
    return UrdfSimulator(path, axes)
