"""A plan within limits that turned out tighter than those it was made with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.config import CellConfig
from invid.planning.model import Plan


def fit_to_limits(plan: Plan, planned: CellConfig, tighter: CellConfig) -> Plan:
    """The plan with the torque of an axis scaled down where it exceeds the tighter limit.

    ``planned`` is the config that the plan was made with, ``tighter`` the one with the limits that hold: the
    share of the limit stays the same. Travel and velocity are not touched: the trial at low amplitude scales
    every torque down where they would come near their limits, and the watch knows the tighter ones.
    """
    old = np.array([a.limits.torque for a in planned.axes])
    new = np.array([a.limits.torque for a in tighter.axes])
    peak = np.zeros(len(old))
    for e in plan.experiments:
        peak = np.maximum(peak, np.abs(e.torque).max(axis=0, initial=0.0))
    share = np.where(peak > new, np.minimum(new / old, new / np.maximum(peak, 1e-300)), 1.0)
    if np.all(share == 1.0):
        return plan
    experiments = tuple(replace(e, torque=e.torque * share) for e in plan.experiments)
    forecast = tuple(
        replace(f, peak_torque=f.peak_torque * float(s), travel_limit=a.limits.position)
        for f, s, a in zip(plan.forecast, share, tighter.axes, strict=True)
    )
    trials = tuple(
        replace(t, experiment=replace(t.experiment, torque=t.experiment.torque * share)) for t in plan.trials
    )
    return replace(plan, experiments=experiments, trials=trials, forecast=forecast)
