"""The predicted motion of a planned experiment on the assumed plant.

The loop is closed as the sweep closes it: excitation held over each sample, and a PD hold on every axis: the
master's answers a sample at the next SYNC, with the mean velocity of the last cycle, and keeps its torque
for a cycle; the loop inside a drive is fast against all that is shaken.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from invid.config import CellConfig
from invid.effects.elements import ForceLaw, Law, dry_parameters
from invid.model.chains import CoupledChains
from invid.model.matrices import damper, spring
from invid.numerics.arrays import Bool, Float64
from invid.planning.belief import Belief
from invid.planning.hold_laws import centring, following, master_hold
from invid.planning.model import PlannedExperiment
from invid.planning.phases import lowest_frequency
from invid.recording.model import Kind
from invid.simulation.kernel import march_held
from invid.simulation.laws import compiled_laws
from invid.simulation.plant import Step, discretise

DRIVE_HOLD_HZ = 10.0
"""Assumed bandwidth [Hz] of a position loop inside a drive (with a damping ratio of 0.7)."""


@dataclass(frozen=True, eq=False)
class Motion:
    """What a record would hold without noise; all (n, M), from the first cycle at rest.

    ``torque`` is what acts on the motor: excitation and hold.
    """

    position: Float64
    velocity: Float64
    torque: Float64


def hold_gains(
    config: CellConfig,
    experiment: PlannedExperiment,
    belief: Belief,
    drive_hold_hz: float = DRIVE_HOLD_HZ,
) -> tuple[Float64, Float64]:
    """(M,) stiffness and (M,) damping of the hold of every axis, as the sweep sets them."""
    cycle = config.bus.cycle_s
    stiffness, damping = np.zeros(len(config.axes)), np.zeros(len(config.axes))
    for i, axis in enumerate(config.axes):
        if i in experiment.excited:
            inertia = axis.inertia if axis.inertia is not None else float(belief.inertia[i])
            gains = (
                following(inertia, cycle)
                if experiment.kind is Kind.CONSTANT_VELOCITY
                else centring(inertia, lowest_frequency([experiment]), cycle)
            )
            stiffness[i], damping[i] = gains.stiffness, gains.damping
            continue
        held = master_hold(axis, cycle)
        if held is not None:
            stiffness[i], damping[i] = held.stiffness, held.damping
        else:
            omega = 2 * np.pi * drive_hold_hz
            stiffness[i] = belief.inertia[i] * omega**2
            damping[i] = 1.4 * belief.inertia[i] * omega
    return stiffness, damping


def held_by_drive(config: CellConfig, experiment: PlannedExperiment) -> Bool:
    """(M,) axes that stand still inside their drives."""
    return np.array(
        [i not in experiment.excited and a.hold.mode == "drive" for i, a in enumerate(config.axes)]
    )


def foretold_motion(
    config: CellConfig,
    experiment: PlannedExperiment,
    belief: Belief,
    *,
    drive_hold_hz: float = DRIVE_HOLD_HZ,
) -> Motion:
    """Motion of all motors over the whole experiment, from rest.

    ``drive_hold_hz`` is the bandwidth believed of the position loops inside the drives.
    """
    cycle = config.bus.cycle_s
    stiffness, damping = hold_gains(config, experiment, belief, drive_hold_hz)
    drive = experiment.torque
    if experiment.reference is not None:
        path = experiment.reference
        speed = np.diff(path, axis=0, prepend=path[:1]) / cycle
        drive = drive + stiffness * path + damping * speed
    inside = held_by_drive(config, experiment)
    loops = np.stack((stiffness * inside, damping * inside, belief.viscous))
    step, substeps = _sub_step(belief.chains, loops.tobytes(), cycle)
    motors = belief.chains.motor_dofs.astype(np.int64)
    rubs = zip(motors.tolist(), belief.coulomb.tolist(), strict=True)
    laws = compiled_laws(
        [ForceLaw(Law.DRY, at, -1, dry_parameters(c)) for at, c in rubs if c], np.zeros((1, 2))
    )
    hold = np.where(inside, 0.0, np.stack((stiffness, damping / cycle)))
    drive = np.ascontiguousarray(drive)
    motion, torque = np.zeros((*drive.shape, 2)), np.zeros(drive.shape)
    march_held(
        np.zeros(2 * belief.chains.dofs), step.compiled, laws, drive, hold, motors, substeps, motion, torque
    )
    position, velocity = motion[:, :, 0], motion[:, :, 1]
    return Motion(position, velocity, torque - inside * (stiffness * position + damping * velocity))


@lru_cache(maxsize=16)
def _sub_step(chains: CoupledChains, loops: bytes, cycle: float) -> tuple[Step, int]:
    """One sub-step, and how many make a cycle.

    Kept, because a plan is lowered step by step and only its torque changes. ``loops`` are the bytes of
    (3, M): stiffness and damping of the loops inside the drives, and viscous friction of each motor.
    """
    stiffness, damping, viscous = np.frombuffer(loops).reshape(3, -1)
    motors = zip(stiffness.tolist(), (viscous + damping).tolist(), chains.motor_dofs.tolist(), strict=True)
    held = chains.matrices.plus([e for k, d, at in motors for e in (spring(k, at), damper(d, at))])
    # Dry friction is solved within a sub-step: it must not span more than a radian of the fastest mode.
    substeps = max(1, int(np.ceil(cycle * held.natural[-1])))
    return discretise(held, cycle / substeps), substeps
