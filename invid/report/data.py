"""``figure_data``: everything the pictures show, as plain lists, for the report and the web page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from invid.effects import curve as laws
from invid.effects.registry import effect_of
from invid.errors import InvidError
from invid.model.chains import CoupledChains
from invid.model.diagnosis_document import Diagnosis
from invid.model.document import EffectTerm, Model
from invid.model.forward import frf, resonances
from invid.numerics.arrays import Complex128, Float64
from invid.recording.model import Recording, Role
from invid.report.spectra_data import MissingTorque, binned_floor, binned_torque, line_numbers, missing_torque
from invid.signals.frf import frf_matrix
from invid.signals.spectra import LineSpectra, all_spectra

LEAST_FORCE, MOST_FORCES = 0.01, 12
"""Share of the strongest force from which a place is drawn, and how many at most."""
POINTS = 500
"""Points in a scatter: enough for a shape, few enough for a picture of modest size."""


def figure_data(recording: Recording, model: Model, diagnosis: Diagnosis | None = None) -> dict[str, Any]:
    """Data of every picture, by name; a picture that the data cannot carry is missing, with a note.

    Keys: ``frf`` (one an axis), ``missing_torque`` (one an axis), ``causes`` (one a finding, or the
    loudest axis over velocity and position where nothing is named), ``residual``, ``forces`` (those of
    the places that count), ``notes``.
    """
    notes: list[str] = []
    try:
        spectra = all_spectra(recording)
    except InvidError as error:
        spectra = ()
        notes.append(f"No spectra, so no pictures over frequency: {error}")
    fits = bool(spectra) and spectra[0].axis_count == model.chains.branches
    if spectra and not fits:
        notes.append(
            f"The recording has {spectra[0].axis_count} axes and the model {model.chains.branches}: "
            "no pictures."
        )
    if not spectra and not notes:
        notes.append("The recording shakes no axis, so there are no pictures over frequency.")
    shown = spectra if fits else ()
    extended = None if diagnosis is None else diagnosis.model
    missing = _missing_all(shown, model.chains)
    unit = recording.torque_unit
    return {
        "frf": _receptances(recording, shown, model, extended, notes),
        "missing_torque": _over_frequency(recording, missing, unit),
        "causes": _causes(recording, shown, model, diagnosis),
        "residual": [] if diagnosis is None else [asdict(r) for r in diagnosis.residual],
        "forces": [] if diagnosis is None else _forces(diagnosis),
        "notes": notes,
    }


def _forces(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Places at which a force acts that is a hundredth of the strongest, the strongest first."""
    strongest = max((max(f.before, f.after) for f in diagnosis.forces), default=0.0)
    counted = [f for f in diagnosis.forces if max(f.before, f.after) > LEAST_FORCE * strongest]
    return [asdict(f) for f in sorted(counted, key=lambda f: -max(f.before, f.after))[:MOST_FORCES]]


def _missing_all(spectra: Sequence[LineSpectra], chains: CoupledChains) -> list[MissingTorque]:
    held_out = [s for s in spectra if s.role is Role.VALIDATE]
    return [missing_torque(s, chains) for s in (held_out or spectra)]


# --- receptance -----------------------------------------------------------------------------------
def _receptances(
    recording: Recording,
    spectra: Sequence[LineSpectra],
    model: Model,
    extended: Model | None,
    notes: list[str],
) -> list[dict[str, Any]]:
    if not spectra:
        return []
    measured = frf_matrix(spectra)
    if not measured.frequency_hz.size:
        notes.append(
            "The experiments do not excite every axis at common frequencies, so the measured frequency "
            "response of an axis alone cannot be drawn; the curves are the model's."
        )
    top = max(float(s.frequency_hz[s.excited].max(initial=s.frequency_hz[0])) for s in spectra)
    low = min(float(s.frequency_hz[s.excited].min(initial=top)) for s in spectra)
    grid = np.geomspace(max(low, 1e-6) * 0.9, top * 1.1, 500)
    natural = resonances(model.chains) / (2 * np.pi)
    # Every resonance is a grid point, or its peak would be cut off.
    grid = np.unique(np.concatenate((grid, natural[(natural > grid[0]) & (natural < grid[-1])])))
    curves = {"before": frf(model.chains, 2 * np.pi * grid)}
    if extended is not None and extended.chains.branches == model.chains.branches:
        curves["after"] = frf(extended.chains, 2 * np.pi * grid)
    unit = f"{recording.position_unit}/({recording.torque_unit})"
    out = []
    for i, axis in enumerate(recording.axes):
        entry: dict[str, Any] = {
            "axis": axis,
            "unit": unit,
            "frequency_hz": grid.tolist(),
            "simulated": {name: _polar(g[:, i, i]) for name, g in curves.items()},
            "peaks_hz": _peaks(grid, np.abs(curves["before"][:, i, i])),
            "measured": None,
        }
        if measured.frequency_hz.size:
            values = measured.frf[:, i, i]
            std = np.sqrt(np.maximum(measured.variance[:, i, i], 0.0))
            entry["measured"] = {
                "frequency_hz": measured.frequency_hz.tolist(),
                **_polar(values),
                "std": std.tolist(),
                "phase_std_deg": np.degrees(std / np.maximum(np.abs(values), 1e-300)).clip(0, 180).tolist(),
            }
        out.append(entry)
    return out


def _polar(values: Complex128) -> dict[str, list[float]]:
    phase = np.degrees(np.angle(values))
    # −180…180 jumps where a rigid axis has −180 exactly: show −270…90 instead.
    phase = np.where(phase > 90.0, phase - 360.0, phase)
    return {"magnitude": np.abs(values).tolist(), "phase_deg": phase.tolist()}


def _peaks(hz: Float64, magnitude: Float64) -> list[float]:
    inner = magnitude[1:-1]
    at = np.flatnonzero((inner > magnitude[:-2]) & (inner > magnitude[2:])) + 1
    return [float(hz[k]) for k in at]


# --- missing torque over frequency ------------------------------------------------------------------
def _over_frequency(recording: Recording, before: Sequence[MissingTorque], unit: str) -> list[dict[str, Any]]:
    """Rms missing torque on the lines that the excitation drives, and on the others (distortion)."""
    if not before:
        return []
    excited = [np.asarray(m.spectra.excited) for m in before]
    out = []
    for i, axis in enumerate(recording.axes):
        centre, floor = binned_floor(before, i)
        entry: dict[str, Any] = {"axis": axis, "unit": unit, "frequency_hz": centre, "noise_floor": floor}
        for name, used in (("excited", excited), ("silent", [~e for e in excited])):
            hz, rms = binned_torque(before, i, used)
            entry[name] = {"frequency_hz": hz, "before": rms}
        out.append({**entry, "held_out": before[0].spectra.role is Role.VALIDATE})
    return out


# --- missing torque over what it depends on ---------------------------------------------------------
def _causes(
    recording: Recording, spectra: Sequence[LineSpectra], model: Model, diagnosis: Diagnosis | None
) -> list[dict[str, Any]]:
    if not spectra or diagnosis is None:
        return []
    out: list[dict[str, Any]] = []
    chains = diagnosis.model.chains
    if chains.branches != len(recording.axes):
        return []
    for finding in diagnosis.findings:
        term = finding.effect
        if term.axis in recording.axes and laws.abscissa(term):
            picture = _cause(recording, spectra, chains, term, diagnosis.model)
            if picture is not None:
                out.append(picture)
    if not out and diagnosis.unexplained is not None and diagnosis.unexplained.axis in recording.axes:
        axis = diagnosis.unexplained.axis
        for what in (laws.VELOCITY, laws.POSITION):
            out.append(_plain(recording, spectra, model.chains, axis, what))
    return out


def _place(chains: CoupledChains, term: EffectTerm) -> tuple[int, Float64, float]:
    """Axis number, pattern b over all coordinates (the force's place), stiffness of its spring."""
    i = chains.axes.index(term.axis) if term.axis in chains.axes else 0
    pattern = np.zeros(chains.dofs)
    kind, _, number = (term.element or "mass 1").partition(" ")
    at = max(int(number) if number.isdigit() else 1, 1)
    start, stiffness = int(chains.motor_dofs[i]), 0.0
    effect = effect_of(term.cause)
    home = "motor" if effect is None else effect.home
    if home == "axis" and term.other_axis in chains.axes:
        pattern[chains.end_dofs[i]] = 1.0
        pattern[chains.end_dofs[chains.axes.index(term.other_axis)]] = -1.0
    elif kind == "spring" and at <= chains.springs[i].size:
        pattern[start + at - 1], pattern[start + at] = 1.0, -1.0
        stiffness = float(chains.springs[i][at - 1])
    else:
        if home == "end" and term.element is None:
            at = chains.masses[i].size
        pattern[start + min(at, chains.masses[i].size) - 1] = 1.0
    return i, pattern, stiffness


def _cause(
    recording: Recording,
    spectra: Sequence[LineSpectra],
    chains: CoupledChains,
    term: EffectTerm,
    extended: Model,
) -> dict[str, Any] | None:
    i, pattern, stiffness = _place(chains, term)
    s = _liveliest(spectra, i)
    m, note = alone(s, chains, term, extended.effects)
    force, std = force_at(m, pattern)
    what = laws.abscissa(term) or ""
    x = _abscissa(m, pattern, i, what, term)
    y = -_wave(s, _denoised(force, std))
    keep = _interior(s, x.size)
    fitted = laws.curve(term, x, stiffness, _beside(m, pattern, i, term))
    picture = _points(x[keep], y[keep])
    wave = fitted_wave(m, pattern, i, term, what, stiffness)
    if fitted is not None and wave is not None:
        picture["seen"] = _thinned(x[keep], seen_alike(s, force, std, wave)[keep])
        picture["band_hz"] = band_of(s)
        fx, fy = fitted.x, fitted.y
        if fitted.path:  # a path in time: as points, in the record's interior
            thin = slice(None, None, max(1, fx[keep].size // 1500))
            fx, fy = fx[keep][thin], (fy[keep] - fy[keep].mean())[thin]
        picture["fit"] = {"x": fx.tolist(), "y": fy.tolist()}
    second = laws.across(term)
    if second is not None:
        note = ", ".join(filter(None, (f"it depends on the {second} too: drawn at the same instants", note)))
    return {**picture, **_labels(recording, what, term.axis, term.cause, term.element, note)}


def missing_beside(s: LineSpectra, chains: CoupledChains, terms: Sequence[EffectTerm]) -> MissingTorque:
    """The missing torque of one record in which these causes are at work; it still holds theirs."""
    m = missing_torque(s, chains)
    known, _ = _taken(m, s, chains, terms)
    return missing_torque(s, chains, known) if known.any() else m


def alone(
    s: LineSpectra, chains: CoupledChains, term: EffectTerm, terms: Sequence[EffectTerm]
) -> tuple[MissingTorque, str]:
    """Return what is left for one of the causes at work once the others have theirs, and a note on these."""
    m, others = missing_beside(s, chains, terms), [e for e in terms if e is not term and e != term]
    known, curveless = _taken(m, s, chains, others)
    note = f"with {curveless} other cause(s) still in it" if curveless else ""
    if len(others) > curveless:
        note = ", ".join(filter(None, ("what the other causes explain is taken out", note)))
    return replace(m, torque=m.torque - known), note


def _taken(
    m: MissingTorque, s: LineSpectra, chains: CoupledChains, terms: Sequence[EffectTerm]
) -> tuple[Complex128, int]:
    """(F, M) the missing torque that these causes explain, and how many of them have no curve."""
    known, curveless = np.zeros_like(m.torque), 0
    for term in terms:
        own, wave = laws.abscissa(term), None
        if own is not None and term.axis in chains.axes:
            i, pattern, stiffness = _place(chains, term)
            wave = fitted_wave(m, pattern, i, term, own, stiffness)
            if wave is not None:
                known -= np.einsum("d,fdm,f->fm", pattern, m.motion, lines_of(s, wave))
        curveless += wave is None
    return known, curveless


def fitted_wave(
    m: MissingTorque, pattern: Float64, axis: int, term: EffectTerm, own: str, stiffness: float
) -> Float64 | None:
    """(n,) torque of the fitted cause at every instant; mean removed, as lines carry none."""
    x = _abscissa(m, pattern, axis, own, term)
    curve = laws.curve(term, x, stiffness, _beside(m, pattern, axis, term))
    if curve is None:
        return None
    y = curve.y if curve.path else np.interp(x, curve.x, curve.y)
    result: Float64 = y - float(y.mean())
    return result


def _beside(m: MissingTorque, pattern: Float64, axis: int, term: EffectTerm) -> Float64 | None:
    """(n,) second quantity of a law over two; ``None`` for others."""
    second = laws.across(term)
    return None if second is None else _abscissa(m, pattern, axis, second, term)


def lines_of(s: LineSpectra, wave: Float64) -> Complex128:
    """(F,) amplitudes of a time signal over the averaged period on the record's lines: undoes ``_wave``."""
    count, at = s.time.size, line_numbers(s)
    found = np.fft.rfft(wave)[np.minimum(at, count // 2)] * 2 / count
    result: Complex128 = np.where(at <= count // 2, found, 0.0)
    return result


def _plain(
    recording: Recording, spectra: Sequence[LineSpectra], chains: CoupledChains, axis: str, what: str
) -> dict[str, Any]:
    i = recording.axes.index(axis)
    pattern = np.zeros(chains.dofs)
    pattern[chains.motor_dofs[i]] = 1.0
    s = _liveliest(spectra, i)
    m = missing_torque(s, chains)
    x, y = _abscissa(m, pattern, i, what, None), -_wave(s, _denoised(m.torque[:, i], m.std[:, i]))
    keep = _interior(s, x.size)
    return {**_points(x[keep], y[keep]), **_labels(recording, what, axis)}


def _labels(
    recording: Recording,
    what: str,
    axis: str,
    cause: str | None = None,
    element: str | None = None,
    note: str = "",
) -> dict[str, Any]:
    return {
        "cause": cause,
        "axis": axis,
        "element": element,
        "x_label": f"{what} [{_unit(recording, what)}]",
        "y_label": f"missing torque [{recording.torque_unit}]",
        "note": note,
    }


def _liveliest(spectra: Sequence[LineSpectra], axis: int) -> LineSpectra:
    """The record in which this axis moves most, steady ones first."""
    return max(spectra, key=lambda s: (not s.transient, float(np.abs(s.position[:, axis]).max())))


def force_at(m: MissingTorque, pattern: Float64) -> tuple[Complex128, Float64]:
    """(F,) force at a place that explains the missing torque best, r = Wᵀ b f weighted with the noise, and
    its (F,) standard deviation."""
    reach = np.einsum("d,fdm->fm", pattern, m.motion)
    scale = np.maximum(np.einsum("fii->f", m.covariance).real, 1e-300)[:, None, None]
    solved = np.linalg.solve(
        m.covariance / scale + 1e-9 * np.eye(reach.shape[1]), np.stack((reach, m.torque), axis=2)
    )
    size = np.einsum("fm,fm->f", reach.conj(), solved[..., 0]).real
    force = np.einsum("fm,fm->f", reach.conj(), solved[..., 1]) / np.maximum(size, 1e-300)
    return force, np.sqrt(scale[:, 0, 0] / np.maximum(size, 1e-300))


def _denoised(values: Complex128, std: Float64) -> Complex128:
    """Lines shrunk by the share of noise in their power, so that noisy lines do not blur the picture."""
    result: Complex128 = values * _sound(values, std)
    return result


def _sound(values: Complex128, std: Float64) -> Float64:
    """(F,) share of every line's power that is not noise."""
    power = np.abs(values) ** 2
    result: Float64 = np.maximum(0.0, 1.0 - std**2 / np.maximum(power, 1e-300))
    return result


def seen_alike(s: LineSpectra, force: Complex128, std: Float64, wave: Float64) -> Float64:
    """(n,) a cause's torque as the points of the missing torque ``force`` ± ``std`` (F,) show theirs: the
    record's lines, shrunk as those are. A step is as round in it as in the points."""
    return _wave(s, _sound(force, std) * lines_of(s, wave))


def band_of(s: LineSpectra) -> list[float]:
    """Lowest and highest frequency of the lines that points and cause are drawn from [Hz]."""
    return [float(s.frequency_hz.min()), float(s.frequency_hz.max())]


def _wave(s: LineSpectra, amplitudes: Complex128) -> Float64:
    """(n,) time signal of line amplitudes over the averaged period."""
    count, at = s.time.size, line_numbers(s)
    spectrum = np.zeros(count // 2 + 1, dtype=complex)
    inside = at < spectrum.size
    spectrum[at[inside]] = amplitudes[inside] * count / 2
    result: Float64 = np.fft.irfft(spectrum, count)
    return result


def _interior(s: LineSpectra, count: int) -> slice:
    """Return the rows of a period to draw; of a record that is not one its middle (its ends ring)."""
    edge = count // 20 if s.transient else 0
    return slice(edge, count - edge)


def _abscissa(m: MissingTorque, pattern: Float64, axis: int, what: str, term: EffectTerm | None) -> Float64:
    s = m.spectra
    jw = 1j * s.omega
    if what in (laws.TORQUE, laws.TORQUE_RATE):
        values = s.torque[:, axis] * (jw if what == laws.TORQUE_RATE else 1.0)
        return _wave(s, values)
    own = pattern
    if term is not None and what == laws.POSITION and np.count_nonzero(pattern) == 2:
        own = np.maximum(pattern, 0.0)  # the motor's side of a spring
    moved = np.einsum("d,fdm,fm->f", own, m.motion, s.position)
    wave = _wave(s, moved * jw if what in (laws.VELOCITY, laws.DEFLECTION_RATE) else moved)
    if what == laws.POSITION:
        # Lines carry no mean; the encoder's does for position-locked causes.
        wave = wave + float(s.position_wave[:, axis].mean())
    return wave


def _points(x: Float64, y: Float64) -> dict[str, Any]:
    return {**_thinned(x, y), "fit": None, "seen": None, "band_hz": None}


def _thinned(x: Float64, y: Float64) -> dict[str, list[float]]:
    step = max(1, x.size // POINTS)
    return {"x": x[::step].tolist(), "y": y[::step].tolist()}


def _unit(recording: Recording, what: str) -> str:
    units: Mapping[str, str] = {
        laws.VELOCITY: f"{recording.position_unit}/s",
        laws.POSITION: recording.position_unit,
        laws.DEFLECTION: recording.position_unit,
        laws.DEFLECTION_RATE: f"{recording.position_unit}/s",
        laws.TORQUE: recording.torque_unit,
        laws.TORQUE_RATE: f"{recording.torque_unit}/s",
    }
    return units[what]
