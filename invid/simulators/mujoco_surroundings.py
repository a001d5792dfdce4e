"""What of a user's XML is no part of the recorded axes: joints of other things, limits, shapes.

Joints that no axis drives, and that no spring, tendon or constraint ties to one, are locked where they stand;
limits of position and force are released, since the recorded motion was possible. Both are said.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from invid.numerics.arrays import Float64

_SINGLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_FILE_SHAPES = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF)
_PARALLEL = 0.999
_NOT_COPIED = ("id", "signature", "parent", "frame", "classname", "info", "compiler")


@dataclass(frozen=True, eq=False)
class Locked:
    """A joint that was taken out of its body, with what it was."""

    name: str
    body: str
    fields: dict[str, Any]

    def put_back(self, spec: Any) -> None:
        """The joint in its body again, free."""
        joint = spec.body(self.body).add_joint(name=self.name)
        for field, value in self.fields.items():
            if isinstance(value, np.ndarray):
                getattr(joint, field)[:] = value
            else:
                setattr(joint, field, value)


def without_missing_shapes(spec: Any) -> list[str]:
    """Takes out shapes from files on bodies that state their inertia, and pictures; what was taken out."""
    needed = int(spec.compiler.inertiafromgeom) == int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE)
    gone = [
        g
        for body in spec.bodies
        if body.explicitinertial and not needed
        for g in body.geoms
        if g.type in _FILE_SHAPES
    ]
    for geom in gone:
        spec.delete(geom)
    left = {g.meshname for g in spec.geoms} | {g.hfieldname for g in spec.geoms}
    for asset in [a for a in (*spec.meshes, *spec.hfields) if a.name not in left]:
        spec.delete(asset)
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for item in [*spec.textures, *spec.skins]:
        spec.delete(item)
    return ["shapes whose files are missing"] if gone else []


def tendon_row(m: Any, tendon: int) -> Float64 | None:
    """(njnt,) coefficients of the joints in a tendon's length; ``None`` where it is no sum of them."""
    at = slice(int(m.tendon_adr[tendon]), int(m.tendon_adr[tendon] + m.tendon_num[tendon]))
    if (m.wrap_type[at] != int(mujoco.mjtWrap.mjWRAP_JOINT)).any():
        return None
    row = np.zeros(m.njnt)
    np.add.at(row, m.wrap_objid[at], m.wrap_prm[at])
    return row


def belonging(m: Any, motors: Collection[int]) -> set[int]:
    """Joints tied to the motors': by springs, tendons, constraints, or carrying them on a spring."""
    kept = set(motors)
    while True:
        found = set(_tied(m, kept)) - kept
        if not found:
            return kept
        kept |= found


def _tied(m: Any, kept: set[int]) -> Iterator[int]:
    for t in range(m.ntendon):
        row = tendon_row(m, t)
        joints = set() if row is None else {int(k) for k in np.flatnonzero(row)}
        yield from joints if joints & kept else ()
    bodies = {int(m.jnt_bodyid[k]) for k in kept}
    for e in range(m.neq):
        ends = {int(m.eq_obj1id[e]), int(m.eq_obj2id[e])} - {-1}
        if m.eq_type[e] == int(mujoco.mjtEq.mjEQ_JOINT):
            yield from ends if ends & kept else ()
        elif m.eq_type[e] in (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)):
            if m.eq_objtype[e] != int(mujoco.mjtObj.mjOBJ_BODY):
                ends = {int(m.site_bodyid[s]) for s in ends}
            above = {b for end in ends for b in _above(m, end)}
            if above & bodies:  # a closed loop: what lies in it moves with it
                yield from (k for k in range(m.njnt) if int(m.jnt_bodyid[k]) in above)
    axes = _axes_in_world(m)
    for k in range(m.njnt):
        sprung = m.jnt_stiffness[k] > 0.0 and m.jnt_type[k] in _SINGLE
        others = [j for j in kept if _carries(m, j, k) or _carries(m, k, j)]
        if sprung and any(
            m.jnt_type[j] == m.jnt_type[k] and abs(axes[j] @ axes[k]) > _PARALLEL for j in others
        ):
            yield k


def _above(m: Any, body: int) -> list[int]:
    """A body and those that carry it, without the world."""
    out = []
    while body > 0:
        out.append(body)
        body = int(m.body_parentid[body])
    return out


def _carries(m: Any, a: int, b: int) -> bool:
    return int(m.jnt_bodyid[a]) in _above(m, int(m.jnt_bodyid[b])) and a != b


def _axes_in_world(m: Any) -> Any:
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    return data.xaxis


def lock(spec: Any, names: Collection[str]) -> tuple[Locked, ...]:
    """Takes joints out of a spec, with what drives, senses and ties them, and the stored poses."""
    out = []
    for joint in [j for j in spec.joints if j.name in names]:
        kept = {f: _value(joint, f) for f in dir(joint) if not f.startswith("_") and f not in _NOT_COPIED}
        fields = {f: v for f, v in kept.items() if v is not None and f != "name"}
        out.append(Locked(joint.name, joint.parent.name, fields))
    refer = [a for a in spec.actuators if a.target in names]
    refer += [s for s in spec.sensors if s.objname in names or s.objname in {a.name for a in refer}]
    refer += [e for e in spec.equalities if {e.name1, e.name2} & set(names)]
    refer += [t for t in spec.tendons if {getattr(w.target, "name", "") for w in t.path} & set(names)]
    for item in [*refer, *spec.keys, *(j for j in spec.joints if j.name in names)]:
        spec.delete(item)
    return tuple(out)


def _value(joint: Any, field: str) -> Any:
    value = getattr(joint, field)
    if callable(value):
        return None
    return np.array(value) if isinstance(value, np.ndarray) else value


def release_limits(spec: Any, play: Collection[str]) -> None:
    """Takes off limits of position and force in a spec that is simulated; those of ``play`` are play."""
    off = mujoco.mjtLimited.mjLIMITED_FALSE
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for joint in spec.joints:
        joint.actfrclimited = off
        if joint.name not in play:
            joint.limited = off
    for tendon in spec.tendons:
        tendon.limited, tendon.actfrclimited = off, off
    for actuator in spec.actuators:
        actuator.forcelimited = off
