"""MuJoCo as the engine of a user's XML."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout

from invid.errors import InputError
from invid.model.document import Model, save_text
from invid.numerics.arrays import Float64
from invid.simulators.guided import GUIDE, Guided, stiff_guide
from invid.simulators.mujoco_correct import correct
from invid.simulators.mujoco_plant import MjcfPlant, Motor, read_plant, steps_of
from invid.simulators.mujoco_surroundings import release_limits, without_missing_shapes

_IMPLICIT = (int(mujoco.mjtIntegrator.mjINT_IMPLICIT), int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST))
LARGEST_STEP = 0.4
"""Rate of the guide times the step: with an explicit step a critically damped guide is stable up to 0.8. Up
to here the step is the XML's own: implicit damping adds damping times step to every inertia."""

STICKS = 0.99
"""Share of dry friction's level below which a motor sticks."""


class MujocoSimulator:
    """An XML whose actuators drive the recorded axes, one a motor."""

    step = 0.0
    left_out: Sequence[str] = ()
    """Shapes that are not read."""

    def __init__(self, path: Path, axes: tuple[str, ...]) -> None:
        self.path = str(path)
        self.engine = f"MuJoCo {mujoco.__version__}"
        self.axes = axes
        try:
            self.plant: MjcfPlant = self._read(path)
        except (ValueError, mujoco.FatalError) as error:
            raise error if isinstance(error, InputError) else InputError(f"{path}: {error}") from None

    def _read(self, path: Path) -> MjcfPlant:
        spec = mujoco.MjSpec.from_file(str(path))
        try:
            spec.compile()
        except ValueError:
            # Files of shapes that did not come with it: where every link states its inertia none is needed.
            spec = mujoco.MjSpec.from_file(str(path))
            self.left_out = without_missing_shapes(spec)
            if not self.left_out:
                raise
        return read_plant(spec, self.axes, self.path)

    def prepared(self, records: Sequence[Guided]) -> list[str]:
        """See ``Simulator.prepared``: limits that the recorded motion or torque goes beyond."""
        m, said = self.plant.compiled, list(self.plant.said)
        said += [f"{x}: left out, every link states its inertia" for x in self.left_out]
        for i, motor in enumerate(self.plant.motors):
            joint = m.joint(motor.joint).id
            moved = np.concatenate([g.position[:, i] / motor.reduction for g in records])
            low, high = m.jnt_range[joint]
            if m.jnt_limited[joint] and (moved.min() < low or moved.max() > high):
                said.append(
                    f"joint {motor.joint}: its range {low:.4g} … {high:.4g} does not hold the recorded "
                    f"{moved.min():.4g} … {moved.max():.4g} (another zero); it was released"
                )
            force = np.concatenate([np.abs(g.torque[:, i]) * motor.reduction for g in records]).max()
            most = [m.jnt_actfrcrange[joint, 1]] if m.jnt_actfrclimited[joint] else []
            if motor.actuator:
                at = m.actuator(motor.actuator).id
                most += [m.actuator_forcerange[at, 1] * abs(float(m.actuator_gear[at, 0]))] * int(
                    m.actuator_forcelimited[at]
                )
            if most and force > min(most):
                said.append(
                    f"joint {motor.joint}: the file limits its torque to {min(most):.4g}, the recording has "
                    f"{force:.4g}; the limit was released"
                )
        return said

    def claimed(self) -> Model | None:
        """The chains and effects that the XML's elements are."""
        return self.plant.model

    def guide(self, given: Guided) -> tuple[Float64, Float64]:
        """See ``Simulator.guide``; the guide is an affine actuator a motor beside the user's own."""
        spec, plant = self.plant.spec.copy(), self.plant
        rate = 2 * np.pi * GUIDE * given.high
        stiffness, damping = stiff_guide(plant.motor_inertia, rate)
        if spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            # It holds a control over a step, and a stiff guide with it: the implicit one is as good there.
            spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        # Steps leap: the speed before a step is that of half a step ago; the one after it, which the implicit
        # integrators show a damper, is half a step on.
        late = int(spec.option.integrator) in _IMPLICIT
        every, torque, position, velocity = given.fine(
            min(plant.step, LARGEST_STEP / rate), speed=0.5 if late else -0.5
        )
        spec.option.timestep = given.interval / every
        for i, motor in enumerate(plant.motors):
            k, d = float(stiffness[i]), float(damping[i])
            guide = spec.add_actuator(
                name=f"guide {i}", target=motor.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            guide.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            guide.gainprm[0], guide.biasprm[1], guide.biasprm[2] = 1.0, -k, -d
            guide.gear[0] = motor.reduction
            if motor.actuator:
                own = spec.actuator(motor.actuator)
                own.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
                if own.delay:  # its buffer holds a sample a step
                    own.nsample = steps_of(own.delay, spec.option.timestep)
        release_limits(spec, plant.play)
        model = spec.compile()
        control = np.zeros((torque.shape[0], model.nu))
        for i, motor in enumerate(plant.motors):
            guide = model.actuator_ctrladr[model.actuator(f"guide {i}").id]
            control[:, guide] = stiffness[i] * (position[:, i] + motor.zero) + damping[i] * velocity[:, i]
            own = model.actuator_ctrladr[model.actuator(motor.actuator).id] if motor.actuator else guide
            control[:, own] += torque[:, i] * (motor.reduction / motor.gain)
        data = mujoco.MjData(model)
        plant.start(data, model, position[0], velocity[0])
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        first = np.zeros(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, first, kind)
        after, _ = rollout.rollout(model, data, first[None], control[None])
        states = np.concatenate([first[None], after[0]])
        if not np.isfinite(states).all():
            raise InputError(f"{self.path}: MuJoCo's simulation of experiment {given.key} runs away")
        force, moved = np.zeros_like(given.torque), np.zeros_like(given.torque)
        for i, motor in enumerate(plant.motors):
            joint = model.joint(motor.joint).id
            q = motor.reduction * states[:, 1 + model.jnt_qposadr[joint]]
            v = motor.reduction * states[:, 1 + model.nq + model.jnt_dofadr[joint]]
            q, v = q[:-1], v[1:] if late else v[:-1]
            away, slower = position[:, i] + motor.zero - q, velocity[:, i] - v
            force[:, i] = (stiffness[i] * away + damping[i] * slower)[::every]
            moved[:, i] = (position[:, i] - away)[::every]
            force[:, i] = self._beyond_stiction(
                model, motor, (states[:-1:every], control[::every]), force[:, i], v[::every], given.unmoved[i]
            )
        return force, moved

    def _beyond_stiction(
        self, model: Any, motor: Motor, run: tuple[Float64, Float64], guide: Float64, speed: Float64,
        unmoved: float,
    ) -> Float64:  # fmt: skip
        """(n,) what of a guide's torque is missing: of a motor that sticks, what dry friction cannot hold.

        There friction takes any torque up to its level, so that the guide's own is any as well.
        """
        dof = int(model.jnt_dofadr[model.joint(motor.joint).id])
        level = float(model.dof_frictionloss[dof]) / motor.reduction
        if not level:
            return guide
        data, out = mujoco.MjData(model), guide.copy()
        for k in np.flatnonzero(np.abs(speed) < unmoved):
            mujoco.mj_setState(model, data, run[0][k], mujoco.mjtState.mjSTATE_FULLPHYSICS)
            data.ctrl[:] = run[1][k]
            mujoco.mj_forward(model, data)
            friction = float(data.qfrc_constraint[dof]) / motor.reduction
            if abs(friction) < STICKS * level:
                held = friction + guide[k]
                out[k] = held - np.clip(held, -level, level)
        return out

    def corrected(self, model: Model, to: Path) -> tuple[MujocoSimulator, list[str]]:
        """See ``Simulator.corrected``."""
        text, lost = correct(self.plant, model)
        lost += [f"{x}: their files are missing" for x in self.left_out]
        save_text(to, text)
        return type(self)(to, self.axes), lost


def opened(path: Path, axes: tuple[str, ...]) -> Any:
    """The simulator."""
    return MujocoSimulator(path, axes)
