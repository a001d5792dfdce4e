"""The diagnosis of a recording: fit, test, select, judge, say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

from invid.arrays import Float64
from invid.diagnosis import Diagnosis
from invid.discrepancy.change import around_change, change_of, sooner
from invid.discrepancy.document import document
from invid.discrepancy.dropped import before_repair, find_dropped, repaired, with_dropped
from invid.discrepancy.extended import extended_model
from invid.discrepancy.given import folded
from invid.discrepancy.joint import JointFit, fit
from invid.discrepancy.linear import linear_fit, start_of, tones_in, without_effects
from invid.discrepancy.missing_torque import null_test
from invid.discrepancy.moves import moves_of
from invid.discrepancy.records import split, with_sticking
from invid.discrepancy.replayed import REFUSED, Replay, replay, with_replay
from invid.discrepancy.select import select
from invid.discrepancy.tones import without_tones
from invid.effects.base import unit_of
from invid.effects.view import Record
from invid.errors import InputError
from invid.model import Model, model_to_json
from invid.recording.model import Recording
from invid.spectra import LineSpectra, all_spectra

CLEARLY = 0.1
"""Share of a hold from which it is worth a word that it acts inside the drive."""


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
    tones = tones_in(base, held, spectra)
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
    parts = around_change(selection, sound)
    if parts is not None:
        around = fit(base.layout, parts[0], base.p, base.candidate, iterations=25)
        again = sooner(selection, search(around, *parts), *parts)
        if change_of(again) is not None:
            base, selection, (train, held) = around, again, parts
            bare = without_effects(base, train)
    warnings = [*warnings, *said_of_holds(selection.final.fit, recording)]
    result = document(sound, model, selection, bare, train, held, tones, warnings)
    if result.findings:
        linear = extended_model(model, bare, ())
        answer = replay(sound, spectra, linear, result.model, selection.final.fit, held)
        reached = not null_test(selection.final.held.cost, selection.final.held.dof, held).rejects
        if isinstance(answer, Replay) and answer.refused and not (answer.lost and reached):
            result = document(
                sound, model, selection, bare, train, held, tones, [*warnings, REFUSED], refused=True
            )
        elif isinstance(answer, Replay) and not answer.refused:
            selection = selection.wider(answer.shift)
            result = document(sound, model, selection, bare, train, held, tones, warnings)
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


__all__ = ["diagnose"]
