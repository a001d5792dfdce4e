"""One cause seen from every side: its missing torque over velocity, position, deflection and frequency.

``figure_data`` draws a cause over the quantity that it depends on; a person who doubts it wants to see the
same torque over the others too, where a wrong cause would leave a shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from invid.effects import curve as laws
from invid.errors import InvidError
from invid.model.chains import CoupledChains
from invid.model.diagnosis_document import Diagnosis
from invid.model.document import EffectTerm, Model
from invid.numerics.arrays import Complex128, Float64
from invid.recording.model import Recording, Role
from invid.report.data import (
    POINTS,
    _abscissa,
    _denoised,
    _interior,
    _liveliest,
    _place,
    _unit,
    _wave,
    alone,
    fitted_wave,
    force_at,
    lines_of,
)
from invid.report.spectra_data import MissingTorque, binned, line_numbers
from invid.signals.spectra import LineSpectra, all_spectra

SIDES = (laws.VELOCITY, laws.POSITION, laws.DEFLECTION)


def cause_views(recording: Recording, model: Model, diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """One entry a finding (or the axis on which something unexplained lives, without a fit).

    Each has ``cause``, ``axis``, ``element``, ``y_label``, ``own`` (what the cause depends on), ``sides``
    (``what``, ``x_label``, ``x``, ``y``, ``fit`` {x, y} as points of the same instants, or null) and
    ``spectrum`` (``frequency_hz``, ``missing``, ``left`` after the cause, ``noise_floor``). Empty where
    the recording carries no spectra.
    """
    chains = diagnosis.model.chains
    try:
        spectra = all_spectra(recording)
    except InvidError:
        return []
    if not spectra or chains.branches != len(recording.axes):
        return []
    held_out = tuple(s for s in spectra if s.role is Role.VALIDATE) or spectra
    terms = [f.effect for f in diagnosis.findings if f.effect.axis in recording.axes]
    out = [_views(recording, held_out, chains, term, terms) for term in terms]
    lost = diagnosis.unexplained
    if not out and lost is not None and lost.axis in recording.axes:
        nameless = EffectTerm("", lost.axis, {}, "mass 1")
        out.append(_views(recording, held_out, model.chains, nameless, ()))
    return out


def _views(
    recording: Recording,
    spectra: Sequence[LineSpectra],
    chains: CoupledChains,
    term: EffectTerm,
    all_terms: Sequence[EffectTerm],
) -> dict[str, Any]:
    i, pattern, stiffness = _place(chains, term)
    s = _liveliest(spectra, i)
    m, note = alone(s, chains, term, all_terms)
    force, std = force_at(m, pattern)
    y = -_wave(s, _denoised(force, std))
    keep = _interior(s, y.size)
    own = laws.abscissa(term)
    fit = None if own is None else fitted_wave(m, pattern, i, term, own, stiffness)
    sides = []
    for what in dict.fromkeys((*([own] if own else []), *SIDES)):
        x = _side(m, chains, pattern, i, what, term if what == own else None)
        if x is None:
            continue
        step = max(1, y[keep].size // POINTS)
        picture: dict[str, Any] = {
            "what": what,
            "x_label": f"{what} [{_unit(recording, what)}]",
            "x": x[keep][::step].tolist(),
            "y": y[keep][::step].tolist(),
            "fit": None,
        }
        if fit is not None:
            picture["fit"] = {"x": picture["x"], "y": fit[keep][::step].tolist()}
        sides.append(picture)
    return {
        "cause": term.cause or None,
        "axis": term.axis,
        "element": term.element if term.cause else None,
        "y_label": f"missing torque [{recording.torque_unit}]",
        "note": note,
        "own": own,
        "sides": sides,
        "spectrum": _spectrum(s, force, std, fit),
    }


def _side(
    m: MissingTorque, chains: CoupledChains, pattern: Float64, axis: int, what: str, term: EffectTerm | None
) -> Float64 | None:
    """(n,) the quantity at the cause's place; the deflection is that of the spring next to it."""
    if what != laws.DEFLECTION or np.count_nonzero(pattern) == 2:
        if what in (laws.VELOCITY, laws.POSITION) and np.count_nonzero(pattern) == 2:
            pattern = np.maximum(pattern, 0.0)  # of a spring: its motor's side
        return _abscissa(m, pattern, axis, what, term)
    springs = chains.springs[axis].size
    if springs == 0:
        return None
    place = int(np.flatnonzero(pattern)[0]) - int(chains.motor_dofs[axis])
    first = int(chains.motor_dofs[axis]) + min(max(place, 0), springs - 1)
    across = np.zeros(chains.dofs)
    across[first], across[first + 1] = 1.0, -1.0
    return _abscissa(m, across, axis, what, None)


def _spectrum(s: LineSpectra, force: Complex128, std: Float64, fit: Float64 | None) -> dict[str, Any]:
    """Rms over frequency of the torque at the cause's place, before and with the cause taken out."""
    inside = line_numbers(s) <= s.time.size // 2
    hz = s.frequency_hz[inside]
    centre, before = binned([hz], [np.abs(force[inside]) ** 2])
    _, noise = binned([hz], [std[inside] ** 2])
    left = None
    if fit is not None:
        left = binned([hz], [np.abs(force + lines_of(s, fit))[inside] ** 2])[1].tolist()
    return {
        "frequency_hz": centre.tolist(),
        "missing": before.tolist(),
        "left": left,
        "noise_floor": noise.tolist(),
    }
