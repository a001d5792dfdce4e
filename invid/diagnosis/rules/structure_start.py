"""Other starts of the chain: the identification from the torque without what acts at the motors.

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
from invid.identification.starts import chain_starts, measured_frf
from invid.likelihood.evaluation import record_views
from invid.likelihood.fit import nearest_minima
from invid.likelihood.joint_fit import JointFit
from invid.likelihood.nuisance.corner_motion import force_at_motor
from invid.model.parameters import ChainStructure
from invid.numerics.arrays import Float64
from invid.signals.spectra import LineSpectra
from invid.signals.spectral_record import SpectralRecord

MOST = 5
"""Most minima that are handed on (empirical, for the time)."""
SAME_CHAIN = 0.05
"""Share up to which every mass and spring differs in what counts as the same chain (empirical: what else acts
bends them by a few per cent)."""


def starts_beside_friction(
    fitted: JointFit,
    records: Sequence[SpectralRecord],
    spectra: Sequence[LineSpectra],
    *,
    linear_axes: bool,
) -> list[Float64]:
    """(n,) parameters of a fit with its chain identified anew, for each minimum of that with another chain;
    none where it fails.

    ``spectra``: of the experiments that the ``records`` come from.
    """
    corrected = _without_forces(fitted, records, spectra)
    structure = fitted.layout.structure
    if not corrected:
        return []
    sizes, axes = structure.sizes, structure.axes
    try:
        starts = chain_starts(corrected, sizes, axes, measured_frf(corrected), (), thorough=False)
        minima = nearest_minima(
            corrected, ChainStructure(sizes, axes), starts, turning=not linear_axes, most=MOST
        )
    except (InvidError, np.linalg.LinAlgError):
        return []
    ground, elastic = structure.slices["ground_spring"], slice(0, structure.slices["spring"].stop)
    out = []
    for chains in minima:
        p = fitted.p.copy()
        p[: structure.count] = chain_vector(structure, chains)
        p[ground] = fitted.p[ground]  # none of what was sought
        if np.abs(p - fitted.p)[elastic].max() > SAME_CHAIN:
            out.append(p)
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


__all__ = ["starts_beside_friction"]
