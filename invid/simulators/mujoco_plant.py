"""What a MuJoCo XML says of a machine: its joints as chains of masses, its elements as effects.

MuJoCo's own compiler gives the mass matrix; each spring and damper is a joint or a tendon that is linear in
the joints. x = S q are the positions of the masses: a joint that has a spring of its own is the deflection of
that spring, so x adds the joint before it. A chain is walked from each motor along the springs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np

from invid.errors import InputError, ModelError
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, EffectTerm, Estimate, Model
from invid.numerics.arrays import Float64
from invid.simulators.mujoco_surroundings import Locked, belonging, lock, tendon_row

SMALL = 1e-9
LIGHT = 0.05
"""Inertia of a joint with limits over that of the masses it lies between, up to which it is play and no mass.
"""
HIDDEN = "hidden mass"
"""What the joint of a mass on a spring beside a chain is called in a corrected copy."""


@dataclass(frozen=True)
class Motor:
    """The joint of an axis' motor, the actuator that the drive's torque goes to, torque per its control.

    ``reduction``: recorded position per position of the joint, and the joint's torque per recorded torque;
    ``zero`` is the reference position as it would be recorded.
    """

    joint: str
    actuator: str
    gain: float
    zero: float = 0.0
    reduction: float = 1.0


@dataclass(frozen=True)
class Handle:
    """An element along x_a − x_b (b = −1: ground): a joint or a tendon, its length being ``scale`` times
    that; what it does there.

    ``spring`` is its stiffness, ``yields`` the force at which that gives way (0: never) and ``cubic`` its
    third coefficient; ``gap`` the free play, of which the joint ``play`` takes ``play_share`` times what lies
    between its limits.
    """

    kind: str
    name: str
    a: int
    b: int
    scale: float
    spring: float
    damping: float
    friction: float
    cubic: float
    yields: float
    gap: float
    play: str | None = None
    play_share: float = 0.0

    @property
    def elastic(self) -> float:
        """Stiffness; nothing for a spring that yields, which is a law of its own."""
        return 0.0 if self.yields else self.spring


@dataclass(eq=False)
class MjcfPlant:
    """An XML's spec and what was read of it; ``model`` None where its joints are no chains."""

    spec: Any
    compiled: Any
    axes: tuple[str, ...]
    motors: tuple[Motor, ...]
    positions: Float64
    """(n, nv): S."""
    mass: Float64
    """(n, n) of the masses' positions."""
    handles: list[Handle]
    order: list[list[int]]
    """Coordinates of each axis' chain, the motor first."""
    model: Model | None
    linear_axes: bool
    step: float
    hidden: list[int]
    """Coordinates of masses on a spring beside a chain."""
    plain: bool = False
    """A URDF's: inertia in its links and in the rotors of its motors alone, no tendons."""
    locked: tuple[Locked, ...] = ()
    """Joints beside the recorded axes."""
    remarks: tuple[str, ...] = ()

    @property
    def play(self) -> set[str]:
        """Joints whose limits are play."""
        return {h.play for h in self.handles if h.play}

    @property
    def said(self) -> list[str]:
        """What was locked and released, in sentences."""
        names = ", ".join(j.name for j in self.locked)
        locked = [f"{names}: not recorded, locked where the file has them"] if names else []
        return [*self.remarks, *locked]

    @property
    def motor_inertia(self) -> Float64:
        """(M,) inertia that a guide of the motor feels at high frequency, as recorded."""
        whole, dofs = mass_matrix(self.compiled), [self.compiled.joint(m.joint).id for m in self.motors]
        inner = np.setdiff1d(np.arange(whole.shape[0]), dofs)
        cross = whole[np.ix_(dofs, inner)]
        out = whole[np.ix_(dofs, dofs)] - cross @ np.linalg.solve(whole[np.ix_(inner, inner)], cross.T)
        return np.asarray(np.diag(out) / np.array([motor.reduction for motor in self.motors]) ** 2)

    def start(self, data: Any, model: Any, position: Float64, velocity: Float64) -> None:
        """Every mass where its motor is and as fast; what belongs to no chain at rest."""
        x = np.zeros((2, self.positions.shape[0]))
        for i, chain in enumerate(self.order):
            x[0, chain], x[1, chain] = position[i], velocity[i]
            for h in self.handles:  # and what hangs on them
                if h.b >= 0 and (h.a in chain) != (h.b in chain):
                    x[:, h.a if h.b in chain else h.b] = position[i], velocity[i]
        q = np.linalg.solve(self.positions, x.T).T
        for k in range(model.njnt):
            data.qpos[model.jnt_qposadr[k]] = model.qpos0[model.jnt_qposadr[k]] + q[0, k]
            data.qvel[model.jnt_dofadr[k]] = q[1, k]


def steps_of(seconds: float, step: float) -> int:
    """Samples of a buffer that holds a delay."""
    return int(np.ceil(seconds / step - 1e-9)) + 2


def mass_matrix(model: Any) -> Float64:
    """(nv, nv) in the reference pose."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    out = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, out)
    return out


def read_plant(
    spec: Any,
    axes: tuple[str, ...],
    source: str,
    reductions: Mapping[str, float] = MappingProxyType({}),
    *,
    plain: bool = False,
) -> MjcfPlant:
    """The plant; InputError where no actuator or joint can be told for an axis.

    ``reductions``: turns of a motor as it is recorded per turn of its joint, by the joint's name.
    """
    _name_all(spec)
    compiled = spec.compile()
    motors = _motors(spec, compiled, axes, source, reductions)
    tied = belonging(compiled, [compiled.joint(m.joint).id for m in motors])
    hidden_too = {k for k in range(compiled.njnt) if compiled.joint(k).name.startswith(HIDDEN)}
    beside = [compiled.joint(k).name for k in range(compiled.njnt) if k not in tied | hidden_too]
    locked = lock(spec, beside) if beside else ()
    compiled = spec.compile() if locked else compiled
    if compiled.nv != compiled.njnt or compiled.nq != compiled.nv:
        raise InputError(f"{source}: has ball or free joints; only hinges and slides are read")
    # Behind a reduction it is the motor's turns that are recorded, of a slide as well.
    kinds = {
        int(
            compiled.jnt_type[compiled.joint(m.joint).id]
            if m.reduction == 1.0
            else mujoco.mjtJoint.mjJNT_HINGE
        )
        for m in motors
    }
    if len(kinds) > 1:
        raise InputError(f"{source}: hinges and slides are driven; one recording has one unit")
    linear = kinds == {int(mujoco.mjtJoint.mjJNT_SLIDE)}
    positions = _positions(compiled, {m.joint: m.reduction for m in motors})
    back = np.asarray(np.linalg.inv(positions), dtype=np.float64)
    mass = back.T @ mass_matrix(compiled) @ back
    handles = list(_handles(compiled, back, _slack(compiled, mass, {m.joint for m in motors})))
    order = _chains(compiled, handles, [compiled.joint(m.joint).id for m in motors])
    hidden = [k for k in range(compiled.njnt) if compiled.joint(k).name.startswith(HIDDEN)]
    for chain in order:  # what hangs on a link that couples to others is no mass of its chain
        others = [k for c in order if c is not chain for k in c]
        coupled = np.abs(mass[np.ix_(chain, others)]).max(axis=1, initial=0.0) > SMALL * mass.max()
        if len(chain) > 1 and coupled[-2] and not coupled[-1]:
            hidden.append(chain.pop())
    plant = MjcfPlant(
        spec, compiled, axes, motors, positions, mass, handles, order, None, linear,
        float(compiled.opt.timestep), hidden, plain, locked,
    )  # fmt: skip
    plant.model = _model(plant, source)
    return plant


def _name_all(spec: Any) -> None:
    """Names for joints, tendons and actuators that have none: elements are found again by them."""
    for what, items in (("joint", spec.joints), ("tendon", spec.tendons), ("actuator", spec.actuators)):
        for k, item in enumerate(items):
            if not item.name:
                item.name = f"{what} {k}"


def _motors(
    spec: Any, m: Any, axes: tuple[str, ...], source: str, reductions: Mapping[str, float]
) -> tuple[Motor, ...]:
    """By the names of actuators, else of joints, else the driven joints in their order."""
    driven: dict[int, list[Any]] = {}
    for a in spec.actuators:
        number = m.actuator(a.name).id
        if int(m.actuator_trntype[number]) == int(mujoco.mjtTrn.mjTRN_JOINT) and m.actuator_ctrlnum[number]:
            driven.setdefault(int(m.actuator_trnid[number, 0]), []).append(a)
    by_name = {a.name: joint for joint, actuators in driven.items() for a in actuators}
    joints = {m.joint(k).name: k for k in range(m.njnt)}
    if all(x in by_name for x in axes):
        chosen = [by_name[x] for x in axes]
    elif all(x in joints for x in axes):
        chosen = [joints[x] for x in axes]
    elif len(driven) == len(axes):
        chosen = list(driven)
    else:
        raise InputError(
            f"{source}: the recording has the axes {', '.join(axes)}, the XML drives "
            f"{len(driven)} joints ({', '.join(m.joint(k).name for k in driven) or 'none'}); give the "
            "motors' joints or actuators the axes' names"
        )
    out = []
    for joint in chosen:
        direct = [a for a in driven.get(joint, []) if _is_direct(a)]
        for a in driven.get(joint, []):
            if a not in direct[:1]:  # a controller: the recording's torque holds the axis instead
                a.gainprm[:], a.biasprm[:] = 0.0, 0.0
        own, name = (direct[0] if direct else None), m.joint(joint).name
        reduction = reductions.get(name, 1.0)
        gain = reduction if own is None else float(own.gainprm[0] * own.gear[0])
        zero = reduction * float(m.qpos0[m.jnt_qposadr[joint]])
        out.append(Motor(name, "" if own is None else own.name, gain, zero, reduction))
    return tuple(out)


def _is_direct(actuator: Any) -> bool:
    """Whether the control is the torque, through a filter at most."""
    return bool(
        actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED
        and actuator.biastype == mujoco.mjtBias.mjBIAS_NONE
        and actuator.gainprm[0] * actuator.gear[0] != 0.0
        and actuator.dyntype
        in (mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)
    )


def _positions(m: Any, reductions: Mapping[str, float]) -> Float64:
    """S (n, nv): a joint with a spring of its own, not driven, stands on the joint before it; all of a chain
    is counted on the motor's side of its gear."""
    out = np.eye(m.nv)
    for k in range(m.njnt):
        if m.joint(k).name in reductions:
            out[k, k] = reductions[m.joint(k).name]
        elif m.jnt_stiffness[k] > 0.0 and (before := _joint_before(m, k)) >= 0:
            out[k] = out[before]
            out[k, k] = out[before, before]
    return out


def _joint_before(m: Any, k: int) -> int:
    """The joint that carries joint k, or −1."""
    body = int(m.jnt_bodyid[k])
    if k > m.body_jntadr[body]:
        return k - 1
    body = int(m.body_parentid[body])
    while body > 0:
        if m.body_jntnum[body]:
            return int(m.body_jntadr[body] + m.body_jntnum[body] - 1)
        body = int(m.body_parentid[body])
    return -1


def _slack(m: Any, mass: Float64, motors: set[str]) -> list[int]:
    """Joints that are play: between limits, with no spring or drive and next to no inertia."""
    least = mass.diagonal().min(where=~m.jnt_limited.astype(bool), initial=np.inf)
    return [
        k
        for k in range(m.njnt)
        if m.jnt_limited[k] and not m.jnt_stiffness[k] and m.joint(k).name not in motors
        and mass[k, k] <= LIGHT * least
    ]  # fmt: skip


def _handles(m: Any, back: Float64, slack: list[int]) -> Iterator[Handle]:
    """All joints and tendons that are one; of hinges and slides a joint's number is its coordinate's."""
    rows = [("jnt", k, np.eye(m.nv)[k]) for k in range(m.njnt) if k not in slack]
    tendons = ((t, tendon_row(m, t)) for t in range(m.ntendon))
    rows += [("tendon", t, row) for t, row in tendons if row is not None]
    for kind, at, row in rows:
        pattern = row @ back
        loose = [k for k in slack if pattern[k]] if kind == "tendon" else []
        pattern[loose] = 0.0
        found = np.flatnonzero(np.abs(pattern) > SMALL)
        if found.size == 1:
            found = np.append(found, -1)
        elif found.size != 2 or abs(pattern[found].sum()) >= SMALL:
            continue
        scale = float(pattern[found[0]])
        size, spring = abs(scale), float(getattr(m, f"{kind}_stiffness")[at]) * scale**2
        damping, friction = (
            (m.dof_damping, m.dof_frictionloss)
            if kind == "jnt"
            else (m.tendon_damping, m.tendon_frictionloss)
        )
        gap = 0.0 if kind == "jnt" else float(np.ptp(m.tendon_lengthspring[at])) / size
        play, share = None, 0.0
        if len(loose) == 1:
            play, share = m.joint(loose[0]).name, abs(float(row[loose[0]])) / size
            gap += share * float(np.ptp(m.jnt_range[loose[0]]))
        yield Handle(
            "joint" if kind == "jnt" else "tendon",
            (m.joint if kind == "jnt" else m.tendon)(at).name,
            int(found[0]),
            int(found[1]),
            scale,
            spring,
            float(damping[at]) * scale**2,
            float(friction[at]) * size,
            float(getattr(m, f"{kind}_stiffnesspoly")[at, 1]) * size**4,
            spring * float(getattr(m, f"{kind}_springyield")[at]) / size,
            gap,
            play,
            share,
        )


def _chains(m: Any, handles: list[Handle], motors: list[int]) -> list[list[int]]:
    """From each motor along the springs; a fork ends the chain, and so does another motor."""
    beside: dict[int, set[int]] = {}
    for h in handles:
        if h.b >= 0 and h.elastic > 0.0:
            beside.setdefault(h.a, set()).add(h.b)
            beside.setdefault(h.b, set()).add(h.a)
    out = []
    for motor in motors:
        chain = [motor]
        while True:
            further = [
                k
                for k in beside.get(chain[-1], ())
                if k not in {*chain, *motors} and not m.joint(k).name.startswith(HIDDEN)
            ]
            if len(further) != 1:
                break
            chain.append(further[0])
        out.append(chain)
    return out


def _model(plant: MjcfPlant, source: str) -> Model | None:
    """Chains and effects, or None."""
    slack = [plant.compiled.joint(h.play).id for h in plant.handles if h.play]
    used = [*(k for chain in plant.order for k in chain), *plant.hidden, *slack]
    if sorted(used) != list(range(plant.mass.shape[0])):
        return None
    ends = [chain[-1] for chain in plant.order]
    rest = plant.mass.copy()
    rest[np.ix_(ends, ends)] = 0.0
    rest[slack], rest[:, slack] = 0.0, 0.0
    np.fill_diagonal(rest, 0.0)
    if np.abs(rest).max(initial=0.0) > 1e-6 * plant.mass.diagonal().max():
        return None
    pairs = [[handles_between(plant.handles, a, b) for a, b in pairwise(chain)] for chain in plant.order]
    springs = [[sum(h.elastic for h in between) for between in chain] for chain in pairs]
    dampers = [[sum(h.damping for h in between) for between in chain] for chain in pairs]
    couplings = plant.mass[np.ix_(ends, ends)] * (1.0 - np.eye(len(ends)))
    try:
        chains = CoupledChains.build(
            [plant.mass.diagonal()[chain] for chain in plant.order],
            springs,
            dampers,
            couplings,
            axes=plant.axes,
        )
    except ModelError:
        return None
    return Model(
        robot=plant.spec.modelname, method="mujoco", chains=chains, std=ChainStd.unknown(chains),
        linear=plant.linear_axes, effects=tuple(_effects(plant)), provenance={"source": source},
    )  # fmt: skip


def handles_between(handles: list[Handle], a: int, b: int) -> list[Handle]:
    """Return the elements along x_a − x_b."""
    return [h for h in handles if {h.a, h.b} == {a, b}]


def place_of(plant: MjcfPlant, a: int, b: int) -> tuple[str, str] | None:
    """Axis and element of a mass (b = −1) or of a spring."""
    for axis, chain in zip(plant.axes, plant.order, strict=True):
        if a in chain and b < 0:
            return axis, f"mass {chain.index(a) + 1}"
        if a in chain and b in chain:
            return axis, f"spring {min(chain.index(a), chain.index(b)) + 1}"
    return None


def _effects(plant: MjcfPlant) -> Iterator[EffectTerm]:
    """What the XML has beyond chains: friction, viscous friction, springs' laws, ripple, lag, delay."""
    m = plant.compiled
    dry_off = bool(m.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS))
    torque, length = ("N", "m") if plant.linear_axes else ("N·m", "rad")
    viscous, stiff = f"{torque}·s/{length}", f"{torque}/{length}"

    def term(cause: str, place: tuple[str, str], **values: tuple[float, str]) -> EffectTerm:
        return EffectTerm(
            cause, place[0], {k: Estimate(v, None, unit) for k, (v, unit) in values.items()}, place[1]
        )

    for h in plant.handles:
        place = place_of(plant, h.a, h.b)
        if place is None:
            continue
        if h.b < 0 and h.friction and not dry_off:
            yield term("coulomb_friction", place, torque=(h.friction, torque))
        if h.b < 0 and h.damping:
            yield term("viscous_friction", place, coefficient=(h.damping, viscous))
        if h.b >= 0 and h.cubic:
            yield term("cubic_stiffness", place, coefficient=(h.cubic, f"{torque}/{length}³"))
        if h.b >= 0 and h.yields:
            yield term("spring_hysteresis", place, stiffness=(h.spring, stiff), torque=(h.yields, torque))
        if h.b >= 0 and h.gap:
            yield term("backlash", place, gap=(h.gap, length))
    for k in plant.hidden:
        h = next(h for h in plant.handles if k in (h.a, h.b) and h.b >= 0)
        place = place_of(plant, h.a if h.b == k else h.b, -1)
        if place is not None:
            mass, unit = float(plant.mass[k, k]), "kg" if plant.linear_axes else "kg·m²"
            ratio = h.damping / (2.0 * np.sqrt(mass * h.elastic))
            own = {"mass": (mass, unit), "stiffness": (h.elastic, stiff), "damping_ratio": (ratio, "1")}
            yield term("extra_mode", place, **own)
    for axis, element, size, angle in () if plant.linear_axes else _weights(plant):
        yield term("gravity", (axis, element), torque=(size, torque), angle=(angle, "rad"))
    for i, motor in enumerate(plant.motors):
        yield from _channel(plant, i, motor, term)


def _weights(plant: MjcfPlant) -> Iterator[tuple[str, str, float, float]]:
    """Axis, mass, torque and angle of the weight that a mass feels as its axis turns and the others do not.

    Nothing where that is no sine of one cycle a turn as it is recorded.
    """
    m, data = plant.compiled, mujoco.MjData(plant.compiled)
    least = SMALL * float(m.body_mass.sum() * np.linalg.norm(m.opt.gravity))
    for axis, chain in zip(plant.axes, plant.order, strict=True):
        felt = []
        for angle in (0.0, 0.5 * np.pi, np.pi):
            x = np.zeros(plant.positions.shape[0])
            x[chain] = angle
            data.qpos[:] = m.qpos0 + np.linalg.solve(plant.positions, x)
            mujoco.mj_forward(m, data)
            felt.append(np.linalg.solve(plant.positions.T, data.qfrc_bias))
        for k, at in enumerate(chain):
            level, upright, over = (float(f[at]) for f in felt)
            size = float(np.hypot(level, upright))
            if size > least and abs(level + over) < 1e-6 * size:
                yield axis, f"mass {k + 1}", size, float(np.arctan2(level, upright))


def _channel(plant: MjcfPlant, i: int, motor: Motor, term: Any) -> Iterator[EffectTerm]:
    m, place = plant.compiled, (plant.axes[i], None)
    torque = "N" if plant.linear_axes else "N·m"
    if motor.actuator:
        at = m.actuator(motor.actuator).id
        if m.actuator_delay[at] > 0.0:
            yield term("torque_delay", place, delay=(float(m.actuator_delay[at]), "s"))
        if m.actuator_dyntype[at] != int(mujoco.mjtDyn.mjDYN_NONE):
            yield term("torque_lag", place, time_constant=(float(m.actuator_dynprm[at, 0]), "s"))
    joint = m.joint(motor.joint).id
    for at in range(m.actuator_biasprm.shape[0]):
        if m.actuator_biastype[at] != int(mujoco.mjtBias.mjBIAS_DCMOTOR) or m.actuator_trnid[at, 0] != joint:
            continue
        amplitude, poles, phase, *_ = m.actuator_biasprm[at]
        if amplitude:
            yield term(
                "cogging", (plant.axes[i], "mass 1"), torque=(-float(amplitude), torque),
                cycles_per_rev=(float(poles), "1"), phase=(float(phase), "rad"),
            )  # fmt: skip
