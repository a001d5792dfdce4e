"""The missing torque of every record, whitened, with its Jacobian: what the fit makes small.

r = Z(p) Θ − A(p) T + Σ c X, with A the time offset (and hold over the sample) of each axis' torque
and X further columns (friction at the motors, or what a caller adds). Its noise covariance is
C_r = [Z, −A] C_n [Z, −A]ᴴ, re-evaluated at every iterate; V = Σ rᴴ C_r⁻¹ r is the maximum-likelihood
cost of the errors-in-variables problem, and with the Jacobian taken at the projected measurement
Θ̂ = Θ − C_Θr C_r⁻¹ r its gradient is exact (envelope theorem).

Records that are not in steady state carry boundary terms (``model.transient_terms``), which are
projected out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from invid.likelihood.nuisance.torque_channel import Block, acting
from invid.model.parameters import ChainStructure
from invid.model.transient_terms import end_columns, end_derivative, end_forces, end_places, end_points
from invid.numerics.arrays import Bool, Complex128, Float64
from invid.numerics.whitening import factored, stack, whitener


@dataclass(frozen=True, eq=False)
class State:
    """Everything known about one block at one parameter vector, before whitening."""

    block: Block
    motion: Complex128
    """(F, ΣN, M) W."""
    stiffness: Complex128
    """(F, M, M) Z."""
    inner: Complex128
    """(F, ΣN, M) … see ``inner_inverse``; here Z_ii⁻¹ padded to all coordinates, (F, ΣN, ΣN)."""
    residual: Complex128
    """(F, M) missing torque r, boundary terms included."""
    jacobian: Complex128
    """(F, M, n) derivative of r by all parameters, at the projected measurement."""
    covariance: Complex128
    """(F, M, M) C_r."""
    root: Complex128
    """(F, M, M) its whitener."""
    basis: Float64
    """(2FM, 2ΣN or 0) orthonormal basis of the whitened boundary columns."""
    projected_position: Complex128
    """(F, M) Θ̂."""
    all_motion: Complex128
    """(F, ΣN) motion of all coordinates, boundary response included."""
    ends: Float64
    """(2ΣN,) end-minus-start position and velocity of every coordinate; empty without boundary terms."""


class Extra(Protocol):
    """Further torque-side terms with parameters of their own (effects, extra shapes)."""

    names: tuple[str, ...]

    def evaluate(
        self, block: Block, motion: Complex128, q: Complex128, x: Float64
    ) -> tuple[Complex128, Complex128]:
        """Contribution (F, M) to r and its derivative (F, M, len(names)) at values ``x``.

        ``motion`` is W (F, ΣN, M), ``q`` (F, ΣN) the motion of all coordinates.
        """
        ...


@dataclass(frozen=True, eq=False)
class MissingTorqueProblem:
    """Residual and Jacobian of all records.

    The parameter vector is: the structure's, delays [s] (lags of torque channels [s²] among them),
    staircase parameters [−], column coefficients, extra parameters.
    """

    structure: ChainStructure
    blocks: tuple[Block, ...]
    delay_names: tuple[str, ...] = ()
    staircase_names: tuple[str, ...] = ()
    column_names: tuple[str, ...] = ()
    extra: Extra | None = None
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Mean and standard deviation of parameters about which something is known beforehand."""
    fixed: tuple[str, ...] = ()
    """Names of parameters that do not move."""

    @property
    def names(self) -> tuple[str, ...]:
        """All parameters."""
        extra = () if self.extra is None else tuple(self.extra.names)
        return self.structure.names + self.delay_names + self.staircase_names + self.column_names + extra

    @property
    def slices(self) -> dict[str, slice]:
        """Where structure, delay, staircase, column, extra stand."""
        counts = {
            "structure": self.structure.count,
            "delay": len(self.delay_names),
            "staircase": len(self.staircase_names),
            "column": len(self.column_names),
            "extra": 0 if self.extra is None else len(self.extra.names),
        }
        out, at = {}, 0
        for kind, count in counts.items():
            out[kind] = slice(at, at + count)
            at += count
        return out

    @property
    def free(self) -> Bool:
        """(n,) parameters that move."""
        held = set(self.fixed)
        flags: Bool = np.array([name not in held for name in self.names])
        return flags

    def start(self, structure: Float64) -> Float64:
        """A full vector from the structure's parameters, the rest at its neutral value."""
        p = np.zeros(len(self.names))
        p[self.slices["structure"]] = structure
        for at, name in enumerate(self.names):
            if name in self.priors:
                p[at] = self.priors[name][0]
        return p

    # --- evaluation ----------------------------------------------------------------------------
    def states(self, p: Float64) -> list[State]:
        """Unwhitened quantities of every block."""
        plants: dict[bytes, tuple[Complex128, Complex128, Complex128]] = {}
        sp = p[self.slices["structure"]]
        inertance = self.structure.inertance(sp)
        out = []
        for block in self.blocks:
            key = block.omega.tobytes()
            if key not in plants:
                plants[key] = condense_dense(self.structure, sp, block.omega)
            out.append(self._state(block, p, inertance, *plants[key]))
        return out

    def _state(
        self,
        block: Block,
        p: Float64,
        inertance: Float64,
        motion: Complex128,
        stiffness: Complex128,
        inner: Complex128,
    ) -> State:
        structure, s = self.structure, self.slices
        sp = p[s["structure"]]
        motors = structure.motors
        channel = acting(block, p[s["delay"]], p[s["staircase"]])
        factor = channel.factor
        effective = stiffness - _diagonal(channel.hold)
        residual = np.einsum("fij,fj->fi", effective, block.position) - factor * block.torque
        residual = residual - np.einsum("fij,fj->fi", stiffness, channel.folded @ inertance)
        both = np.concatenate((effective, -_diagonal(factor)), axis=2)
        cross = block.covariance @ both.conj().transpose(0, 2, 1)  # C_nr (F, 2M, M)
        covariance = both @ cross
        covariance = 0.5 * (covariance + covariance.conj().transpose(0, 2, 1))
        columns = s["column"]
        if columns.stop > columns.start:
            residual = residual + block.columns @ p[columns]
        free = np.einsum("fqm,fm->fq", motion, block.position)
        extra_jac = np.zeros((block.omega.size, motors, 0), dtype=complex)
        if self.extra is not None:
            contribution, extra_jac = self.extra.evaluate(block, motion, free, p[s["extra"]])
            residual = residual + contribution
        root = whitener(covariance)
        basis = np.zeros((2 * block.omega.size * motors, 0))
        forces = np.zeros((block.omega.size, structure.dofs, 0), dtype=complex)
        ends = np.zeros(0)
        if block.transient:
            forces = end_forces(structure, sp, block.omega, block.span)
            points = end_points(block.omega, block.step, block.span, ends_in=block.ends_in)
            boundary = end_columns(structure, motion, stiffness, forces, points)
            basis, back = factored(stack(root @ boundary))
            ends = -(back @ (basis.T @ stack(root @ residual[..., None])[:, 0]))
            residual = residual + boundary @ ends
            shift = points @ ends[end_places(structure)].reshape(2, motors)
        gain = np.linalg.solve(covariance, residual[..., None])[..., 0]
        noise = np.einsum("fcm,fm->fc", cross, gain)
        position = block.position - noise[:, :motors]
        if block.transient:
            position = position + shift
        torque = block.torque - noise[:, motors:]
        q = np.einsum("fqm,fm->fq", motion, position)
        if block.transient:
            q = q - np.einsum("fab,fb->fa", inner, forces @ ends)
        jacobian = np.empty((block.omega.size, motors, p.size), dtype=complex)
        jacobian[..., s["structure"]] = structure.torque_derivative(sp, block.omega, motion, q[None])[0]
        if block.transient:
            jacobian[..., s["structure"]] += end_derivative(
                structure, sp, block.omega, motion, ends, block.span
            )
        hold_torque = (block.hold * position)[..., None]
        jacobian[..., s["delay"]] = (
            -channel.by_delay * torque[..., None] - channel.hold_by_delay * hold_torque
        )
        command = torque + block.hold * position
        jacobian[..., s["staircase"]] = -channel.by_stair * command[..., None]
        jacobian[..., columns] = block.columns
        jacobian[..., s["extra"]] = extra_jac
        return State(
            block, motion, stiffness, inner, residual, jacobian, covariance, root, basis, position, q, ends
        )

    def evaluate(self, p: Float64) -> tuple[Float64, Float64]:
        """Whitened residual (rows,) and Jacobian (rows, free parameters), boundary terms projected out."""
        residuals, jacobians = [], []
        free = self.free
        for state in self.states(p):
            r = stack(state.root @ state.residual[..., None])[:, 0]
            j = stack(state.root @ state.jacobian[..., free])
            if state.basis.shape[1]:
                r = r - state.basis @ (state.basis.T @ r)
                j = j - state.basis @ (state.basis.T @ j)
            residuals.append(r)
            jacobians.append(j)
        for at, name in enumerate(self.names):
            if not free[at] or name not in self.priors:
                continue
            mean, std = self.priors[name]
            row = np.zeros((1, p.size))
            row[0, at] = 1.0 / std
            residuals.append(np.array([(p[at] - mean) / std]))
            jacobians.append(row[:, free])
        return np.concatenate(residuals), np.concatenate(jacobians)

    @property
    def dof(self) -> int:
        """Real degrees of freedom left for χ²."""
        rows = 0
        for block in self.blocks:
            rows += 2 * block.position.size
            rows -= 2 * self.structure.dofs if block.transient else 0
        free = self.free
        priors = sum(bool(f) and n in self.priors for f, n in zip(free, self.names, strict=True))
        return rows + priors - int(free.sum())

    def with_covariance(self, covariances: Sequence[Complex128]) -> MissingTorqueProblem:
        """The same problem with other noise covariances."""
        blocks = tuple(replace(b, covariance=c) for b, c in zip(self.blocks, covariances, strict=True))
        return replace(self, blocks=blocks)


def condense_dense(
    structure: ChainStructure, p: Float64, omega: Float64
) -> tuple[Complex128, Complex128, Complex128]:
    """W (F, ΣN, M), Z (F, M, M) and Z_ii⁻¹ padded to (F, ΣN, ΣN) by one batched solve.

    Works for any sign of the dampers, which ``invid.model.forward.condense`` (valid plants) need not.
    """
    mass, damping, stiffness = structure.matrices(p)
    full = stiffness + 1j * omega[:, None, None] * damping - (omega**2)[:, None, None] * mass
    motors, inner = list(structure.motor_dofs), list(structure.inner_dofs)
    lines = omega.size
    motion = np.zeros((lines, structure.dofs, len(motors)), dtype=complex)
    motion[:, motors] = np.eye(len(motors))
    inverse = np.zeros((lines, structure.dofs, structure.dofs), dtype=complex)
    if inner:
        rows = np.array(inner)
        block = np.linalg.inv(full[:, rows[:, None], rows])
        inverse[:, rows[:, None], rows] = block
        motion[:, rows] = -block @ full[:, rows[:, None], motors]
    stiff = full[:, motors] @ motion
    return motion, _complex(0.5 * (stiff + stiff.transpose(0, 2, 1))), inverse


def _complex(values: npt.ArrayLike) -> Complex128:
    result: Complex128 = np.asarray(values, dtype=np.complex128)
    return result


def _diagonal(values: Complex128) -> Complex128:
    out = np.zeros((*values.shape, values.shape[-1]), dtype=complex)
    index = np.arange(values.shape[-1])
    out[..., index, index] = values
    return out
