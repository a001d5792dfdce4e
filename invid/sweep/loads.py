"""Judge which axes carry a load, by the torque that holds them at rest beside what the config states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.config import CellConfig
from invid.numerics.arrays import Bool, Float64
from invid.wording.sentence import sentence

CONFIRM_S = 1.5
"""A load is weighed over two stretches of so long that agree, and the later one counts. Gravity is
constant, what swings behind a held motor is not: under a Hann window all above 1.3 Hz then counts less than
a thirtieth."""
STEADY_S = 12.0
"""Longest wait for two that agree: a brake that opens late, an arm that swings."""
LOAD_SHARE = 0.02
"""Of rated torque: a hold that takes more carries a load. Offsets of current sensing are about 1 %, and what
dry friction of a drive takes at rest, 2 % at least, does not fall (empirical, from vendors' figures)."""
LIVELY = 100
"""In so many samples a current loop under load shows more than one value; a display that does not tells
nothing (empirical: 0.1 % of rated torque is below the noise of current sensing)."""
SIGMAS = 4.0
"""And beyond the noise of the mean: 1 in 15,000 for an axis that carries nothing."""


@dataclass(frozen=True)
class Load:
    """Torque of one axis at rest, and whether it carries a load."""

    torque: float
    """Mean of what holds it [N·m or N]; NaN where the drive does not hold it by itself."""
    loaded: bool
    said: str = ""
    """Where it contradicts the config or answers what that leaves open."""


def judge_loads(
    config: CellConfig, torque: Float64, fresh: Bool, held: Sequence[bool], rated: Sequence[float]
) -> tuple[Load, ...]:
    """Return the loads of all axes from torque (n, M) [N·m or N] at rest; ``held``: by their drives.

    Rows are weighted with a Hann window.

    A stated load is believed; a stated or unknown absence of one is not where the torque contradicts.
    """
    unit = "N" if config.linear else "N·m"
    window = np.hanning(len(torque) + 2)[1:-1]
    found = []
    for i, axis in enumerate(config.axes):
        rows, weight = torque[fresh[:, i], i], window[fresh[:, i]]
        if not held[i] or rows.size == 0:
            found.append(Load(float("nan"), axis.gravity_loaded is not False))
            continue
        mean = float(np.average(rows, weights=weight))
        noise = float(np.std(np.diff(rows))) / np.sqrt(2.0) if rows.size > 1 else 0.0
        least = max(LOAD_SHARE * rated[i], SIGMAS * noise * np.sqrt((weight**2).sum()) / weight.sum())
        says_nothing = rows.size > LIVELY and float(np.ptp(rows)) == 0.0
        carries = abs(mean) > least and not says_nothing
        said = ""
        if carries and not axis.gravity_loaded:
            stated = "is false" if axis.gravity_loaded is False else "is not stated"
            said = sentence(
                "axis {axis}: gravity_loaded {stated}, but holding it at rest takes {mean:.3g} "
                "{unit}, more than {least:.2g}: it counts as loaded. Set gravity_loaded: true in "
                "the config",
                axis=axis.name,
                stated=stated,
                mean=mean,
                unit=unit,
                least=least,
            )
        doubt = says_nothing and abs(mean) > least and axis.gravity_loaded is None
        found.append(Load(mean, bool(carries or doubt or axis.gravity_loaded), said))
    return tuple(found)


def differing(first: Sequence[Load], second: Sequence[Load], rated: Sequence[float]) -> list[int]:
    """Axes whose torque at rest differs by more than ``LOAD_SHARE`` of rated torque between two stretches."""
    return [
        i
        for i, (a, b) in enumerate(zip(first, second, strict=True))
        if abs(a.torque - b.torque) > LOAD_SHARE * rated[i]
    ]
