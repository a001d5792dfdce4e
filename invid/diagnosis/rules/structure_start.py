"""Another start of the chain: the identification from the torque without what acts at the motors.

Friction distorts the measured FRF, and the identification that starts from it may end in another minimum of
masses and springs. What a law gives at a motor follows from the motor's measured motion alone, whatever the
chain: once it is known, the torque without it shows the FRF of the chain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.diagnosis.linear_fit import chain_vector
from invid.errors import InvidError
from invid.identification.starts import fit_sizes, measured_frf
from invid.likelihood.evaluation import record_views
from invid.likelihood.joint_fit import JointFit
from invid.likelihood.nuisance.corner_motion import force_at_motor
from invid.numerics.arrays import Float64
from invid.signals.spectra import LineSpectra
from invid.signals.spectral_record import SpectralRecord


def start_beside_friction(
    fitted: JointFit, records: Sequence[SpectralRecord], spectra: Sequence[LineSpectra]
) -> Float64 | None:
    """(n,) parameters of a fit with its chain identified anew; ``None`` where that fails.

    ``spectra``: of the experiments that the ``records`` come from.
    """
    corrected = _without_forces(fitted, records, spectra)
    structure = fitted.layout.structure
    if not corrected:
        return None
    try:
        found = fit_sizes(corrected, structure.sizes, structure.axes, measured_frf(corrected), thorough=False)
    except (InvidError, np.linalg.LinAlgError):
        return None
    out, ground = fitted.p.copy(), structure.slices["ground_spring"]
    out[: structure.count] = chain_vector(structure, found.chains)
    out[ground] = fitted.p[ground]  # none of what was sought
    return out


def _without_forces(
    fitted: JointFit, records: Sequence[SpectralRecord], spectra: Sequence[LineSpectra]
) -> list[LineSpectra]:
    """The spectra whose records are whole, their torque without the forces at the motors."""
    known = {s.key: s for s in spectra}
    out = []
    for view in record_views(fitted.layout, records, fitted.p):
        record = view.record
        s = known.get(record.key)
        if s is None or record.alone:
            continue
        motors = range(s.axis_count)
        force = view.to_lines(np.stack([force_at_motor(view, fitted, i) for i in motors], axis=1))
        at = np.searchsorted(s.frequency_hz, record.omega[1:] / (2 * np.pi) * (1 - 1e-9))
        torque = s.torque.copy()
        torque[at] -= force[1:]
        out.append(replace(s, torque=torque))
    return out


__all__ = ["start_beside_friction"]
