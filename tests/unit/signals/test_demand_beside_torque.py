"""A demand beside a torque that follows it late: only where a hold works is the difference the hold's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter
from two_masses import from_rest

from invid.recording import Role
from invid.signals.drive_torque import replace_by_acting_torque
from invid.signals.spectra import spectra_of


def test_what_a_free_axis_does_beside_its_demand_is_no_hold() -> None:
    experiment = from_rest(5, Role.IDENTIFY, "000")
    lagging = lfilter([0.3], [1.0, -0.7], experiment.torque, axis=0)
    moved = {}
    for gain in (0.0, np.nan):
        late = replace(
            experiment, torque=lagging, torque_demand=experiment.torque, hold_gain=np.array([gain])
        )
        s = spectra_of(late, drop_transient=False)
        (acting,) = replace_by_acting_torque([s], [late])
        moved[gain == 0.0] = float(np.abs(acting.torque - s.torque).max())
    assert moved[True] == 0.0
    assert moved[False] > 0.0  # of unknown gain there may be a hold
