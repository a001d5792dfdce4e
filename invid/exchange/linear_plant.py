"""The linear part of a model as matrices, and what of the model a format does not hold, in sentences.

q [rad or m] are the coordinates in the order of axes and masses, those of extra modes and of a base at the
end; u [N·m or
N] the motor torques that the drives report; t the torques that act:

    M q̈ + D q̇ + K q = Σ_i e_i t_i,    τ_i ṫ_i + t_i = g_i u_i    (τ_i = 0: t_i = g_i u_i).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Comment

import numpy as np

from invid.errors import ModelError
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm, Model, parameter_vector, stds_by_name
from invid.model.matrices import Matrices, natural_frequencies
from invid.numerics.arrays import Complex128, Float64, frozen_float
from invid.simulation.laws import Laws, laws_of
from invid.simulation.plant import matrices

LINEAR = (
    "viscous_friction",
    "spring_damping",
    "coupling_stiffness",
    "extra_mode",
    "base_compliance",
    "torque_gain",
    "torque_lag",
)
"""Causes whose force is linear in the motion or in the torque, with constant coefficients."""


@dataclass(frozen=True, eq=False)
class ParameterSpread:
    """The linear parameters with their joint covariance.

    ``names`` (p) as ``A1.mass.1``; ``values`` (p,); ``covariance`` (p, p), NaN in rows
    of what the data cannot tell. ``joint`` is False where the model has standard deviations alone: they stand
    on the diagonal.
    """

    names: tuple[str, ...]
    values: Float64
    covariance: Float64
    joint: bool


@dataclass(frozen=True, eq=False)
class LeftOut:
    """An effect that is not linear; ``reason`` where nobody can simulate it at all."""

    term: EffectTerm
    reason: str = ""


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """Matrices (n, n) of the linear model with the effects that are linear; n = ΣN + extra modes.

    ``motors`` (M,) index of each motor, ``gain`` (M,) and ``lag`` (M,) [s] of each torque, ``delay`` (M,) [s]
    beside the matrices. ``linear`` are the effects in here, ``nonlinear`` those that are not.
    """

    chains: CoupledChains
    laws: Laws
    mass: Float64
    damping: Float64
    stiffness: Float64
    coordinates: tuple[str, ...]
    motors: tuple[int, ...]
    gain: Float64
    lag: Float64
    delay: Float64
    linear: tuple[EffectTerm, ...]
    nonlinear: tuple[LeftOut, ...]
    linear_axes: bool

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes, M."""
        return self.chains.axes

    @property
    def modes(self) -> Float64:
        """(n,) undamped natural frequencies [rad/s], ascending; 0 for rigid modes."""
        return self.matrices.natural

    @property
    def matrices(self) -> Matrices:
        """All three."""
        return Matrices(self.stiffness, self.damping, self.mass)

    def response(self, omega: Float64) -> Complex128:
        """(F, M, M) positions of the motors per torque reported, at ω > 0 [rad/s]."""
        s, motors = 1j * np.asarray(omega, dtype=float), np.array(self.motors)
        acting = self.gain / (1.0 + s[:, None] * self.lag)  # (F, M)
        motion = np.linalg.inv(self.matrices.dynamic_stiffness(s))[:, motors[:, None], motors]
        result: Complex128 = motion * acting[:, None, :]
        return result


def linear_plant(model: Model) -> LinearPlant:
    """The linear part of a model; what cannot be linear is named in ``nonlinear``."""
    chains = model.chains
    inside: list[EffectTerm] = []
    nonlinear: list[LeftOut] = []
    for term in model.effects:
        try:
            laws_of(chains, (term,))
        except ModelError as error:
            nonlinear.append(LeftOut(term, str(error)))
            continue
        if term.cause in LINEAR:
            inside.append(term)
        else:
            nonlinear.append(LeftOut(term))
    laws = laws_of(chains, tuple(inside))
    made = matrices(chains, laws)
    delay = np.zeros(chains.branches)
    for i, value in laws_of(chains, tuple(o.term for o in nonlinear if not o.reason)).delay.items():
        delay[i] += value
    return LinearPlant(
        chains=chains,
        laws=laws,
        mass=frozen_float(made.mass),
        damping=frozen_float(made.damping),
        stiffness=frozen_float(made.stiffness),
        coordinates=coordinate_names(chains, laws),
        motors=tuple(int(i) for i in chains.motor_dofs),
        gain=frozen_float([laws.gain.get(i, 1.0) for i in range(chains.branches)]),
        lag=frozen_float([laws.lag.get(i, 0.0) for i in range(chains.branches)]),
        delay=frozen_float(delay),
        linear=tuple(inside),
        nonlinear=tuple(nonlinear),
        linear_axes=model.linear,
    )


def coordinate_names(chains: CoupledChains, laws: Laws) -> tuple[str, ...]:
    """``A1.mass.1``, …, then ``A1.extra.1`` for the first extra mode of A1."""
    names = [
        f"{axis}.mass.{q + 1}"
        for axis, n in zip(chains.axes, chains.masses_per_branch, strict=True)
        for q in range(n)
    ]
    counts = dict.fromkeys(chains.axes, 0)
    for added in laws.extra_masses:
        axis = chains.axes[int(np.searchsorted(chains.motor_dofs, added.at, side="right")) - 1]
        counts[axis] += 1
        names.append(f"{axis}.extra.{counts[axis]}")
    return (*names, *(f"base.{k + 1}" for k in range(len(laws.bases))))


def parameter_spread(model: Model) -> ParameterSpread:
    """Linear parameters of a model with their covariance, or their variances where it has no covariance."""
    names, values = parameter_vector(model.chains)
    if model.covariance is not None and set(model.parameter_names) <= set(names):
        place = {name: k for k, name in enumerate(names)}
        at = [place[name] for name in model.parameter_names]
        if len(at) == len(names):
            return ParameterSpread(
                model.parameter_names, frozen_float(values[at]), frozen_float(model.covariance), True
            )
    stds = stds_by_name(model)
    spread = np.array([stds[name] for name in names])
    covariance = np.diag(spread**2)
    unknown = np.isnan(spread)
    covariance[unknown] = covariance[:, unknown] = np.nan
    return ParameterSpread(names, frozen_float(values), frozen_float(covariance), False)


def derivatives(plant: LinearPlant, names: tuple[str, ...]) -> tuple[Float64, Float64, Float64]:
    """(p, n, n) each: ∂M, ∂D, ∂K by every parameter. All three are linear in the parameters, so that
    M(p) = M + Σ (p_k − values_k)·∂M_k holds for any step."""
    known, ends = parameter_vector(plant.chains)[0], plant.chains.end_dofs
    element = dict(zip(known, (e for e, _ in plant.chains.parts), strict=False))
    made = [Matrices.of(plant.mass.shape[0], [(element[name], 1.0)]) for name in names]
    for at, base in enumerate(plant.laws.bases, plant.chains.dofs + len(plant.laws.extra_masses)):
        shares = np.array(base.shares)  # what stands on it counts as its mass
        for mass in (m.mass for m in made):
            inertia = mass[np.ix_(ends, ends)]
            mass[at, ends] = mass[ends, at] = inertia @ shares
            mass[at, at] = shares @ inertia @ shares
    return (
        np.array([m.mass for m in made]),
        np.array([m.damping for m in made]),
        np.array([m.stiffness for m in made]),
    )


def effect_losses(
    plant: LinearPlant, own: Callable[[EffectTerm], str | None] = lambda _term: None
) -> list[str]:
    """A sentence for each effect that the matrices do not hold.

    ``own`` says how the format holds such an effect in its own way ("stands as …"); ``None``: it does not.
    """
    lost = []
    for left in plant.nonlinear:
        way = None if left.reason else own(left.term)
        name = effect_name(left.term)
        lost.append(
            f"{name} {way}" if way else f"{name} is left out" + (f": {left.reason}" * bool(left.reason))
        )
    return lost


def effect_name(term: EffectTerm) -> str:
    """ "coulomb_friction on A1 mass 1 (torque 0.1 N·m)"."""
    place = " ".join(x for x in (term.axis, term.element, term.other_axis) if x)
    sizes = ", ".join(f"{k} {p.value:.4g} {p.unit or ''}".strip() for k, p in term.parameters.items())
    return f"{term.cause} on {place} ({sizes})"


def moved_modes(plant: LinearPlant, mass: Float64, stiffness: Float64) -> float:
    """Largest relative shift of a natural frequency with these matrices instead of the plant's."""
    there, here = natural_frequencies(mass, stiffness), plant.modes
    elastic = here > 1e-6 * here[-1]
    shift = np.abs(there[elastic] / here[elastic] - 1.0)
    return float(shift.max(initial=0.0))


def loss_comment(losses: list[str]) -> Any:
    """The losses as an XML comment, which must not hold two hyphens in a row."""
    return Comment(" not in here as it is: " + "; ".join(losses).replace("--", "- -") + " ")
