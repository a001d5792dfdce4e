"""The diagnosis of a recording: fit, test, select, judge, say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from invid.diagnosis import Diagnosis
from invid.discrepancy.again import looked_again
from invid.discrepancy.beside import allowing_for_viscous, with_viscous
from invid.discrepancy.consequence import with_consequences
from invid.discrepancy.declared import with_the_declared_mass
from invid.discrepancy.document import document
from invid.discrepancy.dropped import before_repair, find_dropped, repaired, with_dropped
from invid.discrepancy.extended import extended_model
from invid.discrepancy.given import folded
from invid.discrepancy.joint import JointFit
from invid.discrepancy.look import looked
from invid.discrepancy.missing_torque import null_test
from invid.discrepancy.replayed import REFUSED, Replay, replay, with_replay
from invid.effects.base import unit_of
from invid.errors import InputError
from invid.glitches import without_glitches
from invid.model import Model, model_to_json
from invid.plausible import check_units
from invid.recording.model import Recording

CLEARLY = 0.1
"""Share of a hold from which it is worth a word that it acts inside the drive."""

OF_GIVEN = "the model given, of its own recording: "
"""Before what the identification of a model warned of that was drawn from other data."""


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
    recording, told = without_glitches(recording)
    result = _diagnosed(recording, model, masses)
    if told:
        result = replace(result, warnings=tuple(dict.fromkeys([*result.warnings, *told])))
    return with_consequences(result, recording)


def _diagnosed(
    recording: Recording, model: Model | None, masses: Sequence[int] | Literal["auto"] | None
) -> Diagnosis:
    """The diagnosis of a recording without glitches."""
    from invid.trajectory import diagnose_trajectory, is_rigid_case

    if is_rigid_case(recording, masses if model is None else model.chains.masses_per_branch):
        return diagnose_trajectory(recording, model=model)
    dropped = find_dropped(recording)
    sound = repaired(recording, dropped) if dropped else recording
    own = model is None
    if model is None:
        from invid.identify import identify

        model = identify(sound, masses=masses)
    elif model.provenance.get("recorded") != recording.created:
        said = (w.removeprefix(OF_GIVEN) for w in model.warnings)
        model = replace(model, warnings=tuple(f"{OF_GIVEN}{w}" for w in said))
    if model.axes != recording.axes:
        raise InputError(
            f"the model has the axes {list(model.axes)}, the recording {list(recording.axes)}; diagnose with "
            "the model of this robot, or without one"
        )
    check_units(model, recording)
    look = looked(sound, folded(model))
    look = looked_again(look, masses if own else model.chains.masses_per_branch)
    if own:
        look = with_the_declared_mass(look, recording.masses_per_axis if masses is None else masses)
    sound, model, tones, bare = look.recording, look.model, look.tones, look.bare
    train, held = look.train, look.held
    selection = allowing_for_viscous(with_viscous(look.selection, train, held)).as_far_as_explained()
    warnings = [*look.warnings, *said_of_holds(selection.final.fit, recording)]
    result = document(sound, model, selection, bare, train, held, tones, warnings)
    if result.findings:
        linear = extended_model(model, bare, ())
        answer = replay(sound, look.spectra, linear, result.model, selection.final.fit, held)
        reached = not null_test(selection.final.held.cost, selection.final.held.dof, held).rejects
        lost = isinstance(answer, Replay) and answer.lost and reached
        if isinstance(answer, Replay) and answer.refused and not lost:
            result = document(
                sound, model, selection, bare, train, held, tones, [*warnings, REFUSED], refused=True
            )
        elif isinstance(answer, Replay) and not lost:
            selection = selection.wider(answer.shift)
            result = document(sound, model, selection, bare, train, held, tones, warnings)
        result = with_replay(result, answer, sound, lost=lost)
        result = replace(result, details={**result.details, "linear_model": model_to_json(linear)})
    return with_dropped(result, recording, dropped, before_repair(recording, bare, result) if dropped else {})


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
