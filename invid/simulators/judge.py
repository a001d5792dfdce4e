"""A user's simulator against a recording: what it gets wrong, what it lacks, its corrected copy and the gain.

The diagnosis says what the machine is, the simulator's file what it claims; where they differ beyond the
uncertainty a number is wrong, and a cause that the file does not have is missing. How much that matters is
measured by the simulator's own engine, before and after, on records kept out of the diagnosis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from invid.errors import ModelError
from invid.exchange.linear_plant import effect_name
from invid.model.diagnosis_document import Diagnosis, RuledOut
from invid.model.document import EffectTerm, Estimate, Model, effect_to_json, linear_parameters
from invid.numerics.arrays import Float64
from invid.numerics.distributions import normal_isf
from invid.recording.model import Experiment, Recording, Role
from invid.simulators.guided import BANDS, Guided, Sampling, Simulator, guided, missed, moved_by_noise
from invid.wording.sentence import sentence

RIGHT = 1.2
"""Missing torque over its floor up to which a simulator is right: the diagnosis' own."""
UNTOLD = 10.0
"""Floors to which noise alone moves a simulator that such a record cannot judge."""
FALSE_ALARMS = 0.01
"""Probability that one of all numbers of a right simulator is called wrong."""
_KEEPING = ("coulomb_friction", "backlash", "spring_hysteresis", "dry_friction", "stribeck_friction")
"""Causes that keep what noise did to them."""
_ALIKE = 0.1
"""Relative difference of all ratios of masses and springs within which they are one square."""
_GEARED = 4.0
"""Ratio from which it is a gear's square, of 2 at least, and no wrong inertia (empirical)."""
AT_LEAST = 0.01
"""Relative difference below which a number is not called wrong: an engine's steps and solver are worth as
much."""


@dataclass(frozen=True, eq=False)
class _Missing:
    """Spectra of the missing torque of each held-out record, the floors' powers, and what noise drawn anew
    changes by run of the simulator itself, where that was tried; powers that its one step adds, where it
    takes one."""

    records: list[Guided]
    spectra: list[Any]
    floors: list[Float64]
    tried: list[Float64] | None = None
    blurred: list[Float64] | None = None

    def rms(self, axis: int, low: float = 0.0, high: float = math.inf) -> tuple[float, float]:
        """Rms and floor of one axis over a band, mean over the records."""

        def mean(powers: list[Any]) -> float:
            inside = [(g.frequencies >= low) & (g.frequencies < high) for g in self.records]
            return float(np.mean([p[k, axis].sum() for p, k in zip(powers, inside, strict=True)]))

        floor = max(mean(self.floors), 0.0 if self.tried is None else mean(self.tried))
        return math.sqrt(mean([np.abs(x) ** 2 for x in self.spectra])), math.sqrt(floor)

    def coarse(self, axis: int) -> float:
        """Rms of the floor and of what its one step may add; 0 where it takes any step."""
        if self.blurred is None:
            return 0.0
        return math.hypot(*replace(self, spectra=[np.sqrt(p) for p in self.blurred]).rms(axis))

    def moved(self, axis: int) -> float:
        """Floors of a linear plant that noise alone makes of one axis."""
        return self.rms(axis)[1] / replace(self, tried=None).rms(axis)[1]


def judge(
    recording: Recording, diagnosis: Diagnosis, simulator: Simulator, corrected: Path | None = None
) -> dict[str, Any]:
    """The entry ``against`` of a diagnosis document; ``corrected``: where the corrected copy goes."""
    model = diagnosis.model
    held, warnings = _held_out(recording)
    records = [guided(e, Sampling.of(model), recording.encoder_resolution) for e in held]
    before = _missing(simulator, records, model)
    claimed = simulator.claimed()
    parameters, missing = ([], []) if claimed is None else _differences(claimed, model, diagnosis.ruled_out)
    warnings += simulator.prepared(records)
    cannot_hold: Sequence[str] = ()
    after, written = None, None
    right = all(_at_floor(before, i) for i in range(recording.axis_count))
    gear = None if claimed is None or right else _gear(claimed, model)
    coarse = not right and all(
        _at_floor(before, i) or before.rms(i)[0] <= RIGHT * before.coarse(i)
        for i in range(recording.axis_count)
    )
    compared = not right and gear is None and not coarse
    if corrected is not None and not right and gear is not None:
        warnings.append("no corrected copy is written: the map's 'scale' is to be set, not the simulator")
    elif corrected is not None and compared:
        try:
            copy, cannot_hold = simulator.corrected(model, corrected)
            after, written = _missing(copy, records, model), str(corrected)
        except ModelError as error:
            warnings.append(sentence("no corrected copy is written: {error}", error=error))
    best = after or before
    keeps = sorted({t.cause for t in (claimed or model).effects if t.cause in _KEEPING})
    why = f", as {' and '.join(keeps).replace('_', ' ')} keeps what it did" if keeps else ""
    warnings += [
        f"axis {name}: noise alone moves this simulator by {best.moved(i):.0f} times what it leaves a linear "
        f"plant{why}; right and wrong cannot be told apart by it"
        for i, name in enumerate(recording.axes)
        if best.moved(i) > UNTOLD
    ]
    axes = [_axis_rows(recording, i, before, after) for i in range(recording.axis_count)]
    out: dict[str, Any] = {
        "simulator": simulator.path,
        "engine": simulator.engine,
        "right": right,
        "parameters": parameters if compared else [],
        "missing": [effect_to_json(t) for t in missing] if compared else [],
        "held_out": {k: _whole(axes, k) for k in ("before", "after", "noise_floor")},
        "axes": axes,
        "experiments": [g.key for g in records],
        "corrected": written,
        "cannot_hold": list(cannot_hold),
        "warnings": warnings,
    }
    out["sentences"] = _sentences(out, missing if compared else [], claimed, diagnosis)
    if coarse:
        worst = max(before.coarse(i) / before.rms(i)[1] for i in range(recording.axis_count))
        out["sentences"].insert(
            1,
            f"Its step of {simulator.step:g} s is too coarse to judge it: a right simulator of that step may "
            f"miss {worst:.3g} times what noise leaves. Export it with a smaller or a variable step.",
        )
    if gear is not None:
        one, other = ("motor", "joint") if gear > 1.0 else ("joint", "motor")
        turns = max(gear, 1.0 / gear)
        out["sentences"].append(
            f"All its masses and springs are {gear**2:.5g} times the measured, the square of {gear:.4g}: the "
            f"recording counts the {one} of a gear of {turns:.4g}, the file its {other}. Set 'scale' in the "
            f"map to {1.0 / gear:.4g} for positions and {gear:.4g} for torques."
        )
    return out


def _gear(claimed: Model, model: Model) -> float | None:
    """The gear between what a file and a recording count: the same square in every mass and spring."""
    theirs = {p.name: p.value for p in linear_parameters(claimed)}
    ours = [p for p in linear_parameters(model) if p.kind in ("mass", "spring") and p.value > 0.0]
    ratios = np.array([theirs.get(p.name, 0.0) / p.value for p in ours])
    if not (ratios > 0.0).all():
        return None
    usual = float(np.median(ratios))
    alike = np.abs(ratios / usual - 1.0).max() < _ALIKE
    return math.sqrt(usual) if alike and abs(math.log(usual)) > math.log(_GEARED) else None


def _held_out(recording: Recording) -> tuple[list[Experiment], list[str]]:
    held = list(recording.with_role(Role.VALIDATE))
    if held:
        return held, []
    last = recording.experiments[-1:]
    return list(last), [
        sentence(
            "no record is for validation alone: the simulator is judged on the last one, which "
            "the diagnosis has seen"
        )
    ]


def _missing(simulator: Simulator, records: list[Guided], model: Model) -> _Missing:
    plant = simulator.claimed() or model
    found = missed(simulator, records, plant)
    out = _Missing(found.records, found.spectra, [g.floor(model) for g in records])
    if simulator.step:
        out = replace(out, blurred=[g.blurred(simulator.step, plant) for g in found.records])
    over = [rms / floor for rms, floor in map(out.rms, range(len(model.axes)))]
    return replace(out, tried=moved_by_noise(simulator, found, plant)) if max(over) > RIGHT else out


def _at_floor(m: _Missing, axis: int) -> bool:
    rms, floor = m.rms(axis)
    return rms <= RIGHT * floor and m.moved(axis) <= UNTOLD


def _axis_rows(recording: Recording, i: int, before: _Missing, after: _Missing | None) -> dict[str, Any]:
    """Missing torque of one axis, and by band."""

    def row(low: float, high: float) -> dict[str, Any]:
        rms, floor = before.rms(i, low, high)
        gained, floor = (None, floor) if after is None else after.rms(i, low, high)
        return {"before": rms, "after": gained, "noise_floor": floor}

    low, high = min(g.low for g in before.records), max(g.high for g in before.records)
    bands = [
        {"from_hz": float(a), "to_hz": float(b), **row(a, b * (1.0 + 1e-6 * (b >= high)))}
        for a, b in pairwise(np.geomspace(low, high, BANDS + 1))
    ]
    unit = recording.torque_unit
    return {"axis": recording.axes[i], "unit": unit, **row(0.0, math.inf), "bands": bands}


def _whole(axes: list[dict[str, Any]], key: str) -> float | None:
    """Rms over the axes, each in units of its floor; ``noise_floor`` is then 1."""
    if any(a[key] is None for a in axes):
        return None
    return math.sqrt(np.mean([(a[key] / a["noise_floor"]) ** 2 for a in axes]))


def _differences(
    claimed: Model, model: Model, ruled_out: Sequence[RuledOut] = ()
) -> tuple[list[dict[str, Any]], list[EffectTerm]]:
    """Numbers of the simulator that differ beyond the uncertainty; causes that it lacks.

    What it has, and the recording would not have shown (``ruled_out``), is not called wrong.
    """
    theirs = {p.name: p.value for p in linear_parameters(claimed)}
    numbers = [
        (
            p.name.replace(".", " "),
            theirs.get(p.name, 0.0),
            Estimate(float(p.value), None if math.isnan(p.std) else p.std, p.unit),
        )
        for p in linear_parameters(model)
    ]
    known, found = ({_place(t): t for t in m.effects} for m in (claimed, model))
    for place in found.keys() & known.keys():
        for name, estimate in found[place].parameters.items():
            if name in known[place].parameters:
                words = f"{_words(found[place])} {name}"
                numbers.append((words, known[place].parameters[name].value, estimate))
    limit = normal_isf(FALSE_ALARMS / 2 / max(len(numbers), 1))
    rows = []
    for name, given, e in numbers:
        away, least = abs(given - e.value), AT_LEAST * max(abs(e.value), abs(given))
        if e.std is not None and away > max(limit * e.std, least):
            rows.append({"name": name, "simulator": given, "value": e.value, "std": e.std, "unit": e.unit})
    unseen: dict[tuple[str | None, ...], float | None] = {
        (r.cause, r.axis, r.element or "mass 1", r.other_axis): r.limit for r in ruled_out
    }
    for place, term in known.items():
        name, e = next(iter(term.parameters.items()))
        most = unseen.get(place, 0.0)
        if place not in found and most is not None and abs(e.value) > most:
            told = f"{_words(term)} {name}"
            rows.append({"name": told, "simulator": e.value, "value": 0.0, "std": None, "unit": e.unit})
    return rows, [t for t in model.effects if _place(t) not in known]


def _words(term: EffectTerm) -> str:
    return " ".join(x for x in (term.axis, term.element, term.cause) if x)


def _place(term: EffectTerm) -> tuple[str | None, ...]:
    return term.cause, term.axis, term.element or "mass 1", term.other_axis


def _sentences(
    out: dict[str, Any], missing: list[EffectTerm], claimed: Model | None, diagnosis: Diagnosis
) -> list[str]:
    name = Path(out["simulator"]).name
    before, after = out["held_out"]["before"], out["held_out"]["after"]
    if out["right"]:
        return [
            sentence(
                "{name} is right on this recording: it misses {before:.2g} times what noise leaves.",
                name=name,
                before=before,
            )
        ]
    lines = [
        sentence(
            "{name} misses {before:.3g} times the torque that noise leaves, run by {engine}.",
            name=name,
            before=before,
            engine=out["engine"],
        )
    ]
    for a in out["axes"]:
        worst = max(a["bands"], key=lambda b: b["before"])
        if a["before"] > RIGHT * a["noise_floor"]:
            lines.append(
                sentence(
                    "Axis {axis}: {before:.3g} {unit} missing (noise {noise_floor:.2g}), most of it "
                    "between {from_hz:.2g} and {to_hz:.2g} Hz.",
                    axis=a["axis"],
                    before=a["before"],
                    unit=a["unit"],
                    noise_floor=a["noise_floor"],
                    from_hz=worst["from_hz"],
                    to_hz=worst["to_hz"],
                )
            )
    if claimed is None:
        lines.append(
            sentence(
                "What it says of masses, springs and friction cannot be read from it: its numbers "
                "and causes were not compared, only its motion."
            )
        )
    for p in out["parameters"]:
        spread = "" if p["std"] is None else f" ± {p['std']:.2g}"
        lines.append(
            f"{p['name']}: {p['simulator']:.4g}, measured {p['value']:.4g}{spread} {p['unit'] or ''}."
        )
    lines += [f"It lacks {effect_name(t)}." for t in missing]
    if after is not None:
        lines.append(
            sentence(
                "The corrected copy {corrected} misses {after:.3g} times what noise leaves.",
                corrected=out["corrected"],
                after=after,
            )
        )
    lines += [f"It cannot hold {x}." for x in out["cannot_hold"]]
    if diagnosis.unexplained is not None:
        lines.append(sentence("What is left has no name: see the diagnosis."))
    return lines
