"""Identified against stated inertia: the last look at the scale of torque and position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.config import parse_config
from invid.errors import ConfigError
from invid.model.document import Model, units
from invid.model.doubts import Doubt, DoubtCode, by_weight, doubt_facts, doubts_of
from invid.recording.model import Recording
from invid.wording.sentence import sentence

STDS, SHARE = 3.0, 0.1
"""Both are passed where something is wrong: three standard deviations happen once in 370 axes, and a tenth is
what "roughly" may mean, beside the tolerance of a motor's torque constant (5 to 10 %, by catalogues)."""


def inertia_doubts(model: Model, recording: Recording, earlier: Model | None = None) -> tuple[Doubt, ...]:
    """Axes whose identified inertia is not the one that the recording's config states.

    ``earlier``: an accepted model of this robot. Where that agrees, or the motor's own mass is still as it
    was there, the machine has changed and no scale: that is among the changes, and is no doubt.
    """
    try:
        config = parse_config(recording.config or "", source=recording.source)
    except ConfigError:  # there is none, or a foreign file has something else there
        return ()
    if earlier is not None and earlier.provenance.get("recorded") == recording.created:
        earlier = None  # no other measurement
    key, unit = ("mass_kg" if model.linear else "inertia_kgm2"), units(model.linear)["mass"]
    torques = recording.rated_torque
    rated = {} if torques is None else dict(zip(recording.axes, torques, strict=True))
    stated = {a.name: a.inertia for a in config.axes if a.inertia is not None}
    found = []
    for i, axis in enumerate(model.axes):
        if axis not in stated:
            continue
        total, std = _total(model, i)
        times = total / stated[axis]
        if not _differs(total, std, stated[axis], 0.0) or _is_changed_machine(model, earlier, i):
            continue
        torque, newton = float(rated.get(axis, np.nan)), "N" if model.linear else "N·m"
        scale = sentence(
            ", {torque:.4g} {unit} or rather {other:.3g}", torque=torque, unit=newton, other=torque / times
        )
        text = sentence(
            "axis {axis}: identified are {total:.4g} ± {std:.2g} {unit}, {key} of the config "
            "states {stated:.4g}, "
            "{times:.2g} times. Either the torque is misread by that factor: compare rated torque "
            "(0x6076{scale}) and rated current (0x6075) with the motor's plate. Or the machine "
            "is not what it "
            "was when that was written, with another tool, say: then correct {key}",
            axis=axis,
            total=total,
            std=std,
            unit=unit,
            key=key,
            stated=stated[axis],
            times=times,
            scale=scale if np.isfinite(torque) else "",
        )
        found.append(Doubt(DoubtCode.STATED_INERTIA, text, {"times": times}))
    return tuple(found)


def _differs(new: float, new_std: float, old: float, old_std: float) -> bool:
    """Whether one inertia is surely and by more than "roughly" another; not where that is not known."""
    return abs(new - old) > STDS * float(np.hypot(new_std, old_std)) and abs(new / old - 1.0) > SHARE


def _is_changed_machine(model: Model, earlier: Model | None, branch: int) -> bool:
    """Whether an earlier model vouches for the scale of an axis.

    A scale multiplies every mass of its axis; a tool, only the last one and what couples it.
    """
    if earlier is None or earlier.axes != model.axes or earlier.linear != model.linear:
        return False
    if any(d.code is DoubtCode.STATED_INERTIA for d in doubts_of(earlier.fit)):
        return False  # its own scale is in doubt
    new, old = (np.asarray(m.chains.masses[branch]) for m in (model, earlier))
    then, then_std = _total(earlier, branch)
    if not np.isfinite(then_std):
        return False  # how well it was known is not
    if not _differs(*_total(model, branch), then, then_std):
        return True
    if new.size != old.size or new.size == 1:
        return False  # what is the motor's own is not told
    motor, whole = np.log(new[0] / old[0]), np.log(new.sum() / old.sum())
    return bool(abs(motor) < abs(motor - whole))


def against_stated(model: Model, recording: Recording, earlier: Model | None = None) -> Model:
    """The model, not to be trusted and saying so first where the config states another inertia.

    What was said of that before, without or with another ``earlier`` model, is said anew.
    """
    before = doubts_of(model.fit)
    old = tuple(d.text for d in before if d.code is DoubtCode.STATED_INERTIA)
    doubts = inertia_doubts(model, recording, earlier)
    if not doubts and not old:
        return model
    others = [d for d in before if d.code is not DoubtCode.STATED_INERTIA]
    said = tuple(d.text for d in doubts)
    return replace(
        model,
        fit={**model.fit, **doubt_facts(by_weight([*doubts, *others]))},
        warnings=(*said, *(w for w in model.warnings if w not in said + old)),
    )


def _total(model: Model, branch: int) -> tuple[float, float]:
    """The sum of one branch's masses and its standard deviation; NaN where that is not known."""
    total = float(model.chains.masses[branch].sum())
    stds = np.asarray(model.std.masses[branch])
    names = [f"{model.axes[branch]}.mass.{q}" for q in range(1, stds.size + 1)]
    if model.covariance is None or not set(names) <= set(model.parameter_names):
        return total, float(np.sqrt(np.sum(stds**2)))
    rows = [model.parameter_names.index(n) for n in names]
    return total, float(np.sqrt(max(np.asarray(model.covariance)[np.ix_(rows, rows)].sum(), 0.0)))
