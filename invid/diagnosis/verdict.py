"""What a search found, as a diagnosis: verdict, residuals, findings, what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from invid.diagnosis.confidence import effect_term, is_at_floor, judge
from invid.diagnosis.context import apply_rule
from invid.diagnosis.known_effects import effects_in_model
from invid.diagnosis.outcome import assembled, explained_share
from invid.diagnosis.residual_character import describe_unexplained
from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import BROUGHT_DOWN
from invid.diagnosis.tone import Tone, describe_tones, tone_power
from invid.diagnosis.trust import (
    distrust_sentences,
    doubt_unknown_hold_timing,
    judge_linear_fit,
    limit_confidence,
    qualify_unexplained,
)
from invid.effects.registry import of_the_plant
from invid.effects.units import unit_of
from invid.likelihood.joint_fit import JointFit, evaluate_held_out
from invid.likelihood.null_test import NullTest, null_test, rms_torque
from invid.model.diagnosis_document import AxisResidual, Diagnosis
from invid.model.document import EffectTerm, Model, parameter_vector, std_by_name
from invid.numerics.arrays import frozen_float
from invid.recording.model import Recording
from invid.signals.spectral_record import SpectralRecord


def build_diagnosis(
    recording: Recording,
    model: Model,
    selection: Selection,
    bare: JointFit,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    tones: Sequence[Tone],
    warnings: list[str],
    *,
    refused: bool = False,
) -> Diagnosis:
    base, final = selection.base, selection.final
    known = len(base.fit.candidate.terms)
    without = base.held if bare is base.fit else evaluate_held_out(bare, held)
    before_test = null_test(base.fit.cost + base.held.cost, base.fit.dof + base.held.dof, [*train, *held])
    after_test = null_test(final.fit.cost + final.held.cost, final.fit.dof + final.held.dof, [*train, *held])
    # A cause below what the test of the whole sees is there if its extension gains anything.
    coherent = before_test.rejects or (bool(selection.steps) and not refused)
    unit = unit_of("torque", recording.linear)
    judged = judge(selection, recording, after_test)
    full = extended_model(model, final.fit, ())
    linear = judge_linear_fit(model, full, base, final, (before_test, after_test), recording)
    trusted = selection.partly or not linear.broken
    named = judged.findings if judged.named and trusted and not refused else ()
    sure, untimed = doubt_unknown_hold_timing(
        limit_confidence(tuple(named), linear), recording, model, final.fit
    )
    if named and not sure:  # all of it is a matter of sampling
        named, coherent = (), not judged.complete
    shown = final if named else base
    residual = []
    for i, axis in enumerate(recording.axes):
        beside = tone_power(tones, i, held)
        before, _ = rms_torque(without, i)
        after, floor = rms_torque(shown.held, i)
        before, after = (float(np.hypot(level, np.sqrt(beside))) for level in (before, after))
        residual.append(AxisResidual(axis, unit, before, after, floor))
    explained = explained_share(residual) if named or known else None
    humming = unexplained = describe_tones(tones, recording, unit)
    # A model with causes in it is as right as where they were found: what is called explained there is here.
    as_found = not selection.steps and not linear.broken and is_at_floor(base)
    as_found = as_found and explained is not None and explained > BROUGHT_DOWN
    quiet = not tones and (not coherent or as_found)
    if quiet:
        unexplained = apply_rule("nonrepeating-torque", (base.fit.evaluation, base.held), recording, unit)
    elif not named:
        if coherent:
            unexplained = qualify_unexplained(linear, describe_unexplained(base, recording))
    elif not judged.complete:
        unexplained = describe_unexplained(final, recording)
        if selection.partly and explained is not None:
            rest = f"{1.0 - explained:.0%} of what was missing is left. {unexplained.sentence}"
            unexplained = qualify_unexplained(linear, replace(unexplained, sentence=rest))
    effects = [effect_term(shown, k, recording) for k in range(known)] + [f.effect for f in named]
    inside = of_the_plant(effects_in_model(model))
    effects += [e for e in effects_in_model(model) if e not in inside]
    extended = extended_model(model, shown.fit, tuple(effects))
    extended = replace(
        extended,
        fit={
            **extended.fit,
            "trustworthy": linear.trustworthy,
            "doubts": [*linear.reasons, *linear.unseen],
            "unseen": list(linear.unseen),
        },
    )
    said = distrust_sentences(linear, model.chains.masses_per_branch, partly=bool(named))
    within = ("1.2 times " if coherent else "") + "its noise"
    return assembled(
        recording,
        residual,
        sure,
        extended,
        missing=not quiet or unexplained is not None,
        complete=judged.complete and not tones,
        explained=explained,
        left=unexplained,
        said=said,
        nothing="The model"
        + (", with the causes it already contains," if known else "")
        + f" explains the measurement to within {within}: nothing is missing.",
        further=[] if humming is None else [humming.sentence],
        warnings=[*said, *model.warnings, *warnings, *untimed, *judged.warnings],
        details=_details(before_test, after_test, selection, judged.explained),
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
    """The linear parameters refitted jointly, with the effects."""
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
    # A demand logged beside the torque has its half sample of being held by itself.
    logged = any(v.record.command is not None for v in fitted.evaluation.views)
    offsets = layout.delays(fitted.p) + (0.5 * layout.step if logged else 0.0)
    offsets[list(layout.smoothed)] -= fitted.p[layout.smoothed_at]
    held = 0.5 * layout.step * layout.stairs(fitted.p)
    facts = {
        **dict(model.fit),
        "chi2": fitted.cost,
        "dof": fitted.dof,
        "time_offset_s": {
            f"{structure.axes[i]}.time_offset": {
                "value": float(offsets[i]),
                "std": _finite(float(np.sqrt(max(fitted.covariance[n + k, n + k], 0.0)))),
            }
            for k, i in enumerate(layout.free_delays)
        }
        | {
            f"{structure.axes[i]}.time_offset": {"value": float(held[i]), "std": None}
            for i in layout.held_late
        },
        "torque_lag_s": dict(model.fit.get("torque_lag_s", {}))
        | {
            structure.axes[i]: {
                "value": float(fitted.p[at]),
                "std": _finite(float(np.sqrt(max(fitted.covariance[at, at], 0.0)))),
            }
            for i, at in zip(layout.smoothed, range(layout.smoothed_at.start, layout.count), strict=True)
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


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
