"""Transients: contribution of the ends of records that do not close, with effects in the plant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from invid.effects.motion import Closing, View
from invid.likelihood.hypothesis import Layout
from invid.likelihood.placed_effect import Candidate, coupled_impedances, linear_effects
from invid.model.parameters import ChainStructure
from invid.model.transient_terms import end_columns, end_forces, end_points, motor_end_indices
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.whitening import orthonormal, stack, unstack, unwhitener, whitener


@dataclass(frozen=True, eq=False)
class Ends:
    """Responses to a unit jump of each coordinate's position, then velocity, then of effects' own masses;
    lines with 0 Hz first."""

    torque: Complex128
    """(F, M, 2ΣN) missing torque."""
    motion: Complex128
    """(F, ΣN, 2ΣN) motion of every coordinate besides that of the motors' sampled spectra."""
    inner: Complex128
    """(F, ΣN, 2ΣN) the same without the response to the motors' own end points."""

    def with_effects(self, view: View, candidate: Candidate) -> Ends:
        """The responses with effects that are linear in motion, those of their own masses last."""
        torque, motion = jump_response(view, candidate, self.motion)
        own = torque.shape[-1] - self.torque.shape[-1]

        def padded(plant: Complex128) -> Complex128:
            return np.pad(plant, ((0, 0), (0, 0), (0, own)))

        torque, inner = padded(self.torque) + torque, padded(self.inner) + motion
        return replace(self, torque=torque, motion=padded(self.motion) + motion, inner=inner)


def record_ends(view: View, layout: Layout, p: Float64) -> Ends:
    """The responses to jumps at the ends of a record without effects."""
    structure, record = layout.structure, view.record
    forces = end_forces(structure, p[: structure.count], view.omega, record.span)
    forces[0] *= 0.5
    points = end_points(view.omega, record.step, record.span, ends_in=record.ends_in)
    points[0] = 0.0  # positions carry no mean here
    inner: Complex128 = -(view.inner @ forces)
    moved: Complex128 = inner + view.motion @ _end_spectra(structure, points)
    return Ends(end_columns(structure, view.motion, view.stiffness, forces, points), moved, inner)


def jump_response(view: View, candidate: Candidate, moved: Complex128) -> tuple[Complex128, Complex128]:
    """(F, M, k) missing torque and (F, ΣN, k) motion of effects linear in motion for unit jumps, those of the
    plant's coordinates first, then those of the masses that effects have of their own.

    ``moved`` is the motion of the linear plant for its jumps. A record that does not close does not close for
    an effect's mass either: a light mode that rings on from before the record was else answered with a second
    mode at the same frequency on the next mass. Each effect feels what the others do.
    """
    effects, plant = linear_effects(candidate), moved.shape[-1]
    if not effects:
        torque = np.zeros((*view.acting.shape, plant), dtype=np.complex128)
        return torque, np.zeros((*view.base.shape, plant), dtype=np.complex128)
    alone = [effect.of_jumps(view, place, x.tolist(), moved) for effect, place, x in effects]
    own = [(k, effect.of_own_jumps(view, place, x.tolist())) for k, (effect, place, x) in enumerate(effects)]
    masses = [(k, force) for k, force in own if force is not None]
    forces = np.zeros((view.omega.size, len(alone), plant + 2 * len(masses)), dtype=complex)
    forces[..., :plant] = np.stack(alone, axis=1)
    for number, (k, force) in enumerate(masses):
        forces[:, k, plant + 2 * number : plant + 2 * number + 2] = force
    coupled = coupled_impedances(view, effects)
    forces = coupled.coupling @ forces
    return coupled.condensed_force @ forces, -(coupled.inner_receptance @ forces)


def solve_record_ends(view: View, ends: Ends, root: Complex128, linear: Complex128) -> Closing:
    """The regularised map from missing torque to jumps: least squares with the size of the motion as prior.

    Jumps that the motors hardly feel would else be noise many times the motion that laws are read from.
    ``linear`` (F, M) is the missing torque without effects.
    """
    scale = np.ones(ends.torque.shape[-1])
    scale[: view.jump_bound.size] = view.jump_bound
    whitened: Complex128 = root @ (ends.torque * scale)
    scaled = stack(whitened)
    inverse = np.linalg.inv(scaled.T @ scaled + np.eye(scale.size))
    # Re(conj(a)·b) summed over lines is the product of stacked real numbers.
    along: Complex128 = np.einsum("fmj,fmn->jfn", whitened.conj(), root)
    gain: Complex128 = -(scale[:, None] * inverse) @ along.reshape(scale.size, -1)
    return Closing(ends.inner, gain.reshape(along.shape), ends.torque, linear)


def project_out_ends(
    view: View, layout: Layout, p: Float64, r: Complex128, covariance: Complex128
) -> tuple[Complex128, float]:
    """(P, F, M) ``r`` of lines 1…F of P periods with the transients between their ends projected out.

    A period of a motion that still settles does not close: its ends jump, each period's in its own way. Also
    returns the share of each period's numbers that is left as degrees of freedom.
    """
    root = whitener(covariance)
    basis = orthonormal(stack(root @ record_ends(view, layout, p).torque[1:]))
    back = unwhitener(root)
    out = r.copy()
    for period in out:
        ends = basis @ (basis.T @ stack(root @ period[..., None])[:, 0])
        period -= unstack(back, ends, period.shape)
    return out, 1.0 - basis.shape[1] / (2.0 * r[0].size)


def _end_spectra(structure: ChainStructure, points: Complex128) -> Complex128:
    """(F, M, 2ΣN) change of the motors' sampled spectra by their end ``points`` (F, 2), for unit jumps."""
    motors = structure.motors
    out = np.zeros((points.shape[0], motors, 2 * structure.dofs), dtype=complex)
    at_position, at_speed = motor_end_indices(structure).reshape(2, -1)
    out[:, np.arange(motors), at_position] = points[:, :1]
    out[:, np.arange(motors), at_speed] = points[:, 1:]
    return out
