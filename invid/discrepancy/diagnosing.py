"""The diagnosis of a recording: fit, test, select, judge, say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np

from invid.arrays import Float64
from invid.diagnosis import AxisResidual, Diagnosis, Finding, Verdict
from invid.discrepancy.change import around_change, change_of
from invid.discrepancy.character import unexplained_of
from invid.discrepancy.confidence import effect_term, judge
from invid.discrepancy.dropped import before_repair, find_dropped, repaired, with_dropped
from invid.discrepancy.extended import extended_model
from invid.discrepancy.given import carried, folded, given_effects
from invid.discrepancy.holds import HeldInside, holds_inside
from invid.discrepancy.joint import JointFit, fit, held_out
from invid.discrepancy.missing_torque import NullTest, changing, null_test, rms_torque, with_scatter
from invid.discrepancy.moves import moves_of
from invid.discrepancy.plant import Candidate, Layout
from invid.discrepancy.records import by_period, split, with_sticking
from invid.discrepancy.replayed import REFUSED, Replay, replay, with_replay
from invid.discrepancy.select import Selection, select
from invid.discrepancy.tones import Tone, power_of, said_of_tones, tones_of, without_tones
from invid.discrepancy.trust import cautious, distrust_sentences, in_the_way, trust, untimed_holds
from invid.effects.base import Record, unit_of
from invid.errors import InputError
from invid.model import Model, model_to_json
from invid.recording.model import Recording
from invid.refine.structure import ChainStructure
from invid.spectra import LineSpectra, all_spectra

CLEARLY = 0.1
"""Share of a hold from which it is worth a word that it acts inside the drive."""
EXPLAINED = 0.9
"""Share of the excess that must go before a cause is named (prototype: separates named from outside)."""


def diagnose(
    recording: Recording,
    *,
    model: Model | None = None,
    masses: Sequence[int] | Literal["auto"] | None = None,
) -> Diagnosis:
    """What the simulation gets wrong, the cause, the extended model and the gain.

    Parameters
    ----------
    model
        Start of the linear parameters; identified from the recording where not given.
    masses
        Masses of each axis for that identification; see ``invid.identify.identify``.

    Raises
    ------
    InputError, NotIdentifiableError
        Data from which no model can be drawn, or a model that does not fit the recording's axes.
    """
    from invid.trajectory import diagnose_trajectory, is_rigid_case

    if is_rigid_case(recording, masses if model is None else model.chains.masses_per_branch):
        return diagnose_trajectory(recording, model=model)
    dropped = find_dropped(recording)
    sound = repaired(recording, dropped) if dropped else recording
    if model is None:
        from invid.identify import identify

        model = identify(sound, masses=masses)
    if model.axes != recording.axes:
        raise InputError(
            f"the model has the axes {list(model.axes)}, the recording {list(recording.axes)}; diagnose with "
            "the model of this robot, or without one"
        )
    model = folded(model)
    spectra, warnings, (base, free, train, held) = _begun(sound, model)
    tones = _tones(base, held, spectra)
    if tones:
        sound = without_tones(sound, tones)
        spectra, warnings, (base, free, train, held) = _begun(sound, model)
    bare = without_effects(base, train)
    search = partial(
        select,
        linear_axes=recording.linear,
        free=free,
        start=start_of(model, base.layout),
        moves=moves_of(sound),
    )
    selection = search(base, train, held)
    parts = around_change(selection)
    if parts is not None:
        around = fit(base.layout, parts[0], base.p, base.candidate, iterations=25)
        again = search(around, *parts)
        if change_of(again) is not None:
            base, selection, (train, held) = around, again, parts
            bare = without_effects(base, train)
    warnings = [*warnings, *said_of_holds(selection.final.fit, recording)]
    result = _document(sound, model, selection, bare, train, held, tones, warnings)
    if result.findings:
        linear = extended_model(model, bare, ())
        before = selection.base.held.cost if bare is selection.base.fit else held_out(bare, held).cost
        answer = replay(sound, spectra, linear, result.model, selection.final.fit, held, before)
        if isinstance(answer, Replay) and answer.refused:
            result = _document(
                sound, model, selection, bare, train, held, tones, [*warnings, REFUSED], refused=True
            )
        elif isinstance(answer, Replay):
            selection = selection.wider(answer.shift)
            result = _document(sound, model, selection, bare, train, held, tones, warnings)
        result = with_replay(result, answer, sound)
        result = replace(result, details={**result.details, "linear_model": model_to_json(linear)})
    return with_dropped(result, recording, dropped, before_repair(recording, bare, result) if dropped else {})


_Begun = tuple[JointFit, Float64, list[Record], list[Record]]


def _begun(recording: Recording, model: Model) -> tuple[tuple[LineSpectra, ...], list[str], _Begun]:
    """Spectra, what to warn about, and the linear fit with its records (``linear_fit``)."""
    spectra = all_spectra(recording)
    if not spectra:
        raise InputError(f"{recording.source}: no experiment shakes an axis; nothing to compare with a model")
    train, held, warnings = split(recording, spectra)
    train, standing = with_sticking(train, spectra, model, recording)
    held, _ = with_sticking(held, spectra, model, recording)
    warnings = [*(w for s in spectra for w in s.warnings), *warnings, *standing]
    return spectra, warnings, linear_fit(model, recording, spectra, train, held)


def said_of_holds(final: JointFit, recording: Recording) -> list[str]:
    """What holds that no record shows alone were taken to do, where that is not to act with the command."""
    layout, said = final.layout, []
    for hold, share in zip(layout.holds, final.p[layout.holds_at], strict=True):
        friction = 0.5 * layout.step * float(share) * hold.stiffness
        if hold.damping or share < CLEARLY:
            continue
        unit = unit_of("damping", recording.linear)
        said.append(
            f"{recording.axes[hold.axis]}: its hold is taken to act up to half a sample before the command, "
            f"as fits best; viscous friction of {friction:.2g} {unit} at its motor would look alike: record "
            "the demanded torque, or drive the axis without a hold, to tell"
        )
    return said


def without_effects(base: JointFit, train: Sequence[Record]) -> JointFit:
    """The linear model alone fitted to the same records, where the model came with effects."""
    if not base.candidate.terms:
        return base
    layout = replace(base.layout, free_delays=tuple(range(base.layout.structure.motors)))
    delays = np.zeros(layout.structure.motors)
    for i, value in zip(base.layout.free_delays, _delays_of(base), strict=True):
        delays[i] = value
    count = base.layout.structure.count
    rest = base.p[count + len(base.layout.free_delays) : base.layout.count]
    p = np.concatenate((base.p[:count], delays, rest))
    return fit(layout, train, p, Candidate(), iterations=25)


def _delays_of(fitted: JointFit) -> Float64:
    count = fitted.layout.structure.count
    return fitted.p[count : count + len(fitted.layout.free_delays)]


def layout_of(
    structure: ChainStructure, records: Sequence[Record], origin: float, holds: tuple[HeldInside, ...] = ()
) -> Layout:
    """Delay and hold-over-the-sample parameters that the records leave open, and the holds' shares."""
    motors = structure.motors
    stairs = np.array([r.staircase for r in records])
    unknown = tuple(i for i in range(motors) if np.isnan(stairs[:, i]).any())
    known = np.nan_to_num(stairs[0], nan=0.5)
    return Layout(structure, records[0].step, unknown, known, tuple(range(motors)), origin, holds=holds)


def start_of(model: Model, layout: Layout) -> Float64:
    """(n,) parameters of the model as it came."""
    structure, start = layout.structure, np.zeros(layout.count)
    start[: structure.count] = structure.vector(model.chains)
    offsets = model.fit.get("time_offset_s", {}) if isinstance(model.fit, dict) else {}
    for k, i in enumerate(layout.free_delays):
        found = offsets.get(f"{structure.axes[i]}.time_offset", {})
        value = found.get("value") if isinstance(found, dict) else None
        start[structure.count + k] = 0.5 * layout.step if value is None else float(value)
    start[layout.stairs_at] = 0.5
    start[layout.holds_at] = [h.expected for h in layout.holds]
    return start


def linear_fit(
    model: Model,
    recording: Recording,
    spectra: Sequence[LineSpectra],
    train: Sequence[Record],
    held: Sequence[Record],
) -> tuple[JointFit, Float64, list[Record], list[Record]]:
    """The model, with the effects it came with, fitted to the training records, its parameters with unbounded
    time offsets, and the records with their scatter."""
    chains = model.chains
    grounded = tuple(int(i) for i in np.flatnonzero(chains.ground_springs > 0))
    structure = ChainStructure(chains.masses_per_branch, chains.axes, viscous=False, grounded=grounded)
    origin = min(float(e.time[0]) for e in recording.experiments)
    logged = train[0].command is not None
    holds = holds_inside(spectra, model, recording, with_command=logged)
    layout = layout_of(structure, train, origin, holds)
    given = given_effects(model, structure)
    late = [t.place.axis for t in given.terms if t.effect.cause == "torque_delay"]
    layout, _ = layout.without_delay(late)
    start = start_of(model, layout)
    first = fit(
        layout, with_scatter(train, spectra, layout, start), start, given, iterations=25, strict=False
    )
    if _vanishing(first) and not given.terms:
        first = _restarted(first, train)
    train = with_scatter(train, spectra, layout, first.p)
    held = with_scatter(held, spectra, layout, first.p)
    apart = changing([*train, *held])
    # A tone that repeats with no period looks like a change from one to the next.
    if apart and not _tones(first, held, spectra):
        train, held = by_period(recording, train, apart), by_period(recording, held, apart)
    return fit(layout, train, first.p, first.candidate, iterations=25), first.p, train, held


def _tones(fitted: JointFit, held: Sequence[Record], spectra: Sequence[LineSpectra]) -> list[Tone]:
    """Tones of the training and the held-out records."""
    both = (fitted.evaluation, held_out(fitted, held))
    return tones_of(both, fitted.layout, fitted.p, spectra)


def _vanishing(fitted: JointFit) -> bool:
    """A mass below a ten-thousandth of its branch in a fit that does not reach the noise: a wrong minimum."""
    chains = fitted.layout.structure.chains(fitted.p[: fitted.layout.structure.count])
    gone = any(bool((m < 1e-4 * m.sum()).any()) for m in chains.masses)
    return gone and fitted.cost > 3.0 * fitted.dof


def _restarted(fitted: JointFit, train: Sequence[Record]) -> JointFit:
    """The best of fits from evenly shared masses with springs that spread their modes over the band."""
    layout, structure = fitted.layout, fitted.layout.structure
    best = fitted
    masses = structure.slices["mass"]
    totals = np.exp(fitted.p[masses])
    top = max(float(r.omega[r.excited].max()) for r in train if r.excited.any())
    for part in (0.6, 0.35, 0.2, 0.85):
        p = fitted.p.copy()
        at = 0
        springs: list[float] = []
        for n in structure.sizes:
            share = float(totals[at : at + n].sum()) / n
            p[masses.start + at : masses.start + at + n] = np.log(share)
            springs += [float(np.log(share * (part * top) ** 2 / 2))] * (n - 1)
            at += n
        p[structure.slices["spring"]] = springs
        p[structure.slices["damper"]] = 0.02 * np.exp(springs) / top
        trial = fit(layout, train, p, Candidate(), iterations=60, strict=False)
        if trial.cost < best.cost:
            best = trial
        if best.cost < 2.0 * best.dof:
            break
    return best


def _document(
    recording: Recording,
    model: Model,
    selection: Selection,
    bare: JointFit,
    train: Sequence[Record],
    held: Sequence[Record],
    tones: Sequence[Tone],
    warnings: list[str],
    *,
    refused: bool = False,
) -> Diagnosis:
    base, final = selection.base, selection.final
    known = len(base.fit.candidate.terms)
    without = base.held if bare is base.fit else held_out(bare, held)
    before_test = null_test(base.fit.cost + base.held.cost, base.fit.dof + base.held.dof, [*train, *held])
    after_test = null_test(final.fit.cost + final.held.cost, final.fit.dof + final.held.dof, [*train, *held])
    coherent = bool(selection.steps) or before_test.rejects
    unit = unit_of("torque", recording.linear)
    judged = judge(selection, recording, after_test)
    full = extended_model(model, final.fit, ())
    linear = trust(model, full, base, final, (before_test, after_test), recording)
    named = judged.findings if judged.named and not linear.broken and not refused else ()
    sure, untimed = untimed_holds(cautious(tuple(named), linear), recording, model, final.fit)
    if named and not sure:  # all of it is a matter of sampling
        named, coherent = (), not judged.complete
    shown = final if named else base
    residual = []
    for i, axis in enumerate(recording.axes):
        beside = power_of(tones, i, held)
        before, _ = rms_torque(without, i)
        after, floor = rms_torque(shown.held, i)
        before, after = (float(np.hypot(level, np.sqrt(beside))) for level in (before, after))
        residual.append(AxisResidual(axis, unit, before, after, floor))
    b2 = sum(r.before**2 for r in residual)
    a2 = sum(r.after**2 for r in residual)
    n2 = sum(r.noise_floor**2 for r in residual)
    explained = None
    if named or known:
        explained = float(np.clip(1.0 - (a2 - n2) / max(b2 - n2, 1e-300), 0.0, 1.0))
    unexplained = said_of_tones(tones, recording, unit)
    if not coherent and not tones:
        verdict = Verdict.CONSISTENT
    elif not named:
        verdict = Verdict.UNEXPLAINED
        if coherent:
            unexplained = in_the_way(linear, unexplained_of(base, recording))
    elif judged.complete and not tones:
        verdict = Verdict.EXPLAINED
    else:
        verdict = Verdict.PARTLY_EXPLAINED
        if not judged.complete:
            unexplained = unexplained_of(final, recording)
    findings = tuple(_axis_by_name(f) for f in sure)
    warnings = [*warnings, *untimed]
    said = distrust_sentences(linear, model.chains.masses_per_branch)
    sentences = [*said, *(f.sentence for f in findings)]
    if verdict is Verdict.CONSISTENT:
        sentences.append(
            "The model"
            + (", with the causes it already contains," if known else "")
            + " explains the measurement to within its noise: nothing is missing."
        )
    if unexplained is not None:
        sentences.append(unexplained.sentence)
    sentences += [
        u.sentence for u in (said_of_tones(tones, recording, unit),) if u not in (None, unexplained)
    ]
    effects = [effect_term(shown, k, recording) for k in range(known)] + [f.effect for f in named]
    effects += [e for e in carried(model) if e.cause == "dropped_samples"]
    extended = extended_model(model, shown.fit, tuple(effects))
    extended = replace(
        extended,
        fit={
            **extended.fit,
            "trustworthy": linear.trustworthy,
            "doubts": [*linear.reasons, *linear.unseen],
        },
    )
    return Diagnosis(
        verdict=verdict,
        residual=tuple(residual),
        explained_fraction=explained,
        findings=findings,
        unexplained=unexplained,
        model=extended,
        warnings=tuple(dict.fromkeys([*said, *model.warnings, *warnings, *judged.warnings])),
        sentences=tuple(sentences),
        details=_details(before_test, after_test, selection, judged.explained),
    )


def _axis_by_name(finding: Finding) -> Finding:
    """The separating experiment names its axis as everything else does."""
    planned = finding.separating_experiment
    if planned is None:
        return finding
    return replace(finding, separating_experiment={**planned, "axis": finding.effect.axis})


def _details(before: NullTest, after: NullTest, selection: Selection, explained: float) -> dict[str, Any]:
    def test(t: NullTest) -> dict[str, float]:
        return {"chi2": t.chi2, "dof": t.dof, "noise_dof": t.noise_dof, "p": t.p}

    return {
        "null_test": test(before),
        "null_test_after": test(after),
        "weighted_explained_fraction": explained,
        "candidates": [
            [
                {
                    "cause": trial.term.effect.cause,
                    "axis": trial.fit.layout.structure.axes[trial.term.place.axis],
                    "element": trial.term.place.element,
                    "chi2": trial.fit.cost,
                    "chi2_held_out": trial.held.cost,
                    "score": score,
                }
                for trial, score in step.ranked
            ]
            for step in selection.steps
        ],
    }


__all__ = ["diagnose", "linear_fit"]
