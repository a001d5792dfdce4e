"""Identified against stated inertia: the last look at the scale of torque and position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.config import parse_config
from invid.errors import ConfigError
from invid.model.document import Model, units
from invid.model.doubts import Doubt, DoubtCode, by_weight, doubt_facts, doubts_of
from invid.recording.model import Recording

STDS, SHARE = 3.0, 0.1
"""Both are passed where something is wrong: three standard deviations happen once in 370 axes, and a tenth is
what "roughly" may mean, beside the tolerance of a motor's torque constant (5 to 10 %, by catalogues)."""


def inertia_doubts(model: Model, recording: Recording) -> tuple[Doubt, ...]:
    """Axes whose identified inertia is not the one that the recording's config states."""
    try:
        config = parse_config(recording.config or "", source=recording.source)
    except ConfigError:  # there is none, or a foreign file has something else there
        return ()
    key, unit = ("mass_kg" if model.linear else "inertia_kgm2"), units(model.linear)["mass"]
    torques = recording.rated_torque
    rated = {} if torques is None else dict(zip(recording.axes, torques, strict=True))
    stated = {a.name: a.inertia for a in config.axes if a.inertia is not None}
    found = []
    for i, axis in enumerate(model.axes):
        total, std = float(model.chains.masses[i].sum()), _std(model, i)
        if axis not in stated or not np.isfinite(std):
            continue
        times = total / stated[axis]
        if abs(total - stated[axis]) <= STDS * std or abs(times - 1.0) <= SHARE:
            continue
        torque, newton = float(rated.get(axis, np.nan)), "N" if model.linear else "N·m"
        scale = f", {torque:.4g} {newton} or rather {torque / times:.3g}" if np.isfinite(torque) else ""
        text = (
            f"axis {axis}: identified are {total:.4g} ± {std:.2g} {unit}, {key} of the config states "
            f"{stated[axis]:.4g}, {times:.2g} times. Either the torque is misread by that factor: compare "
            f"rated torque (0x6076{scale}) and rated current (0x6075) with the motor's plate. Or the machine "
            f"is not what it was when that was written, with another tool, say: then correct {key}"
        )
        found.append(Doubt(DoubtCode.STATED_INERTIA, text, {"times": times}))
    return tuple(found)


def against_stated(model: Model, recording: Recording) -> Model:
    """The model, not to be trusted and saying so first where the config states another inertia."""
    doubts = inertia_doubts(model, recording)
    if not doubts:
        return model
    others = [d for d in doubts_of(model.fit) if d.code is not DoubtCode.STATED_INERTIA]
    said = tuple(d.text for d in doubts)
    return replace(
        model,
        fit={**model.fit, **doubt_facts(by_weight([*doubts, *others]))},
        warnings=(*said, *(w for w in model.warnings if w not in said)),
    )


def _std(model: Model, branch: int) -> float:
    """Standard deviation of the sum of one branch's masses; NaN where it is not known."""
    stds = np.asarray(model.std.masses[branch])
    names = [f"{model.axes[branch]}.mass.{q}" for q in range(1, stds.size + 1)]
    if model.covariance is None or not set(names) <= set(model.parameter_names):
        return float(np.sqrt(np.sum(stds**2)))
    rows = [model.parameter_names.index(n) for n in names]
    return float(np.sqrt(max(np.asarray(model.covariance)[np.ix_(rows, rows)].sum(), 0.0)))
