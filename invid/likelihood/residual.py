"""The missing torque of every record, whitened, with its Jacobian: what the identification minimises.

r = Z(p) Θ − A(p) T + Σ c X, with A the time offset (and zero-order hold) of each axis' torque and X further
columns (friction at the motors, or what a caller adds). Its noise covariance is C_r = [Z, −A] C_n [Z, −A]ᴴ,
re-evaluated at every iterate; V = Σ rᴴ C_r⁻¹ r is the maximum-likelihood cost of the errors-in-variables
problem, and with the Jacobian taken at the projected measurement Θ̂ = Θ − C_Θr C_r⁻¹ r its gradient is exact
(envelope theorem).

Records that are not in steady state carry boundary terms (``model.transient_terms``), which are projected
out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from invid.likelihood.nuisance.torque_channel import Block, ChannelTorque, channel_torque
from invid.model.parameters import ChainStructure
from invid.model.transient_terms import end_columns, end_derivative, end_forces, end_points, motor_end_indices
from invid.numerics.arrays import Bool, Complex128, Float64
from invid.numerics.whitening import factored, stack, whitener
from invid.signals.spectral_record import SpectralLines


@dataclass(frozen=True, eq=False)
class State:
    """One block evaluated at one parameter vector, before whitening; its Jacobian is computed on demand."""

    problem: MissingTorqueProblem
    block: Block
    p: Float64
    motion: Complex128
    """(F, ΣN, M) W."""
    stiffness: Complex128
    """(F, M, M) Z."""
    inner: Complex128
    """(F, ΣN, ΣN) Z_ii⁻¹."""
    channel: ChannelTorque
    effective: Complex128
    """(F, M, M) Z less what the torque channel holds."""
    residual: Complex128
    """(F, M) missing torque r, boundary terms included."""
    gain: Complex128
    """(F, M) C_r⁻¹ r."""
    covariance: Complex128
    """(F, M, M) C_r."""
    root: Complex128
    """(F, M, M) its whitener."""
    basis: Float64
    """(2FM, 2ΣN or 0) orthonormal basis of the whitened boundary columns."""
    forces: Complex128 | None
    """(F, ΣN, 2ΣN) boundary forces and ``points`` (F, 2), where the record does not close."""
    points: Complex128 | None
    ends: Float64
    """(2ΣN,) end-minus-start position and velocity of every coordinate; empty without boundary terms."""

    @cached_property
    def projected_position(self) -> Complex128:
        """(F, M) Θ̂."""
        block, structure = self.block, self.problem.structure
        noise = block.noise[:, : structure.motors]
        out: Complex128 = block.position - noise * np.einsum("fij,fi->fj", self.effective.conj(), self.gain)
        if self.points is not None:
            ends = self.ends[motor_end_indices(structure)].reshape(2, structure.motors)
            out = out + self.points @ ends
        return out

    @cached_property
    def white(self) -> Float64:
        """(rows,) whitened residual, boundary terms projected out."""
        out: Float64 = stack(self.root @ self.residual[..., None])[:, 0]
        return out - self.basis @ (self.basis.T @ out) if self.basis.shape[1] else out

    @cached_property
    def jacobian(self) -> Complex128:
        """(F, M, n) derivative of r by all parameters, at the projected measurement."""
        structure, s, block, channel = self.problem.structure, self.problem.slices, self.block, self.channel
        sp, position = self.p[s["structure"]], self.projected_position
        torque = block.torque + block.noise[:, structure.motors :] * channel.factor.conj() * self.gain
        q = np.einsum("fqm,fm->fq", self.motion, position)
        if self.forces is not None:
            q = q - np.einsum("fab,fb->fa", self.inner, self.forces @ self.ends)
        out: Complex128 = np.empty((*block.torque.shape, self.p.size), dtype=complex)
        out[..., s["structure"]] = structure.torque_derivative(sp, block.omega, self.motion, q[None])[0]
        if block.transient:
            out[..., s["structure"]] += end_derivative(
                structure, sp, block.omega, self.motion, self.ends, block.span
            )
        hold_torque = (block.hold * position)[..., None]
        out[..., s["delay"]] = -channel.by_delay * torque[..., None] - channel.hold_by_delay * hold_torque
        command = torque + block.hold * position
        out[..., s["staircase"]] = -channel.by_zoh_share * command[..., None]
        out[..., s["column"]] = block.columns
        return out


@dataclass(frozen=True, eq=False)
class MissingTorqueProblem:
    """Residual and Jacobian of all records.

    The parameter vector is: the structure's, delays [s] (lags of torque channels [s²] among them),
    staircase parameters [−], column coefficients.
    """

    structure: ChainStructure
    blocks: tuple[Block, ...]
    delay_names: tuple[str, ...] = ()
    staircase_names: tuple[str, ...] = ()
    column_names: tuple[str, ...] = ()
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Mean and standard deviation of parameters with prior knowledge."""
    fixed: tuple[str, ...] = ()
    """Names of fixed parameters."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return self.structure.names + self.delay_names + self.staircase_names + self.column_names

    @property
    def slices(self) -> dict[str, slice]:
        """Slices of the structure, delay, staircase and column parameters."""
        counts = {
            "structure": self.structure.count,
            "delay": len(self.delay_names),
            "staircase": len(self.staircase_names),
            "column": len(self.column_names),
        }
        out, at = {}, 0
        for kind, count in counts.items():
            out[kind] = slice(at, at + count)
            at += count
        return out

    @property
    def free(self) -> Bool:
        """(n,) whether a parameter is free."""
        held = set(self.fixed)
        flags: Bool = np.array([name not in held for name in self.names])
        return flags

    def start(self, structure: Float64) -> Float64:
        """(n,) full vector from the structure's parameters, the rest at its neutral value."""
        p = np.zeros(len(self.names))
        p[self.slices["structure"]] = structure
        for at, name in enumerate(self.names):
            if name in self.priors:
                p[at] = self.priors[name][0]
        return p

    # --- evaluation ----------------------------------------------------------------------------
    def states(self, p: Float64) -> list[State]:
        """Every block evaluated at ``p`` (n,), before whitening."""
        return list(self.each_state(p))

    def each_state(self, p: Float64) -> Iterator[State]:
        """The same, one after the other."""
        sp = p[self.slices["structure"]]
        plants = plants_of(self.structure, sp, self.blocks)
        inertance = self.structure.inertance(sp)
        for block, plant in zip(self.blocks, plants, strict=True):
            yield self._state(block, p, inertance, *plant)

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
        channel = channel_torque(block, p[s["delay"]], p[s["staircase"]])
        factor = channel.factor
        effective = stiffness - _diagonal(channel.hold)
        residual = np.einsum("fij,fj->fi", effective, block.position) - factor * block.torque
        residual = residual - np.einsum("fij,fj->fi", stiffness, channel.folded @ inertance)
        covariance = covariance_of_missing(effective, factor, block.noise)
        residual = residual + block.columns @ p[s["column"]]
        root = whitener(covariance)
        basis, ends = np.zeros((2 * residual.size, 0)), np.zeros(0)
        forces = points = None
        if block.transient:
            forces = end_forces(structure, sp, block.omega, block.span)
            points = end_points(block.omega, block.step, block.span, ends_in=block.ends_in)
            boundary = end_columns(structure, motion, stiffness, forces, points)
            basis, back = factored(stack(root @ boundary))
            ends = -(back @ (basis.T @ stack(root @ residual[..., None])[:, 0]))
            residual = residual + boundary @ ends
        gain = _as_complex(np.linalg.solve(covariance, residual[..., None])[..., 0])
        return State(
            self, block, p, motion, stiffness, inner, channel, effective, residual, gain, covariance, root,
            basis, forces, points, ends,
        )  # fmt: skip

    def residual_of(self, p: Float64, states: Sequence[State]) -> Float64:
        """(rows,) whitened residual, boundary terms projected out, and that of the priors."""
        priors = [(p[at] - mean) / std for at, (mean, std) in self._free_priors()]
        return np.concatenate([*(s.white for s in states), priors])

    def jacobian_of(self, states: Sequence[State]) -> Float64:
        """(rows, free parameters) derivative of that."""
        free, out = self.free, []
        for state in states:
            j = stack(state.root @ state.jacobian[..., free])
            out.append(j - state.basis @ (state.basis.T @ j) if state.basis.shape[1] else j)
        for at, (_, std) in self._free_priors():
            row = np.zeros((1, free.size))
            row[0, at] = 1.0 / std
            out.append(row[:, free])
        return np.concatenate(out)

    def _free_priors(self) -> list[tuple[int, tuple[float, float]]]:
        """Number, and mean and standard deviation, of the free parameters with prior knowledge."""
        free = self.free
        return [
            (k, self.priors[name]) for k, name in enumerate(self.names) if free[k] and name in self.priors
        ]

    def evaluate(self, p: Float64) -> tuple[Float64, Float64]:
        """Whitened residual (rows,) and Jacobian (rows, free parameters), boundary terms projected out."""
        states = self.states(p)
        return self.residual_of(p, states), self.jacobian_of(states)

    @property
    def dof(self) -> int:
        """Real degrees of freedom of χ²."""
        rows = 0
        for block in self.blocks:
            rows += 2 * block.position.size
            rows -= 2 * self.structure.dofs if block.transient else 0
        free = self.free
        priors = sum(bool(f) and n in self.priors for f, n in zip(free, self.names, strict=True))
        return rows + priors - int(free.sum())

    def with_noise(self, noise: Sequence[Float64]) -> MissingTorqueProblem:
        """The same problem with other noise powers (F, 2M) of its blocks."""
        blocks = tuple(replace(b, noise=n) for b, n in zip(self.blocks, noise, strict=True))
        return replace(self, blocks=blocks)


def covariance_of_missing(stiffness: Complex128, factor: Complex128, noise: Float64) -> Complex128:
    """(F, M, M) C_r of r = Z Θ − A T for ``stiffness`` (F, M, M), ``factor`` (F, M) and the noise power
    (F, 2M) of [Θ; T]."""
    motors = factor.shape[1]
    seen = stiffness * noise[:, None, :motors]
    out: Complex128 = seen @ stiffness.conj().transpose(0, 2, 1)
    index = np.arange(motors)
    out[:, index, index] += np.abs(factor) ** 2 * noise[:, motors:]
    return out


def plants_of(
    structure: ChainStructure, p: Float64, records: Sequence[SpectralLines]
) -> Iterator[tuple[Complex128, Complex128, Complex128]]:
    """``condense_dense`` of the structure's parameters for every record, once for each set of lines."""
    plants: dict[bytes, tuple[Complex128, Complex128, Complex128]] = {}
    for record in records:
        key = record.omega.tobytes()
        if key not in plants:
            plants[key] = condense_dense(structure, p, record.omega)
        yield plants[key]


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
    return motion, _as_complex(0.5 * (stiff + stiff.transpose(0, 2, 1))), inverse


def _as_complex(values: npt.ArrayLike) -> Complex128:
    result: Complex128 = np.asarray(values, dtype=np.complex128)
    return result


def _diagonal(values: Complex128) -> Complex128:
    out = np.zeros((*values.shape, values.shape[-1]), dtype=complex)
    index = np.arange(values.shape[-1])
    out[..., index, index] = values
    return out
