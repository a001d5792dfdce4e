"""The assumed plant of a cell before it moves: the last model, or a guess that says so."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from invid.config import CellConfig, MultisineSpec
from invid.errors import ModelError
from invid.model.chains import CoupledChains
from invid.model.document import Model
from invid.numerics.arrays import Float64, frozen_float
from invid.wording.sentence import sentence

GUESSED_MASSES = 2
"""Masses of a branch where the config names none: a motor and a load."""
GUESSED_DAMPING = 0.01
"""Modal damping ratio of a guess; drives with gears lie between half a per cent and some per cent."""
GUESSED_FRICTION = 0.02
"""Coulomb friction of a guess as a share of the torque limit."""


@dataclass(frozen=True, eq=False)
class Belief:
    """A plant with its motor friction.

    Attributes
    ----------
    chains
        Without ground dampers, which are ``viscous``.
    viscous, coulomb
        (M,) at the motors [N·m·s/rad], [N·m] (or linear units).
    source
        Where it comes from, for the reader of a forecast.
    guessed
        True where nobody has measured it.
    """

    chains: CoupledChains
    viscous: Float64
    coulomb: Float64
    source: str
    guessed: bool

    @property
    def inertia(self) -> Float64:
        """(M,) rigid inertia of each branch."""
        return np.array([float(m.sum()) for m in self.chains.masses])


def from_model(model: Model, config: CellConfig, *, source: str = "the last model") -> Belief:
    """The assumed plant of an accepted model.

    Raises
    ------
    ModelError
        The model's axes are not the config's.
    """
    names = tuple(a.name for a in config.axes)
    if model.axes != names:
        raise ModelError(
            f"the model has axes {', '.join(model.axes)}, the config {', '.join(names)}; give the model of "
            "this cell"
        )
    viscous, coulomb = np.array(model.chains.ground_dampers), np.zeros(len(names))
    for term in model.effects:
        if term.axis not in names or term.element not in (None, "mass 1"):
            continue
        at = names.index(term.axis)
        if term.cause == "viscous_friction":
            viscous[at] += max(term.value("coefficient"), 0.0)
        elif term.cause == "coulomb_friction":
            coulomb[at] = max(term.value("torque"), 0.0)
    chains = replace(model.chains, ground_dampers=frozen_float(np.zeros(len(names))))
    return Belief(chains, frozen_float(viscous), frozen_float(coulomb), source, False)


def guess(config: CellConfig) -> Belief | None:
    """A plant from the inertias in the config; ``None`` where one of them is missing.

    Masses share the inertia equally and the springs put each branch's antiresonances (motor held)
    into the upper half of the excited band: what a first experiment is laid out to find. Its numbers
    are an order of magnitude, not a promise.
    """
    inertia = [a.inertia for a in config.axes]
    if any(i is None for i in inertia):
        return None
    bands = [s.band_Hz for s in config.experiments if isinstance(s, MultisineSpec)]
    low, high = (max(b[0] for b in bands), min(b[1] for b in bands)) if bands else (0.5, 12.0)
    masses, springs, dampers = [], [], []
    for axis, total in zip(config.axes, inertia, strict=True):
        count = axis.masses or GUESSED_MASSES
        share_of_mass = float(total or 0.0) / count
        masses.append(np.full(count, share_of_mass))
        # The highest antiresonance of a uniform chain lies below 2·√(K/m).
        stiffness = share_of_mass * (2 * np.pi * 0.6 * max(high, 2 * low) / 2) ** 2
        springs.append(np.full(count - 1, stiffness))
        dampers.append(np.full(count - 1, 2 * GUESSED_DAMPING * float(np.sqrt(stiffness * share_of_mass))))
    count = len(masses)
    couplings = np.zeros((count, count))
    for i in range(count):
        for j in range(i + 1, count):
            couplings[i, j] = couplings[j, i] = 0.1 * np.sqrt(masses[i][-1] * masses[j][-1])
    chains = CoupledChains.build(
        masses, springs, dampers, couplings / max(1, count - 1), axes=[a.name for a in config.axes]
    )
    coulomb = [GUESSED_FRICTION * a.limits.torque for a in config.axes]
    return Belief(
        chains,
        frozen_float(np.zeros(count)),
        frozen_float(coulomb),
        sentence("a guess from the config's inertias (no model given): orders of magnitude only"),
        True,
    )


def rigid(config: CellConfig) -> Belief | None:
    """Rigid masses of the inertias in the config, each by itself; ``None`` where one of them is missing."""
    inertia = [a.inertia for a in config.axes]
    if any(i is None for i in inertia):
        return None
    zero = frozen_float(np.zeros(len(inertia)))
    chains = CoupledChains.build(
        [[float(i or 0.0)] for i in inertia], [[]] * len(inertia), axes=[a.name for a in config.axes]
    )
    return Belief(chains, zero, zero, sentence("the inertia in the config"), True)
