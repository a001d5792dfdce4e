"""The result of a search as a diagnosis: verdict, residuals, findings, remainder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from invid.diagnosis.confidence import effect_term, is_at_floor, judge
from invid.diagnosis.known_effects import effects_in_model
from invid.diagnosis.outcome import assemble_diagnosis, explained_share, floors_left
from invid.diagnosis.remainder.residual_character import describe_unexplained
from invid.diagnosis.rules.nonrepeating_torque import describe_scatter
from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import BROUGHT_DOWN
from invid.diagnosis.tone import Tone, describe_tones, tone_power
from invid.diagnosis.trust import (
    distrust_sentences,
    doubt_unknown_hold_timing,
    judge_linear_fit,
    limit_confidence,
    qualify_unexplained,
    untold_remainder,
)
from invid.effects.laws.empirical_law import NAMELESS
from invid.effects.registry import effects_of_plant
from invid.effects.units import unit_of
from invid.likelihood.joint_fit import JointFit, evaluate_held_out
from invid.likelihood.null_test import NullTest, null_test, rms_torque
from invid.model.diagnosis_document import AxisResidual, Diagnosis
from invid.model.document import EffectTerm, Model, parameter_vector, std_by_name
from invid.model.doubts import doubt_facts
from invid.numerics.arrays import frozen_float
from invid.recording.model import Recording
from invid.signals.spectral_record import SpectralRecord


def build_diagnosis(  # noqa: PLR0913 - the parts of a document
    recording: Recording,
    model: Model,
    selection: Selection,
    bare: JointFit,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    tones: Sequence[Tone],
    warnings: list[str],
    *,
    is_refused: bool = False,
) -> Diagnosis:
    """The diagnosis of a selection; ``is_refused``: the simulation over time refused its causes."""
    base, final = selection.base, selection.final
    known = len(base.fit.candidate.terms)
    without = base.held if bare is base.fit else evaluate_held_out(bare, held)
    before_test = null_test(base.fit.cost + base.held.cost, base.fit.dof + base.held.dof, [*train, *held])
    after_test = null_test(final.fit.cost + final.held.cost, final.fit.dof + final.held.dof, [*train, *held])
    # A cause too small for the null test of all records counts if its extension gains anything over time.
    coherent = before_test.rejects or (bool(selection.steps) and not is_refused)
    unit = unit_of("torque", recording.linear)
    judgement = judge(selection, recording, after_test)
    linear_model = extended_model(model, final.fit, ())
    linear = judge_linear_fit(model, linear_model, base, final, (before_test, after_test), recording)
    trusted = selection.only_independent or selection.is_cut_short or not linear.broken
    named = judgement.findings if judgement.named and trusted and not is_refused else ()
    sure, timing_warnings = doubt_unknown_hold_timing(
        limit_confidence(tuple(named), linear), recording, model, final.fit
    )
    if named and not sure:  # all findings are sampling conventions
        named, coherent = (), not judgement.complete
    shown = final if named else base
    residual = []
    for i, axis in enumerate(recording.axes):
        beside = tone_power(tones, i, held)
        before, _ = rms_torque(without, i)
        after, floor = rms_torque(shown.held, i)
        before, after = (float(np.hypot(level, np.sqrt(beside))) for level in (before, after))
        residual.append(AxisResidual(axis, unit, before, after, floor))
    explained = explained_share(residual) if named or known else None
    nameless = [s for s in selection.steps if s.chosen.term.effect.cause == NAMELESS]
    tone_summary = unexplained = describe_tones(tones, recording, unit)
    # A given model with causes in it explains what it explained when it was found.
    as_found = not selection.steps and not linear.broken and is_at_floor(base)
    as_found = as_found and explained is not None and explained > BROUGHT_DOWN
    # Under a broken linear fit a χ² that rejects nothing says nothing: its noise is as wrong.
    quiet = not tones and not linear.broken and (not coherent or as_found)
    if quiet:
        unexplained = describe_scatter((base.fit.evaluation, base.held), recording, unit)
    elif named and nameless:
        unexplained = describe_unexplained(nameless[0].before, recording)
    elif not named:
        if coherent:
            unexplained = qualify_unexplained(linear, describe_unexplained(base, recording))
        else:
            unexplained = untold_remainder(max(residual, key=floors_left).axis)
    elif not judgement.complete:
        unexplained = describe_unexplained(final, recording)
        if selection.only_independent and explained is not None:
            rest = f"{1.0 - explained:.0%} of what was missing is left. {unexplained.sentence}"
            unexplained = qualify_unexplained(linear, replace(unexplained, sentence=rest))
    effects = [effect_term(shown, k, recording) for k in range(known)] + [f.effect for f in named]
    inside = effects_of_plant(effects_in_model(model))
    effects += [e for e in effects_in_model(model) if e not in inside]
    extended = extended_model(model, shown.fit, tuple(effects))
    if not named and model.provenance.get("recorded") == recording.created:
        extended = model  # nothing better is known than what the identification found
    extended = replace(
        extended,
        fit={
            **extended.fit,
            **doubt_facts(linear.doubts),
            "unseen": list(linear.unseen),
        },
    )
    distrust = distrust_sentences(linear, model.chains.masses_per_branch, is_named=bool(named))
    level_text = ("1.2 times " if coherent else "") + "its noise"
    return assemble_diagnosis(
        recording,
        residual,
        sure,
        extended,
        missing=not quiet or unexplained is not None,
        complete=judgement.complete and not tones,
        explained=explained,
        left=unexplained,
        opening=distrust,
        consistent_sentence="The model"
        + (", with the causes it already contains," if known else "")
        + f" explains the measurement to within {level_text}: nothing is missing.",
        closing=[] if tone_summary is None else [tone_summary.sentence],
        warnings=[*distrust, *model.warnings, *warnings, *timing_warnings, *judgement.warnings],
        details=_details(before_test, after_test, selection, judgement.explained),
    )


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


def extended_model(
    model: Model,
    fitted: JointFit,
    effects: tuple[EffectTerm, ...],
) -> Model:
    """The model with the linear parameters of the joint fit, and with the effects."""
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
    # For a demand logged beside the torque the half sample of holding is counted separately.

    logged = any(v.record.command is not None for v in fitted.evaluation.views)
    offsets = layout.delays(fitted.p) + (0.5 * layout.step if logged else 0.0)
    offsets[list(layout.smoothed)] -= fitted.p[layout.lag_slice]
    held = 0.5 * layout.step * layout.zoh_share(fitted.p)
    facts = {
        **dict(model.fit),
        "chi2": fitted.cost,
        "dof": fitted.dof,
        "time_offset_s": {
            f"{structure.axes[i]}.time_offset": {
                "value": float(offsets[i]),
                "std": _finite_or_none(float(np.sqrt(max(fitted.covariance[n + k, n + k], 0.0)))),
            }
            for k, i in enumerate(layout.free_delays)
        }
        | {
            f"{structure.axes[i]}.time_offset": {"value": float(held[i]), "std": None}
            for i in layout.late_zoh_axes
        },
        "torque_lag_s": dict(model.fit.get("torque_lag_s", {}))
        | {
            structure.axes[i]: {
                "value": float(fitted.p[at]),
                "std": _finite_or_none(float(np.sqrt(max(fitted.covariance[at, at], 0.0)))),
            }
            for i, at in zip(layout.smoothed, range(layout.lag_slice.start, layout.count), strict=True)
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


def _finite_or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None
