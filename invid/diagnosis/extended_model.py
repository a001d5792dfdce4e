"""The extended model: the linear parameters as fitted together with the effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.likelihood.joint_fit import JointFit
from invid.model.document import EffectTerm, Model, parameter_vector
from invid.model.parameter_names import std_by_name
from invid.numerics.arrays import frozen_float


def extended_model(
    model: Model,
    fitted: JointFit,
    effects: tuple[EffectTerm, ...],
) -> Model:
    """The linear parameters refitted jointly, with the effects."""
    structure = fitted.layout.structure
    chains = structure.chains(fitted.p[: structure.count])
    values = structure.physical(fitted.p[: structure.count])
    factor = np.where(structure.logarithmic, values, 1.0)
    n = structure.count
    with np.errstate(invalid="ignore"):
        covariance = fitted.covariance[:n, :n] * factor[:, None] * factor
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    std = np.where(np.isfinite(std), std, np.nan)
    names = parameter_vector(chains)[0]
    place = {name: k for k, name in enumerate(structure.names)}
    index = [place[name] for name in names]
    finite = bool(np.isfinite(covariance).all())
    layout = fitted.layout
    # A demand logged beside the torque has its half sample of being held by itself.
    logged = any(v.record.command is not None for v in fitted.evaluation.views)
    offsets = layout.delays(fitted.p) + (0.5 * layout.step if logged else 0.0)
    offsets[list(layout.smoothed)] -= fitted.p[layout.smoothed_at]
    held = 0.5 * layout.step * layout.stairs(fitted.p)
    facts = {
        **dict(model.fit),
        "chi2": fitted.cost,
        "dof": fitted.dof,
        "time_offset_s": {
            f"{structure.axes[i]}.time_offset": {
                "value": float(offsets[i]),
                "std": _finite(float(np.sqrt(max(fitted.covariance[n + k, n + k], 0.0)))),
            }
            for k, i in enumerate(layout.free_delays)
        }
        | {
            f"{structure.axes[i]}.time_offset": {"value": float(held[i]), "std": None}
            for i in layout.held_late
        },
        "torque_lag_s": dict(model.fit.get("torque_lag_s", {}))
        | {
            structure.axes[i]: {
                "value": float(fitted.p[at]),
                "std": _finite(float(np.sqrt(max(fitted.covariance[at, at], 0.0)))),
            }
            for i, at in zip(layout.smoothed, range(layout.smoothed_at.start, layout.count), strict=True)
        },
        "joint_with_effects": bool(effects),
    }
    return replace(
        model,
        chains=chains,
        std=std_by_name(chains, dict(zip(structure.names, std.tolist(), strict=True))),
        effects=effects,
        covariance=frozen_float(covariance[np.ix_(index, index)]) if finite else None,
        parameter_names=names if finite else (),
        fit=facts,
    )


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
