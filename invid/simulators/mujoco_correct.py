"""A MuJoCo XML that says what a model says, by MuJoCo's own elements.

Inertia goes to bodies and to the joints' armature (and to tendons' where links are coupled that no body
couples); springs and dampers to the elements that were read; each effect, by the elements of the simulation
that it consists of, to the element of MuJoCo that has the same law. A place that is no single joint is a
tendon along x_a − x_b.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import lsq_linear

from invid.effects.elements import (
    AddedBase,
    AddedDamper,
    AddedMass,
    AddedSpring,
    Element,
    ForceLaw,
    Law,
    StaticLaw,
    TorqueChannel,
)
from invid.errors import ModelError
from invid.exchange.linear_plant import effect_name
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm, Model
from invid.numerics.arrays import Float64
from invid.simulation.laws import elements_of
from invid.simulators.mujoco_plant import (
    HIDDEN,
    SMALL,
    Handle,
    MjcfPlant,
    handles_between,
    mass_matrix,
    steps_of,
)
from invid.simulators.mujoco_surroundings import tendon_row

HARD = (6e-4, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""solref and solimp of dry friction: MuJoCo's default gives way like a viscous damper at low speed."""
STIFF_BRISTLE = 1e-4
"""Deflection [rad or m] at which a bristle slides, for friction with a Stribeck curve and no presliding."""
_NO_INPUT = int(mujoco.mjtCtrlInput.mjINPUT_NONE)
NO_PLAY = 1e-6
"""Share of its play that a joint keeps where the machine has none: MuJoCo takes no limits without room."""
LEAST = 1e-3
"""Share of itself that a body keeps at least: MuJoCo takes none without inertia."""
KEPT = 1e-3
"""Weight of the inertias as they were beside the ones asked for: it decides between a body and its joint."""


class SpecCopy:
    """The XML while it is corrected."""

    def __init__(self, plant: MjcfPlant) -> None:
        self.plant, self.spec, self.lost = plant, plant.spec.copy(), list[str]()
        self.flat = [k for chain in plant.order for k in chain]
        self.made: dict[tuple[int, int], Any] = {}

    def coordinate(self, k: int) -> int:
        """Coordinate of the XML for one of the model."""
        return -1 if k < 0 else self.flat[k]

    def joints_along(self, a: int, b: int) -> list[tuple[str, float]]:
        row = self.plant.positions[a] - (self.plant.positions[b] if b >= 0 else 0.0)
        names = [self.plant.compiled.joint(k).name for k in range(row.size)]
        return [(n, float(c)) for n, c in zip(names, row, strict=True) if c]

    def tendon(self, a: int, b: int) -> Any:
        """A tendon more along x_a − x_b."""
        out = self.spec.add_tendon(name=f"{self.plant.axes[0]} {len(self.spec.tendons)} corrected")
        for joint, share in self.joints_along(a, b):
            out.wrap_joint(joint, share)
        return out

    def place(self, a: int, b: int) -> Any:
        """The joint that is x_a itself, else a tendon along x_a − x_b, the same for all that lies there."""
        along = self.joints_along(a, b)
        if len(along) == 1 and along[0][1] == 1.0:
            return self.spec.joint(along[0][0])
        if (a, b) not in self.made:
            self.made[a, b] = self.tendon(a, b)
        return self.made[a, b]

    def element(self, h: Handle) -> Any:
        return self.spec.joint(h.name) if h.kind == "joint" else self.spec.tendon(h.name)

    def actuator(self, at: Any, name: str) -> Any:
        """An actuator without input on a joint or tendon."""
        is_joint = isinstance(at, mujoco.MjsJoint)
        kind = mujoco.mjtTrn.mjTRN_JOINT if is_joint else mujoco.mjtTrn.mjTRN_TENDON
        return self.spec.add_actuator(name=f"{name} {len(self.spec.actuators)}", trntype=kind, target=at.name)


def correct(plant: MjcfPlant, model: Model) -> tuple[str, list[str]]:
    """The corrected XML, and in sentences what MuJoCo cannot hold of the model."""
    copy = linear_copy(plant, model)
    for term in beyond_weight(plant, model):
        try:
            for element in elements_of(model.chains, term):
                reason = _write(copy, element)
                if reason:
                    copy.lost.append(f"{effect_name(term)}: {reason}")
        except ModelError as error:
            copy.lost.append(f"{effect_name(term)}: {error}")
    for joint in plant.locked:
        joint.put_back(copy.spec)
    copy.spec.compile()
    return str(copy.spec.to_xml()), copy.lost


def linear_copy(plant: MjcfPlant, model: Model) -> SpecCopy:
    """A copy with the chains of a model, and nothing yet of its effects."""
    if plant.model is None or plant.model.chains.masses_per_branch != model.chains.masses_per_branch:
        raise ModelError(
            "its joints and springs are no chains of masses like those identified; it is compared alone"
        )
    copy = SpecCopy(plant)
    _cleared(copy)
    _inertia(copy, model)
    _springs(copy, model)
    return copy


def beyond_weight(plant: MjcfPlant, model: Model) -> list[EffectTerm]:
    """Effects of a model, of gravity what the bodies' own weight is short of: nothing where that is within
    three standard deviations."""
    claimed = () if plant.model is None else plant.model.effects
    own = {(t.axis, t.element): t for t in claimed if t.cause == "gravity"}
    out = []
    for term in model.effects:
        last = len(model.chains.masses[model.chains.axes.index(term.axis)])
        there = own.get((term.axis, term.element or f"mass {last}"))
        if term.cause == "gravity" and there is not None:
            ours, theirs = (t.value("torque") * cmath.exp(1j * t.value("angle")) for t in (term, there))
            (size, angle), left = (term.parameters[n] for n in ("torque", "angle")), ours - theirs
            if size.std is not None and abs(left) < 3.0 * size.std:
                continue
            size, angle = replace(size, value=abs(left)), replace(angle, value=cmath.phase(left))
            term = replace(term, parameters={"torque": size, "angle": angle})
        out.append(term)
    return out


def _cleared(copy: SpecCopy) -> None:
    """Takes out what was read as an effect: the model says it anew, or that it is not there."""
    spec, m = copy.spec, copy.plant.compiled
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)
    for h in copy.plant.handles:
        e = copy.element(h)
        if h.b >= 0 and not {h.a, h.b}.isdisjoint(copy.plant.hidden):
            e.stiffness, e.damping = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]  # left turning by itself
            continue
        if any(k >= 0 and k not in copy.flat for k in (h.a, h.b)):
            continue
        if h.b < 0:
            e.frictionloss, e.damping = 0.0, [0.0, 0.0, 0.0]
            continue
        if e.springyield > 0.0:
            e.stiffness = [0.0, 0.0, 0.0]
        e.stiffness[1], e.stiffness[2] = 0.0, 0.0
        if h.play is not None:
            _between_stops(copy, h.play, NO_PLAY * max(h.gap, NO_PLAY))
        if h.kind == "tendon":
            e.springlength = [float(np.mean(m.tendon_lengthspring[m.tendon(h.name).id]))] * 2
    for motor in copy.plant.motors:
        for a in [a for a in spec.actuators if a.target == motor.joint]:
            if a.biastype == mujoco.mjtBias.mjBIAS_DCMOTOR and a.ctrlspec == _NO_INPUT:
                spec.delete(a)
        if motor.actuator:
            own = spec.actuator(motor.actuator)
            own.delay, own.nsample, own.dyntype = 0.0, 0, mujoco.mjtDyn.mjDYN_NONE


def _between_stops(copy: SpecCopy, joint: str, half: float) -> None:
    """Limits of a joint that is play, as far apart around their middle."""
    at = copy.spec.joint(joint)
    middle = float(np.mean(copy.plant.compiled.jnt_range[copy.plant.compiled.joint(joint).id]))
    at.range = [middle - half, middle + half]


@dataclass(frozen=True, eq=False)
class _Share:
    """What makes a part of the mass matrix of the joints: a unit of it, as much as there is, the least that
    may be, and what writes another value."""

    unit: Float64
    now: float
    least: float
    write: Callable[[float], None]


def _inertia(copy: SpecCopy, model: Model) -> None:
    """Masses and couplings of the model, by bodies, armatures and tendons' armatures, none below zero."""
    plant, flat, chains = copy.plant, copy.flat, model.chains
    wanted = plant.mass.copy()  # of what is no chain's: as it is
    wanted[np.ix_(flat, flat)] = 0.0
    for element in (e for t in model.effects if t.cause == "extra_mode" for e in elements_of(chains, t)):
        if isinstance(element, AddedMass) and (own := _own_hidden(copy, element.at)) is not None:
            wanted[own[1], own[1]] = element.mass
    wanted[flat, flat] = np.concatenate(chains.masses)
    ends = [chain[-1] for chain in plant.order]
    wanted[np.ix_(ends, ends)] += chains.couplings
    goal = plant.positions.T @ wanted @ plant.positions  # of the joints
    shares = [*_shares(copy), *_couples(copy, chains, least=1e-9 * goal.diagonal().max())]
    scale = np.sqrt(np.outer(goal.diagonal(), goal.diagonal()))
    rows = np.array([(x.unit / scale).ravel() for x in shares]).T
    size = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    now, low = np.array([x.now for x in shares]), np.array([x.least for x in shares])

    def fitted(target: Float64, weight: float, start: Float64, least: Float64) -> Float64:
        kept = weight * np.diag(size)
        both = np.vstack([rows, kept]), np.concatenate([target.ravel(), kept @ start])
        return np.asarray(lsq_linear(*both, (least, np.inf)).x, dtype=float)

    found = fitted(goal / scale, KEPT, now, low)
    # What keeping the old shares takes from the masses is given back, where there is room.
    left = goal / scale - (rows @ found).reshape(goal.shape)
    found = np.maximum(found + fitted(left, 1e-6, np.zeros_like(now), low - found), low)
    left = np.abs((rows @ found).reshape(goal.shape) - goal / scale)
    for k in np.flatnonzero(left.diagonal() > 1e-3):
        name = plant.compiled.joint(int(k)).name
        copy.lost.append(f"inertia at joint {name}: {left[k, k]:.1%} away, a body is too heavy")
    for (i, a), (j, b) in combinations(enumerate(ends), 2) if plant.plain else ():
        if left[a, b] > 1e-3:
            copy.lost.append(
                f"{_coupling(chains, i, j)}: two joints of a URDF are coupled by the links that both move"
            )
    for share, value in zip(shares, found, strict=True):
        share.write(float(value))


def _coupling(chains: CoupledChains, i: int, j: int) -> str:
    return f"coupling {chains.axes[i]}-{chains.axes[j]} ({chains.couplings[i, j]:.4g})"


def _shares(copy: SpecCopy) -> Iterator[_Share]:
    """The mass matrix of the joints by what makes it: a unit of each armature, each body as it is.

    Of a body whose weight the engine's gravity lets a joint feel the mass stays: scaled, it would weigh more.
    """
    plant, spec, m = copy.plant, copy.spec, copy.plant.spec.compile()
    whole, unit = mass_matrix(m), np.eye(m.nv)
    motors = {motor.joint for motor in plant.motors}
    for k in range(m.njnt):
        if not plant.plain or m.joint(k).name in motors:
            at = spec.joint(m.joint(k).name)
            yield _Share(np.outer(unit[k], unit[k]), float(m.dof_armature[k]), 0.0, partial(_arm, at))
    for t in range(m.ntendon):
        row = tendon_row(m, t)
        if row is not None and m.tendon_armature[t] > 0.0:
            at = spec.tendon(m.tendon(t).name)
            yield _Share(np.outer(row, row), float(m.tendon_armature[t]), 0.0, partial(_arm, at))
    for b in range(1, m.nbody):
        weighs, other = _weighs(m, b), plant.spec.compile()
        other.body_mass[b] *= 1.0 if weighs else 0.5
        other.body_inertia[b] *= 0.5
        mujoco.mj_setConst(other, mujoco.MjData(other))
        part = 2.0 * (whole - mass_matrix(other))
        if np.abs(part).max() > SMALL * np.abs(whole).max():
            yield _Share(part, 1.0, LEAST, partial(_scale_body, copy, b, weighs))


def _arm(at: Any, value: float) -> None:
    at.armature = value


def _scale_body(copy: SpecCopy, number: int, weighs: bool, factor: float) -> None:
    body, m = next(x for x in copy.spec.bodies if x.id == number), copy.plant.compiled
    body.explicitinertial = True
    body.mass = float(m.body_mass[number]) * (1.0 if weighs else factor)
    body.inertia = m.body_inertia[number] * factor
    body.ipos, body.iquat = m.body_ipos[number], m.body_iquat[number]
    body.fullinertia = [math.nan] * 6


def _couples(copy: SpecCopy, chains: CoupledChains, least: float) -> Iterator[_Share]:
    """A unit of a tendon's armature between the ends of every two chains, with either sign; one below
    ``least`` is none."""
    plant, m = copy.plant, copy.plant.compiled

    def tie(name: str, row: Float64, value: float) -> None:
        if value > least:
            tendon = copy.spec.add_tendon(name=name)
            for k in np.flatnonzero(row):
                tendon.wrap_joint(m.joint(int(k)).name, float(row[k]))
            tendon.armature = value

    ends = [chain[-1] for chain in plant.order]
    trees = [int(m.body_rootid[m.jnt_bodyid[k]]) for k in range(m.njnt)]
    for (i, a), (j, b) in () if plant.plain else combinations(enumerate(ends), 2):
        if trees[a] == trees[b]:
            for sign in (1.0, -1.0):
                row = plant.positions[b] + sign * plant.positions[a]
                name = f"couple {b} {a} {'+' if sign > 0 else '-'}"
                yield _Share(np.outer(row, row), 0.0, 0.0, partial(tie, name, row))
        elif abs(chains.couplings[i, j]) > 1e-3 * math.sqrt(chains.masses[i][-1] * chains.masses[j][-1]):
            copy.lost.append(
                f"{_coupling(chains, i, j)}: the two links hang on different trees of bodies; "
                "hang one on the other"
            )


def _weighs(m: Any, b: int) -> bool:
    """Whether a joint feels the weight of a body, in the reference pose or a radian or metre away from it."""
    data = mujoco.MjData(m)
    felt = []
    for away in (0.0, 1.0):
        data.qpos[:] = m.qpos0 + away
        mujoco.mj_forward(m, data)
        jacobian = np.zeros((3, m.nv))
        mujoco.mj_jacBodyCom(m, data, jacobian, None, b)
        felt.append(float(np.abs(m.opt.gravity @ jacobian).max(initial=0.0)))
    return max(felt) > SMALL * float(np.linalg.norm(m.opt.gravity))


def _springs(copy: SpecCopy, model: Model) -> None:
    for chain, springs, dampers in zip(
        copy.plant.order, model.chains.springs, model.chains.dampers, strict=True
    ):
        for s, (a, b) in enumerate(pairwise(chain)):
            here = handles_between(copy.plant.handles, a, b)
            elastic = [h for h in here if h.elastic > 0.0]
            damped = [h for h in here if h.damping > 0.0] or elastic
            for part, goal, which in ((elastic, springs[s], "stiffness"), (damped, dampers[s], "damping")):
                for n, h in enumerate(part):  # the first takes all: springs side by side are one
                    value = [float(goal) / h.scale**2 if n == 0 else 0.0, 0.0, 0.0]
                    setattr(copy.element(h), which, value)


def _write(copy: SpecCopy, element: Element) -> str:
    """Puts one element of an effect into the XML; why not, where MuJoCo has none of its law."""
    match element:
        case ForceLaw():
            return _law(copy, element)
        case AddedDamper(a, b, c):
            copy.place(copy.coordinate(a), copy.coordinate(b)).damping[0] += c
        case AddedSpring(a, b, k):
            at = copy.tendon(copy.coordinate(a), copy.coordinate(b))
            at.stiffness[0], at.springlength = k, [0.0, 0.0]
        case AddedMass():
            _hidden_mass(copy, element)
        case TorqueChannel():
            return _torque_channel(copy, element)
        case StaticLaw():
            return "MuJoCo has no element of this law"
        case AddedBase():
            return (
                "all links would have to hang on a body of this mass on a spring to the world; put it under "
                "them by hand, the tree of bodies is left as it is"
            )
        case _:
            return "MuJoCo has no element for it"
    return ""


def _law(copy: SpecCopy, law: ForceLaw) -> str:
    a, b, p = copy.coordinate(law.a), copy.coordinate(law.b), law.parameters
    match law.law:
        case Law.DRY:
            return _dry(copy, a, p)
        case Law.ONE_SIDED_VISCOUS:
            copy.place(a, b).damping[0] += 0.5 * (p[0] + p[1])
            if not math.isclose(p[0], p[1], rel_tol=1e-3):
                return "viscous friction of the mean of both directions stands in its joint"
        case Law.SLIDER | Law.PAIR_SLIDER:
            at = copy.tendon(a, b)
            at.stiffness[0], at.springyield, at.springlength = p[0], p[1] / p[0], [0.0, 0.0]
        case Law.SINE:
            _ripple(copy, a, cogging=[-p[0], p[1], p[2]])
        case Law.CONSTANT:
            _constant(copy, a, -p[0])
        case Law.CUBIC:
            at = _spring_between(copy, a, b)
            at[0].stiffness[2] += p[0] / at[1] ** 4
        case Law.BACKLASH:
            return _play(copy, a, b, p[0])
        case _:
            return "MuJoCo has no element of this law"
    return ""


def _dry(copy: SpecCopy, a: int, p: Sequence[float]) -> str:
    """Levels up and down, then excess at rest and its velocity: frictionloss, or LuGre's Stribeck curve."""
    level, excess = 0.5 * (p[0] + p[1]), 0.5 * (p[2] + p[4]) if len(p) > 4 else 0.0
    at = copy.place(a, -1)
    if abs(excess) > 1e-6 * abs(level):
        bristle = max(level, level + excess) / STIFF_BRISTLE
        _ripple(copy, a, lugre=[bristle, 0.0, level, level + excess, p[3]])
    else:
        at.frictionloss += level
        at.solref_friction[:], at.solimp_friction[:] = HARD
    if abs(p[0] - p[1]) > 1e-3 * level:
        _constant(copy, a, -0.5 * (p[0] - p[1]))
    return ""


def _ripple(copy: SpecCopy, a: int, **law: list[float]) -> None:
    actuator = copy.actuator(copy.place(a, -1), "passive")
    actuator.set_to_dcmotor(motorconst=[0.0, 0.0], resistance=1.0, ctrlspec=_NO_INPUT, **law)


def _constant(copy: SpecCopy, a: int, torque: float) -> None:
    actuator = copy.actuator(copy.place(a, -1), "constant")
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.gainprm[0], actuator.biasprm[0] = 0.0, torque


def _spring_between(copy: SpecCopy, a: int, b: int) -> tuple[Any, float]:
    """The element that holds a chain's spring, and its scale."""
    h = next(h for h in handles_between(copy.plant.handles, a, b) if h.elastic > 0.0)
    return copy.element(h), abs(h.scale)


def _play(copy: SpecCopy, a: int, b: int, half: float) -> str:
    """A dead band in a tendon; the spring of a joint moves to a tendon for it."""
    own = next((h for h in handles_between(copy.plant.handles, a, b) if h.play is not None), None)
    if own is not None and own.play is not None:
        _between_stops(copy, own.play, half / own.play_share)
        return ""
    at, scale = _spring_between(copy, a, b)
    if isinstance(at, mujoco.MjsJoint):
        tendon = copy.tendon(a, b)
        tendon.stiffness = list(at.stiffness)
        at.stiffness = [0.0, 0.0, 0.0]
        at, scale = tendon, 1.0
        at.springlength = [0.0, 0.0]
    middle = float(np.mean(at.springlength)) if at.springlength[0] != -1.0 else 0.0
    at.springlength = [middle - half * scale, middle + half * scale]
    return ""


def _own_hidden(copy: SpecCopy, at: int) -> tuple[Handle, int] | None:
    """The element that ties a mass beside a chain which the XML has itself, and that mass."""
    plant, k = copy.plant, copy.coordinate(at)
    for h in plant.handles:
        other = h.a if h.b == k else h.b
        if h.b >= 0 and k in (h.a, h.b) and other in plant.hidden:
            return h, other
    return None


def _hidden_mass(copy: SpecCopy, element: AddedMass) -> None:
    """A body of its own, tied by a tendon: hung on the link it would load the links before as well."""
    damping = 2.0 * element.damping_ratio * math.sqrt(element.stiffness * element.mass)
    if (own := _own_hidden(copy, element.at)) is not None:
        tie, scale = copy.element(own[0]), own[0].scale ** 2
        tie.stiffness[0], tie.damping[0] = element.stiffness / scale, damping / scale
        return
    spec, m = copy.spec, copy.plant.compiled
    at = copy.coordinate(element.at)
    kind = int(m.jnt_type[at])
    gravity = np.array(spec.option.gravity, dtype=float)
    across = np.eye(3)[int(np.argmin(np.abs(gravity)))]
    name = f"{HIDDEN} {len(spec.bodies)}"
    inertia = element.mass if kind == int(mujoco.mjtJoint.mjJNT_HINGE) else 1e-3 * element.mass
    body = spec.worldbody.add_body(
        name=name, mass=element.mass, inertia=[inertia] * 3, ipos=[0.0] * 3, explicitinertial=True
    )
    body.add_joint(name=name, type=mujoco.mjtJoint(kind), axis=across)
    tendon = spec.add_tendon(name=f"{name} spring")
    for joint, share in [(name, -1.0), *copy.joints_along(at, -1)]:
        tendon.wrap_joint(joint, share)
    tendon.stiffness[0], tendon.springlength = element.stiffness, [0.0, 0.0]
    tendon.damping[0] = damping


def _torque_channel(copy: SpecCopy, channel: TorqueChannel) -> str:
    motor = copy.plant.motors[channel.axis]
    if not motor.actuator:
        return "no actuator of this motor takes a torque"
    own = copy.spec.actuator(motor.actuator)
    if channel.delay < 0.0:
        return "an actuator cannot act before its control"
    if channel.delay:
        own.delay, own.interp = channel.delay, 1
        own.nsample = steps_of(channel.delay, copy.spec.option.timestep)
    if channel.lag is not None:
        own.dyntype, own.dynprm[0] = mujoco.mjtDyn.mjDYN_FILTEREXACT, channel.lag
    own.gainprm[0] *= channel.gain
    if channel.limit is not None:
        own.forcelimited, own.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-channel.limit, channel.limit]
    return ""
