"""``figure_data``: everything the pictures show, as plain lists, for the report and the web page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from invid.effects import curve as laws
from invid.errors import InvidError
from invid.model.chains import CoupledChains
from invid.model.diagnosis_document import Diagnosis
from invid.model.document import EffectTerm, Model, model_from_json
from invid.model.forward import frf, resonances
from invid.numerics.arrays import Complex128
from invid.recording.model import Kind, Recording, Role
from invid.report.missing import (
    Missing,
    Place,
    beside,
    binned,
    cause_wave,
    missing_torques,
    place_in,
    quantity,
    sound,
)
from invid.signals.frf import frf_matrix

LEAST_FORCE, MOST_FORCES = 0.01, 12
"""Share of the strongest force from which a place is drawn, and how many at most."""
POINTS = 500
"""Points in a scatter: enough for a shape, few enough for a picture of modest size."""
EDGE = 20
"""Part of a record without a period at either end of which nothing is drawn: its ends ring."""
SIDES = (laws.VELOCITY, laws.POSITION, laws.DEFLECTION)
"""What each cause is drawn over beside its own quantity, where a wrong one would leave a shape."""
CURVES = 500
"""Points of a curve over frequency, resonances apart."""


def figure_data(recording: Recording, model: Model, diagnosis: Diagnosis | None = None) -> dict[str, Any]:
    """Data of every picture, by name; a picture that the data cannot carry is missing, with a note.

    Keys: ``frf`` (one an axis), ``missing_torque`` (one an axis), ``views`` (one a finding, or the axis of
    what is unexplained), ``residual``, ``forces`` (those of the places that count), ``notes``.
    """
    notes: list[str] = []
    shown: list[Missing] = []
    if model.chains.branches != recording.axis_count:
        count = recording.axis_count, model.chains.branches
        notes.append(f"The recording has {count[0]} axes and the model {count[1]}: no pictures.")
    else:
        try:
            shown = missing_torques(recording, model.chains)
        except (InvidError, np.linalg.LinAlgError) as error:
            notes.append(f"No spectra, so no pictures over frequency: {error}")
        if not shown and not notes:
            notes.append("The recording shakes no axis, so there are no pictures over frequency.")
    held_out = [m for m in shown if m.record.role is Role.VALIDATE] or shown
    return {
        "frf": _receptances(recording, shown, model, diagnosis, notes) if shown else [],
        "missing_torque": [_over_frequency(recording, held_out, i) for i in range(recording.axis_count)]
        if shown
        else [],
        "views": _views(recording, diagnosis) if shown and diagnosis else [],
        "residual": [] if diagnosis is None else [asdict(r) for r in diagnosis.residual],
        "forces": [] if diagnosis is None else _forces(diagnosis),
        "notes": notes,
    }


def _forces(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Places at which a force acts that is a hundredth of the strongest, the strongest first."""
    rows = sorted(diagnosis.forces, key=lambda f: -max(f.before, f.after))[:MOST_FORCES]
    return [
        asdict(f) for f in rows if max(f.before, f.after) > LEAST_FORCE * max(rows[0].before, rows[0].after)
    ]


# --- over frequency -------------------------------------------------------------------------------
def _receptances(
    recording: Recording,
    shown: Sequence[Missing],
    model: Model,
    diagnosis: Diagnosis | None,
    notes: list[str],
) -> list[dict[str, Any]]:
    slow = {e.key for e in recording.experiments if e.kind is Kind.CONSTANT_VELOCITY}
    measured = frf_matrix([m.record for m in shown if m.record.key not in slow])
    if not measured.frequency_hz.size:
        notes.append(
            "The experiments do not excite every axis at common frequencies, so the measured frequency "
            "response of an axis alone cannot be drawn; the curves are the model's."
        )
    excited = np.concatenate([m.hz[m.excited] for m in shown])
    grid = np.geomspace(0.9 * excited.min(), 1.1 * excited.max(), CURVES)
    natural = resonances(model.chains) / (2 * np.pi)
    # Every resonance is a grid point, or its peak would be cut off.
    grid = np.unique(np.concatenate((grid, natural[(natural > grid[0]) & (natural < grid[-1])])))
    plants = {"before": model.chains}
    if diagnosis is not None and diagnosis.model.chains.branches == model.chains.branches:
        plants["after"] = diagnosis.model.chains
    curves = {name: frf(chains, 2 * np.pi * grid) for name, chains in plants.items()}
    out = []
    for i, axis in enumerate(recording.axes):
        points: dict[str, Any] | None = None
        off: dict[str, float] = {}
        if measured.frequency_hz.size:
            values, std = measured.frf[:, i, i], np.sqrt(np.maximum(measured.variance[:, i, i], 0.0))
            turned = np.degrees(std / np.maximum(np.abs(values), 1e-300)).clip(0, 180)
            points = {
                "frequency_hz": measured.frequency_hz.tolist(),
                **_polar(values),
                "std": std.tolist(),
                "phase_std_deg": turned.tolist(),
            }
            for name, g in curves.items():
                curve = np.interp(measured.frequency_hz, grid, np.abs(g[:, i, i]))
                off[name] = 100.0 * float(np.median(np.abs(np.abs(values) / curve - 1.0)))
        size = np.abs(curves["before"][:, i, i])
        peaks = np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] > size[2:])) + 1
        out.append(
            {
                "axis": axis,
                "unit": f"{recording.position_unit}/({recording.torque_unit})",
                "frequency_hz": grid.tolist(),
                "simulated": {name: _polar(g[:, i, i]) for name, g in curves.items()},
                "peaks_hz": grid[peaks].tolist(),
                "measured": points,
                "off_percent": off,
            }
        )
    return out


def _polar(values: Complex128) -> dict[str, list[float]]:
    phase = np.degrees(np.angle(values))
    # −180…180 jumps where a rigid axis has −180 exactly: show −270…90 instead.
    phase = np.where(phase > 90.0, phase - 360.0, phase)
    return {"magnitude": np.abs(values).tolist(), "phase_deg": phase.tolist()}


def _over_frequency(recording: Recording, records: Sequence[Missing], i: int) -> dict[str, Any]:
    """Rms missing torque on the lines that the excitation drives, and on the others (distortion)."""
    hz, floor = binned([m.hz[m.shown] for m in records], [m.stack.sensors[m.shown, i] for m in records])
    entry: dict[str, Any] = {
        "axis": recording.axes[i],
        "unit": recording.torque_unit,
        "frequency_hz": hz,
        "noise_floor": floor,
    }
    for name in ("excited", "silent"):
        used = [(m, m.excited if name == "excited" else m.shown & ~m.excited) for m in records]
        lines, rms = binned([m.hz[u] for m, u in used], [np.abs(m.torque[u, i]) ** 2 for m, u in used])
        entry[name] = {"frequency_hz": lines, "before": rms}
    peak = max(zip(entry["excited"]["before"], entry["excited"]["frequency_hz"], strict=True), default=None)
    most = None if peak is None else {"torque": peak[0], "hz": peak[1]}
    return {**entry, "most": most, "held_out": records[0].record.role is Role.VALIDATE}


# --- over what it depends on ------------------------------------------------------------------------
def _views(recording: Recording, diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """One entry a finding (or the axis on which something unexplained lives, without a fit).

    Each has ``cause``, ``axis``, ``element``, ``y_label``, ``own`` (what the cause depends on), ``sides``
    (``what``, ``x_label``, ``x``, ``y``, ``fit`` {x, y} as points of the same instants in the band of the
    measured ones, or null, ``law`` {x, y} the cause itself over its own quantity, or null), ``band_hz`` and
    ``spectrum`` (``frequency_hz``, ``missing``, ``left`` after the cause, ``noise_floor``).
    """
    terms = [f.effect for f in diagnosis.findings if f.effect.axis in recording.axes]
    shown, lost = terms, diagnosis.unexplained
    if not terms and lost is not None and lost.axis in recording.axes:
        shown = [EffectTerm("", lost.axis, {}, "mass 1")]
    chains = diagnosis.model.chains
    if not shown or chains.branches != recording.axis_count:
        return []
    records = missing_torques(recording, chains)
    return [_view(recording, records, chains, term, terms) for term in shown]


def _view(
    recording: Recording,
    records: Sequence[Missing],
    chains: CoupledChains,
    term: EffectTerm,
    terms: Sequence[EffectTerm],
) -> dict[str, Any]:
    place, others = place_in(chains, term), [t for t in terms if t != term]
    # the record in which this axis moves most, steady ones first
    liveliest = max(records, key=lambda r: (r.record.periods > 1, float(np.ptp(r.moved(place.near)[0]))))
    m, lawless = beside(liveliest, chains, others)
    force, std = m.force_at(place.pattern)
    share = sound(force, std)
    edge = 0 if m.record.periods else m.stack.grid // EDGE
    keep = slice(edge, m.stack.grid - edge, max(1, (m.stack.grid - 2 * edge) // POINTS))
    y = -m.wave(share * force)[keep]
    fitted = cause_wave(m, place, term)
    lines = None if fitted is None else m.record.wide_lines(fitted)
    # as round as the points are, in which a step shows its lines only
    seen = None if lines is None else m.wave(share * lines)[keep]
    own = laws.abscissa(term)
    sides = []
    for what in dict.fromkeys([*filter(None, [own]), *SIDES]):
        at = _beside_springs(chains, place) if what == laws.DEFLECTION else place
        if at is None:
            continue
        x = quantity(m, at, what, own=what == own)
        law = laws.curve(term, x, place.stiffness) if what == own else None
        sides.append(
            {
                "what": what,
                "x_label": f"{what} [{_unit(recording, what)}]",
                "x": x[keep].tolist(),
                "y": y.tolist(),
                "fit": None if seen is None else {"x": x[keep].tolist(), "y": seen.tolist()},
                "law": None if law is None or law.path else {"x": law.x.tolist(), "y": law.y.tolist()},
            }
        )
    second = laws.across(term)
    notes = [
        f"it depends on the {second} too: drawn at the same instants" if second else "",
        "what the other causes explain is taken out" if len(others) > lawless else "",
        f"with {lawless} other cause(s) still in it" if lawless else "",
    ]
    use = m.shown
    hz, missing = binned([m.hz[use]], [np.abs(force[use]) ** 2])
    left = None if lines is None else binned([m.hz[use]], [np.abs(force + lines)[use] ** 2])[1]
    return {
        "cause": term.cause or None,
        "axis": term.axis,
        "element": term.element if term.cause else None,
        "y_label": f"missing torque [{recording.torque_unit}]",
        "note": ", ".join(filter(None, notes)),
        "own": own,
        "sides": sides,
        "band_hz": [float(m.hz[use].min()), float(m.hz[use].max())],
        "spectrum": {
            "frequency_hz": hz,
            "missing": missing,
            "left": left,
            "noise_floor": binned([m.hz[use]], [std[use] ** 2])[1],
        },
    }


def _beside_springs(chains: CoupledChains, place: Place) -> Place | None:
    """The spring of a place, or the one next to its mass; ``None`` for an axis without springs."""
    if np.count_nonzero(place.pattern) == 2:
        return place
    springs, start = chains.springs[place.axis].size, int(chains.motor_dofs[place.axis])
    if not springs:
        return None
    first = start + min(int(np.flatnonzero(place.pattern)[0]) - start, springs - 1)
    across = np.zeros(chains.dofs)
    across[first], across[first + 1] = 1.0, -1.0
    return Place(place.axis, across)


def _unit(recording: Recording, what: str) -> str:
    of = recording.torque_unit if what in (laws.TORQUE, laws.TORQUE_RATE) else recording.position_unit
    return of + "/s" * (what in (laws.VELOCITY, laws.DEFLECTION_RATE, laws.TORQUE_RATE))


def linear_model_of(diagnosis: Diagnosis) -> Model:
    """The linear model before the diagnosis; the diagnosed one where no cause changed it."""
    before = diagnosis.details.get("linear_model")
    return model_from_json(before) if isinstance(before, dict) else diagnosis.model
