"""``make_case(seed)``: a recording with a hidden effect, and what was hidden.

The diagnosis gets the recording alone. ``Truth.db`` is the size of the effect: the power, on all
lines of the excited band and averaged over the identify experiments, of the missing torque that
remains after a linear refit, over the power that sensor noise leaves in the same averaged spectra
(both whitened by the noise). It is computed here, from noise-free sub-step logs, with this folder's
own matrices.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hidden.causes import BASE, CATALOGUE, OUTSIDE, TWO, Cause, available
from hidden.measurement import Active, excess_db, record, scales
from hidden.plants import Plant, paper_plant, random_plant
from hidden.setup import Setup, draw_setup, without_periods
from invid.model.chains import CoupledChains
from invid.recording.model import Recording


@dataclass(frozen=True)
class TrueEffect:
    """One hidden effect; ``element`` is None where any (or no) element is right."""

    cause: str
    axis: str
    element: str | None
    other_axis: str | None
    parameters: dict[str, float]
    in_catalogue: bool
    either_axis: bool = False
    """With two axes: nothing in the data says which of them it is (a torque scale)."""


@dataclass(frozen=True, eq=False)
class Truth:
    """What was hidden and how large it is."""

    seed: int
    kind: str  # "null", "catalogue", "outside", "pair", "wrong_order"
    effects: tuple[TrueEffect, ...]
    chains: CoupledChains
    db: float
    settings: dict[str, Any] = field(default_factory=dict)


def calibrated(
    rng: np.random.Generator, setup: Setup, cause: Cause, axis: int, element: int, other: int, target: float
) -> Active:
    """The cause with its size such that the excess is ``target`` dB, within the cause's bounds."""
    draw = cause.draw(rng, setup.plant, scales(setup), axis, element, other)

    def at(factor: float) -> Active:
        return Active(cause, axis, element, other, cause.resize(draw, factor))

    tried: dict[float, float] = {1.0: excess_db(setup, (at(1.0),), quick=True)}
    for _ in range(6):
        low = [f for f in tried if tried[f] <= target]
        high = [f for f in tried if tried[f] > target]
        best = min(tried, key=lambda f: abs(tried[f] - target))
        if abs(tried[best] - target) < 1.5:
            break
        if low and high:  # interpolate, away from the ends
            a, b = max(low), min(high)
            share = float(np.clip((target - tried[a]) / (tried[b] - tried[a]), 0.2, 0.8))
            new = a * (b / a) ** share
        else:
            new = float(np.clip(best * 10 ** ((target - tried[best]) / 20), *cause.range))
        if min(abs(np.log(new / f)) for f in tried) < 0.01:
            break
        tried[new] = excess_db(setup, (at(new),), quick=True)
    factor = min(tried, key=lambda f: abs(tried[f] - target))
    return at(factor)


def _plant(
    rng: np.random.Generator, motors: int | None, masses: tuple[int, ...] | None, linear: bool
) -> Plant:
    names = [("A1", "A2", "A3"), ("J1", "J2", "J3"), ("base", "tilt", "tool"), ("X", "Y", "Z")]
    axes = names[int(rng.integers(len(names)))]
    if masses is None:
        count = int(rng.integers(1, 4)) if motors is None else motors
        if count == 3 and not linear and rng.uniform() < 0.4:
            return paper_plant(rng, axes)
        if rng.uniform() < 0.7:
            masses = (int(rng.integers(2, 5 if count < 3 else 4)),) * count
        else:
            masses = tuple(int(n) for n in rng.integers(2, 5 if count < 3 else 4, count))
    return random_plant(rng, axes[: len(masses)], tuple(masses), linear=linear)


def _cause(name: str) -> Cause:
    return BASE if name == BASE.name else (CATALOGUE | OUTSIDE | TWO)[name]


def make(
    cause: str | None = None,
    place: tuple[int, int] | None = None,
    size: dict[str, float] | None = None,
    *,
    seed: int = 0,
    target_db: float | None = None,
    second: str | None = None,
    motors: int | None = None,
    masses: tuple[int, ...] | None = None,
    paper: bool = False,
    linear: bool = False,
    declared: int = 0,
    excitation: str | None = None,
    **setup_options: Any,
) -> tuple[Recording, Truth]:
    """One case. ``cause`` None: null data. ``place``: (axis, element), from 0 and from 1.

    ``size``: parameters in SI; otherwise the size is found so that the effect has ``target_db``
    (drawn between −12 and 40 where None). ``second``: another cause on top. ``declared``: masses
    declared per axis minus the true number. ``excitation``: "chirp", "noise" or "stepped" in place of the
    multisines (the size is still what those would show).
    """
    rng = np.random.default_rng(seed)
    if motors is None and masses is None and cause is not None:
        needed = max(_cause(c).motors for c in (cause, second) if c)
        if needed > 1:
            motors = int(rng.integers(needed, 4))
    plant = paper_plant(rng) if paper else _plant(rng, motors, masses, linear)
    setup = draw_setup(rng, plant, **setup_options)
    active: list[Active] = []
    for name in (cause, second):
        if name is None:
            continue
        chosen = _cause(name)
        for _ in range(20):
            axis, element, other = chosen.place(rng, plant)
            if name != cause or place is None:
                if not active or (axis, element) != (active[0].axis, active[0].element):
                    break
            else:
                axis, element = place
                break
        if size is not None and name == cause:
            active.append(Active(chosen, axis, element, other, dict(size)))
        else:
            goal = float(rng.uniform(-12, 40)) if target_db is None else target_db
            active.append(calibrated(rng, setup, chosen, axis, element, other, goal))
    db = excess_db(setup, tuple(active)) if active else -np.inf
    if excitation is not None:
        setup = without_periods(rng, setup, excitation)
    true_sizes = [len(m) for m in plant.chains.masses]
    recording, lost_db, gone = record(rng, setup, tuple(active), [n + declared for n in true_sizes])
    db = max(db, lost_db)
    effects = tuple(_true_effect(plant, a, gone) for a in active)
    if declared:
        kind = "wrong_order"
    elif not effects:
        kind = "null"
    elif len(effects) > 1:
        kind = "pair"
    else:
        kind = "catalogue" if effects[0].in_catalogue else "outside"
    return recording, Truth(seed, kind, effects, plant.chains, db, setup.settings)


def _true_effect(plant: Plant, a: Active, gone: dict[int, float]) -> TrueEffect:
    axes = plant.chains.axes
    return TrueEffect(
        a.cause.name,
        axes[a.axis],
        a.cause.element_name(plant, a.axis, a.element),
        axes[a.other] if a.other >= 0 else None,
        {"fraction": gone[a.axis]} if a.cause.name == "dropped_samples" else a.parameters,
        a.cause.name not in OUTSIDE | TWO,
        a.cause.name == "torque_gain" and plant.count == 2,
    )


def make_cell(
    causes: Sequence[tuple[str, int, int, float]],
    *,
    seed: int,
    masses: tuple[int, ...] | None = None,
    **setup_options: Any,
) -> tuple[Recording, Truth]:
    """A whole cell of the paper's three axes, or of others: ``causes`` with axis (from 0), element (from 1)
    and how far each alone stands over the noise [dB]."""
    rng = np.random.default_rng(seed)
    plant = (
        paper_plant(rng) if masses is None else random_plant(rng, ("J1", "J2", "J3")[: len(masses)], masses)
    )
    setup = draw_setup(rng, plant, **setup_options)
    active = tuple(
        calibrated(rng, setup, _cause(name), axis, element, -1, db) for name, axis, element, db in causes
    )
    recording, _, gone = record(rng, setup, active, [len(m) for m in plant.chains.masses])
    effects = tuple(_true_effect(plant, a, gone) for a in active)
    return recording, Truth(seed, "cell", effects, plant.chains, np.inf, setup.settings)


def make_case(
    seed: int, *, kind: str | None = None, motors: int | None = None, excitation: str | None = None
) -> tuple[Recording, Truth]:
    """A case drawn at random: 70 % one catalogue cause, else null, outside, pair or wrong order."""
    rng = np.random.default_rng([seed, 7])
    kind = kind or str(
        rng.choice(["catalogue", "null", "outside", "pair", "wrong_order"], p=[0.62, 0.12, 0.12, 0.1, 0.04])
    )
    count = int(rng.integers(1, 4)) if motors is None else motors
    linear = bool(rng.uniform() < 0.1)
    options: dict[str, Any] = {"seed": seed, "motors": count, "linear": linear, "excitation": excitation}
    if kind == "null":
        return make(None, **options)
    if kind == "wrong_order":
        return make(None, declared=int(rng.choice([-1, 1])), **{**options, "linear": False})
    if kind == "outside":
        names = available(OUTSIDE, count, linear)
        return make(str(rng.choice(names)), target_db=float(rng.uniform(5, 35)), **options)
    names = available(CATALOGUE, count, linear)
    first = str(rng.choice(names))
    if kind == "pair":
        later = [n for n in names if CATALOGUE[n].pairs_with(CATALOGUE[first])]
        if not later or CATALOGUE[first].alone:
            first = "coulomb_friction"
            later = [n for n in names if CATALOGUE[n].pairs_with(CATALOGUE[first])]
        return make(first, second=str(rng.choice(later)), target_db=float(rng.uniform(10, 30)), **options)
    return make(first, **options)


__all__ = ["CATALOGUE", "OUTSIDE", "TrueEffect", "Truth", "make", "make_case", "make_cell"]
