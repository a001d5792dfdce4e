"""The predicted motion of a planned experiment on the assumed plant.

The loop is closed as the sweep closes it: excitation held over each sample, and a PD hold on every
axis. It is solved on lines of the shifted Laplace plane s = σ + jω: with σ·T = 14 what wraps round the
record's end is a millionth, rounding errors 1e-10, and a record from rest needs no padding. Coulomb
friction enters as a torque of its own, iterated, since its sign follows the motion that it changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from invid.config import CellConfig
from invid.model.chains import CoupledChains
from invid.model.matrices import Condensed, Matrices, damper
from invid.numerics.arrays import Bool, Complex128, Float64
from invid.planning.belief import Belief
from invid.planning.hold_laws import centring, following, master_hold
from invid.planning.model import PlannedExperiment
from invid.planning.phases import lowest_frequency
from invid.recording.model import Kind

SHIFT = 14.0
PADDING = 0.05
"""Share of the record that is worked out beyond its end."""
ITERATIONS, RELAXATION = 8, 0.6
"""Of the friction torque. Empirical: converged to 1 % where friction is below half of the peak."""
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
    cycle, count = config.bus.cycle_s, experiment.cycles
    stiffness, damping = hold_gains(config, experiment, belief, drive_hold_hz)
    drive = experiment.torque
    if experiment.reference is not None:
        path = experiment.reference
        speed = np.diff(path, axis=0, prepend=path[:1]) / cycle
        drive = drive + stiffness * path + damping * speed
    # The last samples would carry the ringing of the jump from the record's end to its start.
    padded = count + max(round(PADDING * count), 64)
    drive = np.concatenate((drive, np.zeros((padded - count, drive.shape[1]))))
    sigma = SHIFT / (padded * cycle)
    fade = np.exp(-sigma * cycle * np.arange(padded))[:, None]
    # Ten times the band holds the harmonics of friction that still move a mass.
    top = max(10 * float(experiment.frequencies_hz.max(initial=5.0)), 100.0)
    inside = held_by_drive(config, experiment)
    loops = np.stack((stiffness, damping, inside, belief.viscous))
    found = _closed_loop(belief.chains, loops.tobytes(), cycle, padded, min(top, 0.45 / cycle))
    keep, s, held, law, answer = found

    def spectrum(values: Float64) -> Complex128:
        transformed: Complex128 = np.fft.rfft(values * fade, axis=0)[keep]
        return transformed

    def wave(values: Complex128) -> Float64:
        full = np.zeros((keep.size, values.shape[1]), dtype=complex)
        full[keep] = values
        over_time: Float64 = np.fft.irfft(full, n=padded, axis=0) / fade
        return over_time

    commanded = held[:, None] * spectrum(drive)
    friction = np.zeros_like(drive)
    motion = np.einsum("fij,fj->fi", answer, commanded)
    if belief.coulomb.any():
        for _ in range(ITERATIONS):
            velocity = wave(s[:, None] * motion)
            smooth = 1e-3 * np.maximum(np.sqrt(np.mean(velocity**2, axis=0)), 1e-300)
            new = -belief.coulomb * np.tanh(velocity / smooth)
            friction = new if not friction.any() else friction + RELAXATION * (new - friction)
            motion = np.einsum("fij,fj->fi", answer, commanded + spectrum(friction))
    position, velocity = wave(motion), wave(s[:, None] * motion)
    torque = drive - wave(law * motion)
    return Motion(position[:count], velocity[:count], torque[:count])


@lru_cache(maxsize=16)
def _closed_loop(
    chains: CoupledChains, loops: bytes, cycle: float, samples: int, top_hz: float
) -> tuple[Bool, Complex128, Complex128, Complex128, Complex128]:
    """Return which of the frequencies of a padded record are used, s (F,) [1/s], the hold (F,), the law
    (F, M) and the answer (F, M, M) of the motors' positions to torque.

    Kept, because a plan is lowered step by step and only its torque changes. ``loops`` are the bytes of
    (4, M) stiffness, damping, whether a loop is inside the drive, and viscous friction of each motor.
    """
    stiffness, damping, inside, viscous = np.frombuffer(loops).reshape(4, -1)
    sigma = SHIFT / (samples * cycle)
    omega = 2 * np.pi * np.fft.rfftfreq(samples, cycle)
    keep: Bool = omega <= 2 * np.pi * top_hz
    s: Complex128 = np.asarray(sigma + 1j * omega[keep], dtype=np.complex128)
    held: Complex128 = np.exp(-s * cycle / 2) * np.sinc(1j * s * cycle / 2 / np.pi)  # (1 − e^{−sh})/(sh)
    # A hold of the master answers a sample at the next SYNC, with the mean velocity of the last cycle, and
    # keeps its torque for a cycle; the loop inside a drive is fast against all that is shaken.
    z = np.exp(-s * cycle)[:, None]
    law: Complex128 = np.where(
        inside > 0,
        stiffness + damping * s[:, None],
        held[:, None] * z * (stiffness + damping * (1.0 - z) / cycle),
    )
    plant = Condensed.of(rubbing(chains, viscous).dynamic_stiffness(s), chains.motor_dofs.tolist()).stiffness
    index = np.arange(law.shape[1])
    plant[:, index, index] += law
    return keep, s, held, law, np.asarray(np.linalg.inv(plant), dtype=np.complex128)


def rubbing(chains: CoupledChains, viscous: Float64) -> Matrices:
    """Matrices of chains with viscous friction (M,) at their motors."""
    motors = zip(chains.motor_dofs.tolist(), viscous.tolist(), strict=True)
    return chains.matrices.plus([damper(value, at) for at, value in motors])
