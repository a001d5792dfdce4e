"""One look at a recording through one linear model: fit, and the causes that the records ask for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from invid.arrays import Float64
from invid.discrepancy.change import (
    around_change,
    between_records,
    change_of,
    changes_with_time,
    sooner,
)
from invid.discrepancy.joint import JointFit, fit, held_out
from invid.discrepancy.linear import from_causes, linear_fit, start_of, tones_in, without_effects
from invid.discrepancy.missing_torque import null_test
from invid.discrepancy.moves import moves_of
from invid.discrepancy.records import split, with_sticking
from invid.discrepancy.select import select
from invid.discrepancy.selection import Selection
from invid.discrepancy.tones import Tone, without_tones
from invid.discrepancy.trial import Trial
from invid.effects.view import Record
from invid.errors import InputError
from invid.model import Model
from invid.plausible import check_plausible
from invid.recording.model import Recording, Role
from invid.spectra import LineSpectra, all_spectra

ALIKE = 5.0
"""How many times as far from its noise as the training records the held-out one may be before it counts as
another machine's: twice the amplitude of an unknown law is four times the power. A guess."""


@dataclass(frozen=True, eq=False)
class Look:
    """What was seen, and in what.

    ``recording`` is without the ``tones`` that repeat with no period; ``bare`` is the fit of the linear model
    alone, ``selection`` starts from the model with the effects it came with.
    """

    recording: Recording
    model: Model
    spectra: tuple[LineSpectra, ...]
    tones: Sequence[Tone]
    train: Sequence[Record]
    held: Sequence[Record]
    bare: JointFit
    selection: Selection
    warnings: list[str]


def looked(recording: Recording, model: Model) -> Look:
    """The linear fit, and causes added while the records ask for them.

    What is kept out may have been measured after a change: the training is free of it, and little or nothing
    there says what it was. Then each record without a role keeps a part of its own out; of records for
    validation, all followed from period to period, the first period joins the training, for causes that
    change with time alone.
    """
    look = _over_changes(recording, model)
    fitted = {r.key for r in look.train} & {s.key for s in look.spectra if s.role is Role.VALIDATE}
    told = [
        f"experiment {key} is for validation, but a period of it was fitted: nothing else shows the machine "
        "on that side of the change; the gain is measured on the rest"
        for key in sorted(fitted)
    ]
    return replace(look, warnings=[*look.warnings, *told])


def _over_changes(recording: Recording, model: Model) -> Look:
    look = _looked(recording, model)
    base = look.selection.base
    if look.selection.steps:
        return look
    rejected = null_test(base.held.cost, base.held.dof, look.held).rejects
    if not rejected or base.held.cost / base.held.dof < ALIKE * base.fit.dispersion:
        return look
    if not any(s.role is Role.VALIDATE for s in look.spectra):
        other = _looked(recording, model, spare=False)
        return other if other.selection.steps else look
    other = _looked(recording, model, apart=True)
    return other if any(s.chosen.term.effect.family == "time" for s in other.selection.steps) else look


def _looked(recording: Recording, model: Model, *, spare: bool = True, apart: bool = False) -> Look:
    spectra, warnings, (base, free, train, held) = _begun(recording, model, spare, apart)
    tones = tones_in(base, held, spectra)
    if tones:
        recording = without_tones(recording, tones)
        spectra, warnings, (base, free, train, held) = _begun(recording, model, spare, apart)
    if apart and not changes_with_time(base, held, linear_axes=recording.linear):
        nothing = Trial(base, held_out(base, held))
        unchanged = Selection(nothing, nothing)
        return Look(recording, model, spectra, tones, train, held, base, unchanged, warnings)
    search = partial(
        select,
        linear_axes=recording.linear,
        free=free,
        start=start_of(model, base.layout),
        moves=moves_of(recording),
    )
    selection = search(base, train, held)
    settled = from_causes(base, selection.final.fit, train)
    if settled is not None:
        base, selection = settled, search(settled, train, held)
    selection, bare = between_records(selection), without_effects(base, train)
    parts = around_change(selection, recording)
    if parts is not None:
        around = fit(base.layout, parts[0], base.p, base.candidate, iterations=25)
        again = sooner(selection, search(around, *parts), *parts)
        if change_of(again) is not None:
            base, selection, (train, held) = around, again, parts
            bare = without_effects(base, train)
    return Look(recording, model, spectra, tones, train, held, bare, selection, warnings)


_Begun = tuple[JointFit, Float64, list[Record], list[Record]]


def _begun(
    recording: Recording, model: Model, spare: bool, apart: bool
) -> tuple[tuple[LineSpectra, ...], list[str], _Begun]:
    """Spectra, what to warn about, and the linear fit with its records (``linear_fit``)."""
    spectra = all_spectra(recording)
    if not spectra:
        raise InputError(f"{recording.source}: no experiment shakes an axis; nothing to compare with a model")
    check_plausible(recording, spectra)
    train, held, warnings = split(recording, spectra, spare=spare)
    train, standing = with_sticking(train, spectra, model, recording)
    held, _ = with_sticking(held, spectra, model, recording)
    warnings = [*(w for s in spectra for w in s.warnings), *warnings, *standing]
    return spectra, warnings, linear_fit(model, recording, spectra, train, held, apart=apart)
