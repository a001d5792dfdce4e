"""The structured parameters: which numbers the fit moves and how they make mass, damping, stiffness.

Masses and springs (and springs to ground) move as logarithms, so they stay positive; dampers,
viscous friction and couplings move linearly and may cross zero during the fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from invid.model.chains import CoupledChains, add_link
from invid.numerics.arrays import Bool, Complex128, Float64


@dataclass(frozen=True)
class ChainStructure:
    """Shape of ``CoupledChains`` as a parameter vector.

    The vector holds, in this order: log masses (branch after branch), log springs, dampers,
    couplings (i < j), viscous friction of each motor (where ``viscous``) and of every further mass
    (where ``inner_viscous``), log springs to ground of the axes in ``grounded``.
    """

    sizes: tuple[int, ...]
    axes: tuple[str, ...]
    viscous: bool = True
    grounded: tuple[int, ...] = ()
    inner_viscous: bool = False

    # --- layout --------------------------------------------------------------------------------
    @property
    def motors(self) -> int:
        """M."""
        return len(self.sizes)

    @property
    def dofs(self) -> int:
        """ΣN_i."""
        return sum(self.sizes)

    @cached_property
    def motor_dofs(self) -> tuple[int, ...]:
        """Index of each motor among all coordinates."""
        return tuple(int(v) for v in np.concatenate(([0], np.cumsum(self.sizes)[:-1])))

    @cached_property
    def end_dofs(self) -> tuple[int, ...]:
        """Index of each final mass among all coordinates."""
        return tuple(int(v) - 1 for v in np.cumsum(self.sizes))

    @cached_property
    def inner_dofs(self) -> tuple[int, ...]:
        """Indices of all coordinates that are no motor."""
        return tuple(sorted(set(range(self.dofs)) - set(self.motor_dofs)))

    @cached_property
    def spring_pairs(self) -> tuple[tuple[int, int], ...]:
        """Coordinates that each spring (and its damper) joins."""
        return tuple(
            (start + q, start + q + 1)
            for start, n in zip(self.motor_dofs, self.sizes, strict=True)
            for q in range(n - 1)
        )

    @cached_property
    def coupling_pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of branches, i < j."""
        return tuple((i, j) for i in range(self.motors) for j in range(i + 1, self.motors))

    @cached_property
    def viscous_dofs(self) -> tuple[int, ...]:
        """Coordinates with viscous friction to ground."""
        return (self.motor_dofs if self.viscous else ()) + (self.inner_dofs if self.inner_viscous else ())

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Where each kind of parameter stands in the vector."""
        springs = len(self.spring_pairs)
        counts = {
            "mass": self.dofs,
            "spring": springs,
            "damper": springs,
            "coupling": len(self.coupling_pairs),
            "viscous": len(self.viscous_dofs),
            "ground_spring": len(self.grounded),
        }
        out, at = {}, 0
        for kind, count in counts.items():
            out[kind] = slice(at, at + count)
            at += count
        return out

    @property
    def count(self) -> int:
        """Length of the parameter vector."""
        return int(self.slices["ground_spring"].stop)

    @cached_property
    def logarithmic(self) -> Bool:
        """(n,) True for parameters that move as logarithms."""
        flags: Bool = np.zeros(self.count, dtype=bool)
        for kind in ("mass", "spring", "ground_spring"):
            flags[self.slices[kind]] = True
        return flags

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names as in ``invid.model.document.parameter_vector``, plus ``A1.viscous``."""
        names: list[str] = []
        for kind, less in (("mass", 0), ("spring", 1), ("damper", 1)):
            for axis, n in zip(self.axes, self.sizes, strict=True):
                names += [f"{axis}.{kind}.{q + 1}" for q in range(n - less)]
        names += [f"{self.axes[i]}-{self.axes[j]}.coupling" for i, j in self.coupling_pairs]
        for dof in self.viscous_dofs:
            branch = max(i for i, start in enumerate(self.motor_dofs) if start <= dof)
            q = dof - self.motor_dofs[branch]
            names.append(f"{self.axes[branch]}.viscous" + (f".{q + 1}" if q else ""))
        names += [f"{self.axes[i]}.ground_spring" for i in self.grounded]
        return tuple(names)

    # --- values --------------------------------------------------------------------------------
    def vector(self, chains: CoupledChains) -> Float64:
        """(n,) parameters of a plant of this shape."""
        p = np.zeros(self.count)
        s = self.slices
        p[s["mass"]] = np.log(np.concatenate(chains.masses))
        p[s["spring"]] = np.log(np.concatenate(chains.springs))
        p[s["damper"]] = np.concatenate(chains.dampers)
        p[s["coupling"]] = [chains.couplings[i, j] for i, j in self.coupling_pairs]
        if self.viscous:
            p[s["viscous"]][: self.motors] = chains.ground_dampers
        p[s["ground_spring"]] = [np.log(max(chains.ground_springs[i], 1e-300)) for i in self.grounded]
        return p

    def physical(self, p: Float64) -> Float64:
        """(n,) values in physical units."""
        result: Float64 = np.where(self.logarithmic, np.exp(np.where(self.logarithmic, p, 0.0)), p)
        return result

    def chains(self, p: Float64) -> CoupledChains:
        """The plant; negative dampers (possible during a fit) become zero."""
        values, s = self.physical(p), self.slices
        masses = _split(values[s["mass"]], self.sizes)
        links = [n - 1 for n in self.sizes]
        couplings = self.couplings(values)
        ground = self.grounds(values)
        return CoupledChains.build(
            masses,
            _split(values[s["spring"]], links),
            _split(np.maximum(values[s["damper"]], 0.0), links),
            couplings,
            ground_springs=ground,
            axes=self.axes,
        )

    def grounds(self, values: Float64) -> Float64:
        """(M,) stiffness of the springs from the motors to ground, from values in physical units."""
        out = np.zeros(self.motors)
        out[list(self.grounded)] = values[self.slices["ground_spring"]]
        return out

    def couplings(self, values: Float64) -> Float64:
        """(M, M) inertia couplings of the end masses, zero on the diagonal, from values in physical units."""
        out = np.zeros((self.motors, self.motors))
        for (i, j), value in zip(self.coupling_pairs, values[self.slices["coupling"]], strict=True):
            out[i, j] = out[j, i] = value
        return out

    def matrices(self, p: Float64) -> tuple[Float64, Float64, Float64]:
        """Mass, damping and stiffness matrix, (ΣN, ΣN) each."""
        return self.assembled(self.physical(p))

    def assembled(self, values: Float64) -> tuple[Float64, Float64, Float64]:
        """The same from physical values (n,), in which all three are linear."""
        s = self.slices
        mass = np.diag(values[s["mass"]])
        for (i, j), value in zip(self.coupling_pairs, values[s["coupling"]], strict=True):
            a, b = self.end_dofs[i], self.end_dofs[j]
            mass[a, b] += value
            mass[b, a] += value
        stiffness, damping = np.zeros_like(mass), np.zeros_like(mass)
        for matrix, kind in ((stiffness, "spring"), (damping, "damper")):
            for (a, b), value in zip(self.spring_pairs, values[s[kind]], strict=True):
                add_link(matrix, a, b, value)
        rubbing = list(self.viscous_dofs)
        damping[rubbing, rubbing] += values[s["viscous"]]
        for i, value in zip(self.grounded, values[s["ground_spring"]], strict=True):
            stiffness[self.motor_dofs[i], self.motor_dofs[i]] += value
        return mass, damping, stiffness

    # --- the chain rule --------------------------------------------------------------------------
    def torque_derivative(self, p: Float64, omega: Float64, motion: Complex128, q: Complex128) -> Complex128:
        """(R, F, M, n) derivative of Wᵀ Z_full q by every parameter.

        ``motion`` W is (F, ΣN, M); ``q`` (R, F, ΣN) the motion of all coordinates in R records.
        ∂Z/∂K = (w_a − w_b)(w_a − w_b)ᵀ, jω times that for a damper, −ω² w wᵀ for a mass,
        −ω²(w_a w_bᵀ + w_b w_aᵀ) for a coupling.
        """
        records, lines = q.shape[:2]
        out = np.empty((records, lines, motion.shape[2], self.count), dtype=complex)
        s, values = self.slices, self.physical(p)
        w = motion.transpose(0, 2, 1)  # (F, M, ΣN)
        w2 = (omega**2)[:, None, None]
        jw = (1j * omega)[:, None, None]
        out[..., s["mass"]] = (-w2 * w * values[s["mass"]])[None] * q[:, :, None, :]
        a = [pair[0] for pair in self.spring_pairs]
        b = [pair[1] for pair in self.spring_pairs]
        link = (w[:, :, a] - w[:, :, b])[None] * (q[:, :, a] - q[:, :, b])[:, :, None, :]
        out[..., s["spring"]] = link * values[s["spring"]]
        out[..., s["damper"]] = link * jw
        for at, (i, j) in enumerate(self.coupling_pairs):
            e, f = self.end_dofs[i], self.end_dofs[j]
            out[..., s["coupling"].start + at] = -w2[None, ..., 0] * (
                w[None, :, :, e] * q[:, :, None, f] + w[None, :, :, f] * q[:, :, None, e]
            )
        motors = list(self.motor_dofs)
        rubbing = list(self.viscous_dofs)
        out[..., s["viscous"]] = (jw * w[:, :, rubbing])[None] * q[:, :, None, rubbing]
        if self.grounded:
            at_ground = [motors[i] for i in self.grounded]
            out[..., s["ground_spring"]] = (w[:, :, at_ground] * values[s["ground_spring"]])[None] * q[
                :, :, None, at_ground
            ]
        return out


def _positive(step: Float64) -> Float64:
    """1 + step, and an exponential of the same slope below a half, so that it stays positive."""
    result: Float64 = np.where(step > -0.5, 1.0 + step, 0.5 * np.exp(2.0 * np.minimum(step, -0.5) + 1.0))
    return result


def _split(values: Float64, counts: Sequence[int]) -> list[Float64]:
    return list(np.split(values, np.cumsum(counts)[:-1]))


def structure_of(chains: CoupledChains, *, viscous: bool = True) -> ChainStructure:
    """The structure of a given plant; its springs to ground are kept as parameters."""
    grounded = tuple(int(i) for i in np.flatnonzero(chains.ground_springs > 0))
    return ChainStructure(chains.masses_per_branch, chains.axes, viscous, grounded)
