"""What the linear model of chains answers: resonances and receptance."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from invid.errors import InputError
from invid.model.chains import CoupledChains
from invid.numerics.arrays import Complex128, Float64


def frf(chains: CoupledChains, omega: npt.ArrayLike) -> Complex128:
    """(F, M, M) receptance G [rad/(N·m) or m/N] at ω (F,) [rad/s]: Θ = G T.

    Raises
    ------
    InputError
        At an undamped resonance or at ω = 0 of a free plant, where G is not finite.
    """
    w = np.atleast_1d(np.asarray(omega, dtype=float))
    if w.ndim != 1 or not (np.isfinite(w) & (w >= 0)).all():
        raise InputError(f"omega is {omega!r}; a list of finite angular frequencies ≥ 0 [rad/s] is needed")
    dynamic, motors = chains.matrices.dynamic_stiffness(1j * w), chains.motor_dofs
    scale = 1.0 / np.sqrt(np.diag(chains.mass_matrix))
    singular = np.flatnonzero(~(np.linalg.cond(scale[:, None] * dynamic * scale) < 1e15))  # no digit left
    if singular.size:
        raise InputError(
            f"FRF at ω = {w[singular[0]]:.9g} rad/s: the plant is singular there (an undamped resonance, or "
            "a rigid mode at 0); leave that line out or add damping"
        )
    return np.asarray(np.linalg.inv(dynamic)[:, motors[:, None], motors], dtype=np.complex128)


def resonances(chains: CoupledChains) -> Float64:
    """(ΣN,) undamped resonances [rad/s], ascending; one exact 0 for each motor that is not grounded.

    The paper's list λ (eq. 5) is the square of this with all zeros but one removed.
    """
    natural = chains.matrices.natural
    natural[: int(np.sum(chains.ground_springs == 0))] = 0.0
    return natural
