"""URDF with elastic joints, by the convention of Gazebo.

Each axis is a chain of links on one line; the first joint is the motor's, each further one a spring: its
position is the twist of that spring. ``<dynamics damping>`` holds the dampers and
``<gazebo reference="joint"><springStiffness>`` the stiffness, which Gazebo reads and a plain URDF reader
ignores. A tree of links has no inertia between two axes: couplings are lost, and how far modes move
without them is said.
"""

from __future__ import annotations

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from invid.exchange.linear_plant import (
    LinearPlant,
    ParameterSpread,
    effect_losses,
    effect_name,
    loss_comment,
    moved_modes,
)
from invid.model.document import EffectTerm
from invid.model.matrices import Matrices, damper, spring
from invid.numerics.arrays import Float64

POINT_MASS = 1.0
"""Mass [kg] of a link of a rotary axis, on the axis, where it moves nothing: no measurement of torque and
angle tells it, and some readers refuse a link without one."""
UNLIMITED = 1e16
"""What Gazebo takes for no limit."""


def content(plant: LinearPlant, _spread: ParameterSpread, *, robot: str, losses: list[str]) -> bytes:
    """The URDF document (XML), its losses in a comment."""
    root = Element("robot", name=robot or "invid")
    if losses:
        root.append(loss_comment(losses))
    SubElement(root, "link", name="base")
    for i, axis in enumerate(plant.axes):
        start, size = plant.motors[i], plant.chains.masses_per_branch[i]
        for q in range(size):
            parent = "base" if q == 0 else plant.coordinates[start + q - 1]
            _link(root, plant, start + q, parent, start + q - 1 if q else None, place=i)
        transmission = SubElement(root, "transmission", name=f"{axis}.transmission")
        SubElement(transmission, "type").text = "transmission_interface/SimpleTransmission"
        interface = "hardware_interface/EffortJointInterface"
        joint = SubElement(transmission, "joint", name=plant.coordinates[start])
        SubElement(joint, "hardwareInterface").text = interface
        actuator = SubElement(transmission, "actuator", name=axis)
        SubElement(actuator, "hardwareInterface").text = interface
        SubElement(actuator, "mechanicalReduction").text = "1"
    for number, added in enumerate(plant.laws.extra_masses):
        _link(root, plant, plant.chains.dofs + number, plant.coordinates[added.at], added.at, place=0)
    ElementTree.indent(root)
    return ('<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n").encode()


def _link(
    root: Element, plant: LinearPlant, coordinate: int, parent: str, before: int | None, *, place: int
) -> None:
    """A link with its joint to the one before it (``None``: the base)."""
    name = plant.coordinates[coordinate]
    inertia = float(plant.mass[coordinate, coordinate])
    link = SubElement(root, "link", name=name)
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz="0 0 0", rpy="0 0 0")
    SubElement(inertial, "mass", value=repr(inertia if plant.linear_axes else POINT_MASS))
    turned = repr(1.0 if plant.linear_axes else inertia)
    SubElement(inertial, "inertia", ixx=turned, ixy="0", ixz="0", iyy=turned, iyz="0", izz=turned)
    joint = SubElement(root, "joint", name=name, type="prismatic" if plant.linear_axes else "continuous")
    SubElement(joint, "origin", xyz=f"0 {place if before is None else 0} 0", rpy="0 0 0")
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=name)
    # Upright hinges and level slides: a simulator's gravity does nothing that was not identified.
    SubElement(joint, "axis", xyz="1 0 0" if plant.linear_axes else "0 0 1")
    if plant.linear_axes:
        free = repr(UNLIMITED)
        SubElement(joint, "limit", lower=f"-{free}", upper=free, effort=free, velocity=free)
    dry = sum(abs(o.term.value("torque")) for o in plant.nonlinear if _on_joint(o.term, plant, coordinate))
    damping, stiffness = (_between(m, coordinate, before) for m in (plant.damping, plant.stiffness))
    SubElement(joint, "dynamics", damping=repr(damping), friction=repr(float(dry)))
    if stiffness:
        gazebo = SubElement(root, "gazebo", reference=name)
        SubElement(gazebo, "springStiffness").text = repr(stiffness)
        SubElement(gazebo, "springReference").text = "0"


def _between(matrix: Float64, a: int, b: int | None) -> float:
    """Stiffness or damping between two coordinates, or from one to ground."""
    if b is not None:
        return float(-matrix[a, b]) + 0.0
    total = float(matrix[a].sum())
    return total if abs(total) > 1e-12 * float(np.abs(matrix[a]).max(initial=0.0)) else 0.0


def _on_joint(term: EffectTerm, plant: LinearPlant, coordinate: int) -> bool:
    """Return whether dry friction sits at the motor whose joint this is: the only joint with an
    absolute speed.
    """
    return (
        term.cause == "coulomb_friction"
        and term.element in (None, "mass 1")
        and plant.motors[plant.axes.index(term.axis)] == coordinate
    )


def _own_way(term: EffectTerm) -> str | None:
    if term.cause == "coulomb_friction" and term.element in (None, "mass 1"):
        return "stands in its joint's dynamics as friction"
    return None


def held_matrices(plant: LinearPlant) -> tuple[Float64, Float64, Float64]:
    """(n, n) each: the mass, damping and stiffness matrices that the tree holds, in absolute coordinates."""
    parts = [
        part(_between(matrix, a, b), a, -1 if b is None else b)
        for part, matrix in ((damper, plant.damping), (spring, plant.stiffness))
        for a, b in _joints(plant)
    ]
    held = Matrices.of(plant.mass.shape[0], parts)
    return np.diag(np.diag(plant.mass)), held.damping, held.stiffness


def _joints(plant: LinearPlant) -> list[tuple[int, int | None]]:
    """Each joint as its coordinate and the one before it."""
    chain: list[tuple[int, int | None]] = [
        (start + q, start + q - 1 if q else None)
        for start, size in zip(plant.motors, plant.chains.masses_per_branch, strict=True)
        for q in range(size)
    ]
    extra = [(plant.chains.dofs + k, added.at) for k, added in enumerate(plant.laws.extra_masses)]
    return chain + extra


def losses(plant: LinearPlant) -> list[str]:
    """What a tree of links cannot hold of the linear plant."""
    lost = []
    couplings = [
        f"{plant.axes[i]}-{plant.axes[j]} {plant.chains.couplings[i, j]:.4g}"
        for i in range(len(plant.axes))
        for j in range(i + 1, len(plant.axes))
        if plant.chains.couplings[i, j]
    ]
    if couplings:
        lost.append(f"inertia couplings are left out, a URDF tree has none: {', '.join(couplings)}")
    mass, _, stiffness = held_matrices(plant)
    for term in plant.linear:
        at_motor = term.element in (None, "mass 1")
        if term.cause in ("coupling_stiffness", "base_compliance", "torque_gain", "torque_lag") or (
            term.cause == "viscous_friction" and not at_motor
        ):
            lost.append(f"{effect_name(term)} is left out")
    shift = moved_modes(plant, mass, stiffness)
    if shift > 1e-6:
        lost.append(f"natural frequencies of the file are off by up to {100 * shift:.3g} %")
    if not plant.linear_axes:
        lost.append(f"masses of links are not known: {POINT_MASS:g} kg on the axis stands for each")
    return lost + effect_losses(plant, _own_way)
