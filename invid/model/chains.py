"""``CoupledChains``: M parallel chains of masses and springs, final masses coupled through inertia.

Branch i is a chain of N_i masses (the motor first) joined by N_i − 1 springs, each with a damper
parallel to it. The final masses of all branches are coupled through off-diagonal inertia
(eq. 1 of the paper). Optionally a motor is held to ground by a spring and a damper: that is what
a P or PD hold is, and what an axis without a rigid mode has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from invid.errors import ModelError
from invid.model.matrices import Matrices, Part, coupling, damper, mass, spring
from invid.numerics.arrays import Float64, frozen_float


@dataclass(frozen=True, eq=False)
class CoupledChains:
    """The linear elastic model.

    Parameters
    ----------
    masses
        Per branch, N_i masses, the motor first [kg·m² or kg], all > 0.
    springs
        Per branch, N_i − 1 stiffnesses [N·m/rad or N/m], all > 0.
    dampers
        Per branch, N_i − 1 dampers parallel to the springs [N·m·s/rad or N·s/m], all ≥ 0.
        ``None``: no damping.
    couplings
        (M, M) symmetric, zero diagonal: off-diagonal inertia between the final masses [kg·m² or kg].
        ``None``: none.
    ground_springs, ground_dampers
        (M,) stiffness and damping from each motor to ground; zero for a free axis.
    axes
        Names used in messages; ``None``: A1, A2, …

    Raises
    ------
    ModelError
        Where a shape, a sign or the positive definiteness of the mass matrix is wrong; says which
        branch and value.
    """

    masses: tuple[Float64, ...]
    springs: tuple[Float64, ...]
    dampers: tuple[Float64, ...] = ()
    couplings: Float64 = field(default_factory=lambda: np.zeros((0, 0)))
    ground_springs: Float64 = field(default_factory=lambda: np.zeros(0))
    ground_dampers: Float64 = field(default_factory=lambda: np.zeros(0))
    axes: tuple[str, ...] = ()

    @classmethod
    def build(
        cls,
        masses: Sequence[npt.ArrayLike],
        springs: Sequence[npt.ArrayLike],
        dampers: Sequence[npt.ArrayLike] | None = None,
        couplings: npt.ArrayLike | None = None,
        *,
        ground_springs: npt.ArrayLike | None = None,
        axes: Sequence[str] | None = None,
    ) -> CoupledChains:
        """Checked constructor from anything array-like."""
        count = len(masses)
        return cls(
            masses=tuple(frozen_float(np.atleast_1d(np.asarray(m, dtype=float))) for m in masses),
            springs=tuple(frozen_float(np.asarray(k, dtype=float).reshape(-1)) for k in springs),
            dampers=()
            if dampers is None
            else tuple(frozen_float(np.asarray(d, dtype=float).reshape(-1)) for d in dampers),
            couplings=frozen_float(np.zeros((count, count)) if couplings is None else couplings),
            ground_springs=frozen_float(np.zeros(count) if ground_springs is None else ground_springs),
            axes=tuple(axes) if axes is not None else (),
        )

    def __post_init__(self) -> None:
        count = len(self.masses)
        if count == 0:
            raise ModelError("model: no branch given; at least one branch with one mass is needed")
        if not self.axes:
            object.__setattr__(self, "axes", tuple(f"A{i + 1}" for i in range(count)))
        if not self.dampers:
            object.__setattr__(self, "dampers", tuple(frozen_float(np.zeros(k.size)) for k in self.springs))
        for name in ("couplings", "ground_springs", "ground_dampers"):
            if getattr(self, name).size == 0:
                shape = (count, count) if name == "couplings" else (count,)
                object.__setattr__(self, name, frozen_float(np.zeros(shape)))
        self._check()

    def _check(self) -> None:
        count = self.branches
        if len(self.axes) != count:
            raise ModelError(f"model: {len(self.axes)} axis names for {count} branches")
        if len(set(self.axes)) != count:
            raise ModelError(f"model: axis names must differ, found {list(self.axes)}")
        if len(self.springs) != count or len(self.dampers) != count:
            raise ModelError(
                f"model: {count} branches of masses but {len(self.springs)} of springs and "
                f"{len(self.dampers)} of dampers; give one list per branch (empty for a single mass)"
            )
        self._check_branches()
        self._check_couplings()
        for name in ("ground_springs", "ground_dampers"):
            values = getattr(self, name)
            if values.shape != (count,) or not np.isfinite(values).all():
                raise ModelError(f"model: {name} must be {count} finite numbers")
        smallest = float(np.linalg.eigvalsh(self.end_mass_matrix)[0])
        if smallest <= 0:
            i, j = self._worst_coupling()
            raise ModelError(
                f"model: the mass matrix is not positive definite: the coupling {self.couplings[i, j]:.6g} "
                f"between {self.axes[i]} and {self.axes[j]} is too large for the final masses "
                f"{self.masses[i][-1]:.6g} and {self.masses[j][-1]:.6g}"
            )

    def _check_branches(self) -> None:
        for axis, m, k, d in zip(self.axes, self.masses, self.springs, self.dampers, strict=True):
            if m.ndim != 1 or m.size == 0:
                raise ModelError(f"branch {axis}: masses must be a list of at least one value")
            if k.shape != (m.size - 1,):
                raise ModelError(
                    f"branch {axis}: {m.size} masses have one spring between neighbours, {m.size - 1} in "
                    f"all; found {k.size}"
                )
            if d.shape != k.shape:
                raise ModelError(
                    f"branch {axis}: each spring has a damper (0 for none): found {k.size} springs and "
                    f"{d.size} dampers"
                )
            for what, values, floor_ok in (("mass", m, False), ("spring", k, False), ("damper", d, True)):
                bad = ~np.isfinite(values) | (values < 0) | ((values == 0) & (not floor_ok))
                if bad.any():
                    q = int(np.flatnonzero(bad)[0])
                    raise ModelError(
                        f"branch {axis}: {what} {q + 1} is {float(values[q])!r}; it must be a finite number "
                        f"{'≥' if floor_ok else '>'} 0"
                    )

    def _check_couplings(self) -> None:
        count = self.branches
        if self.couplings.shape != (count, count):
            raise ModelError(f"model: couplings have shape {self.couplings.shape}, need ({count}, {count})")
        if not np.isfinite(self.couplings).all():
            raise ModelError("model: couplings hold a value that is not finite")
        if not np.allclose(self.couplings, self.couplings.T, rtol=1e-12, atol=0) or np.any(
            np.diag(self.couplings) != 0
        ):
            raise ModelError("model: couplings must be symmetric with a zero diagonal")

    def _worst_coupling(self) -> tuple[int, int]:
        ends = np.array([m[-1] for m in self.masses])
        ratio = np.abs(self.couplings) / np.sqrt(np.outer(ends, ends))
        i, j = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
        return int(i), int(j)

    # --- shape ---------------------------------------------------------------------------------
    @property
    def branches(self) -> int:
        """M, the number of branches (and motors)."""
        return len(self.masses)

    @property
    def masses_per_branch(self) -> tuple[int, ...]:
        """N_i per branch."""
        return tuple(int(m.size) for m in self.masses)

    @property
    def dofs(self) -> int:
        """ΣN_i, the number of coordinates."""
        return sum(self.masses_per_branch)

    @property
    def motor_dofs(self) -> npt.NDArray[np.intp]:
        """(M,) index of each motor among all coordinates (branch after branch)."""
        return np.concatenate(([0], np.cumsum(self.masses_per_branch)[:-1])).astype(np.intp)

    @property
    def end_dofs(self) -> npt.NDArray[np.intp]:
        """(M,) index of each final mass among all coordinates."""
        return (np.cumsum(self.masses_per_branch) - 1).astype(np.intp)

    # --- matrices ------------------------------------------------------------------------------
    @property
    def end_mass_matrix(self) -> Float64:
        """(M, M) block M_c of the final masses with their couplings."""
        block: Float64 = np.diag([m[-1] for m in self.masses]) + self.couplings
        return block

    @property
    def rigid_mass_matrix(self) -> Float64:
        """(M, M) rigid mass matrix S: branch sums on the diagonal, couplings beside it."""
        rigid: Float64 = np.diag([m.sum() for m in self.masses]) + self.couplings
        return rigid

    @property
    def parts(self) -> tuple[Part, ...]:
        """Every element, in the order of ``document.parameter_vector``, then what damps motors to ground."""
        out: list[Part] = []
        for i, first in enumerate(self.motor_dofs.tolist()):
            out += [mass(value, first + q) for q, value in enumerate(self.masses[i].tolist())]
            out += [spring(k, first + q, first + q + 1) for q, k in enumerate(self.springs[i].tolist())]
            out += [damper(d, first + q, first + q + 1) for q, d in enumerate(self.dampers[i].tolist())]
            out += [spring(k, first) for k in (float(self.ground_springs[i]),) if k]
        ends = self.end_dofs.tolist()
        for i, j in combinations(range(self.branches), 2):
            out.append(coupling(float(self.couplings[i, j]), ends[i], ends[j]))
        grounds = zip(self.motor_dofs.tolist(), self.ground_dampers.tolist(), strict=True)
        return (*out, *(damper(d, at) for at, d in grounds if d))

    @property
    def matrices(self) -> Matrices:
        """Stiffness, damping and inertia, (ΣN, ΣN) each, what goes to ground included."""
        return Matrices.of(self.dofs, self.parts)

    @property
    def mass_matrix(self) -> Float64:
        """(ΣN, ΣN) mass matrix."""
        return self.matrices.mass

    @property
    def stiffness_matrix(self) -> Float64:
        """(ΣN, ΣN) stiffness matrix, ground springs included."""
        return self.matrices.stiffness

    @property
    def damping_matrix(self) -> Float64:
        """(ΣN, ΣN) damping matrix, ground dampers included."""
        return self.matrices.damping

    def as_dict(self) -> dict[str, Any]:
        """Plain lists, for messages and provenance; the JSON contract is in ``invid.model``."""
        return {
            "axes": list(self.axes),
            "masses": [m.tolist() for m in self.masses],
            "springs": [k.tolist() for k in self.springs],
            "dampers": [d.tolist() for d in self.dampers],
            "couplings": self.couplings.tolist(),
            "ground_springs": self.ground_springs.tolist(),
            "ground_dampers": self.ground_dampers.tolist(),
        }


def case_study(*, damping_ratio: float = 0.0) -> CoupledChains:
    """Section 4 of the paper: three branches of three masses, couplings m36 = 1, m39 = 2, m69 = 3.

    ``damping_ratio`` adds dampers parallel to the springs, d = 2ζ√(K·m_reduced) of the two masses
    a spring joins, so that modes have roughly that ratio; 0 is the paper's undamped system.
    """
    masses = ([0.7, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0])
    springs = ([1000.0, 2000.0], [3000.0, 4000.0], [5000.0, 6000.0])
    couplings = [[0.0, 1.0, 2.0], [1.0, 0.0, 3.0], [2.0, 3.0, 0.0]]
    dampers = []
    for m, k in zip(masses, springs, strict=True):
        left, right, stiff = np.array(m[:-1]), np.array(m[1:]), np.array(k)
        dampers.append(2.0 * damping_ratio * np.sqrt(stiff * left * right / (left + right)))
    return CoupledChains.build(masses, springs, dampers, couplings, axes=("A1", "A2", "A3"))
