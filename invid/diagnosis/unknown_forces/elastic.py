"""The diagnosis of a machine of elastic chains: what a search found, in the contract's terms."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.diagnosis.outcome import (
    Cause,
    Outcome,
    assemble_diagnosis,
    axis_above_floor,
    explained_share,
    finding_of,
    floors_left,
    limit_unfinished_search,
)
from invid.diagnosis.thresholds import EXPLAINED, MOST
from invid.diagnosis.unknown_forces.floor_doubts import doubt_floors
from invid.diagnosis.unknown_forces.left_over import forces_at, is_of_shapes
from invid.diagnosis.unknown_forces.limits import ruled_out
from invid.diagnosis.unknown_forces.machine_search import ElasticSearch, search_elastic
from invid.diagnosis.unknown_forces.named_terms import CauseWriter
from invid.diagnosis.unknown_forces.nameless import coefficients_of
from invid.diagnosis.unknown_forces.rivals import Contest, contests, is_part_of_more
from invid.diagnosis.unknown_forces.structures import additions_of
from invid.diagnosis.unknown_forces.unexplained import describe_left
from invid.effects.registry import BY_CAUSE
from invid.effects.supposed.of_effect import SmoothLaw
from invid.effects.units import unit_of
from invid.identification.fewer_masses import fewer_masses_warnings
from invid.identification.fitted_model import model_of
from invid.identification.missing_torque import AxisMissing, axis_missing
from invid.identification.own_time import AxisTones, describe_tones
from invid.identification.search_start import SearchStart
from invid.likelihood.unknown_forces.descent import Ended
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.motions import PlacedLaw
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.model.diagnosis_document import AxisResidual, Diagnosis, Unexplained, Verdict
from invid.model.document import EffectTerm, model_to_json
from invid.model.doubts import DoubtCode, doubts_of
from invid.numerics import budget
from invid.recording.model import Recording
from invid.wording.sentence import joined, marked, sentence

SURE = Contest(1.0, ())
BESIDE_MORE = sentence("Something without a name acts at the same place: it may be a part of it.")
SEEN = 5.0
"""Deviations of its size from which a cause that was not weighed is listed (statistical)."""
NOT_WEIGHED = marked(
    "Whether all is explained is not told: the time ended before these were weighed: {names}."
)
UNWEIGHED = sentence("It was not weighed: the time ended.")
OF_SHAPES = sentence("What it takes is no more than the shapes of the other causes may leave.")


@dataclass(frozen=True, eq=False)
class NamedTerm:
    """A cause's term, the key that it has in the search, its rise of −2 ln L."""

    effect: EffectTerm
    key: Hashable
    rise: float


def diagnose_elastic(begun: SearchStart) -> Diagnosis:
    """What the chains get wrong on a recording, in the contract's terms."""
    recording, found = begun.recording, search_elastic(begun)
    before, after, residual = _missing(found)
    unlike = _kept_out_unlike(found, residual)
    budget.tell("rivals of the causes", 0.9)
    explained = explained_share(residual)
    causes = named_causes(found, before, after, explained)
    masses = found.end.hypothesis.structure.sizes
    sure = {f.spot for f in found.forces if f.is_sure}
    findings = [finding_of(c, explained, masses, recording.axes, at_noise=not sure) for c in causes]
    model = model_of(found.end, tuple(c.effect for c in causes), recording)
    tones = begun.tones
    residual = [_with_tones(r, tones, recording) for r in residual]
    left = describe_tones(tones, recording) or describe_left(found.named, found.forces_named, recording)
    waiting = [w for w in found.worths if not w.is_weighed]
    if left is None and waiting:
        names = joined([*dict.fromkeys(w.cause.replace("_", " ") for w in waiting)])
        left = Unexplained(recording.axes[0], (), (), sentence(NOT_WEIGHED, names=names))
    if left is None and unlike is not None:
        left = Unexplained(unlike.axis, (), (), _kept_out_sentence(unlike))
    doubt = next((d for d in doubts_of(model.fit) if d.code is not DoubtCode.UNSEEN), None)
    if left is None and doubt is not None:
        left = Unexplained(
            recording.axes[0],
            (),
            (),
            sentence("Whether anything is missing is not told: {doubt}.", doubt=doubt.text),
        )
    outcome = Outcome(
        missing=bool(findings) or bool(sure) or bool(tones) or doubt is not None or unlike is not None,
        complete=not sure and not tones and unlike is None,
        is_weighed=not waiting,
        explained=explained if findings else None,
        left=left,
        opening=model.warnings,
        warnings=[
            *([left.sentence] if left is not None and waiting else []),
            *(d for c in causes for d in c.doubts if d not in (BESIDE_MORE, OF_SHAPES, UNWEIGHED)),
            *begun.warnings,
            *begun.stopgap,
            *fewer_masses_warnings(begun.declared, masses),
            *model.warnings,
        ],
        details={"linear_model": model_to_json(model_of(found.bare, (), recording))},
    )
    result = assemble_diagnosis(recording, residual, findings, model, outcome)
    result = doubt_floors(replace(result, forces=forces_at(found.bare, found.end, recording)), recording)
    if found.is_cut_short:
        return limit_unfinished_search(result)
    has_names = all(f.effect.table is None for f in result.findings)
    if result.verdict is Verdict.UNEXPLAINED or not has_names:
        return result  # behind what has no name anything may hide
    budget.tell("what was ruled out", 0.95)
    return replace(result, ruled_out=ruled_out(found, result.findings))


def _missing(found: ElasticSearch) -> tuple[AxisMissing, AxisMissing, list[AxisResidual]]:
    """Missing torque without causes and with them, and the residuals of both."""
    before, after = axis_missing(found.bare), axis_missing(found.end)
    return before, after, residuals(found.recording, before, after)


def _kept_out_unlike(found: ElasticSearch, residual: Sequence[AxisResidual]) -> AxisResidual | None:
    """The axis of which records kept out miss most where those fitted miss nothing: nothing is sure there,
    and yet causes explain little of what is missing here."""
    if any(f.is_sure for f in found.forces) or explained_share(residual) >= EXPLAINED:
        return None
    return axis_above_floor(residual)


def _kept_out_sentence(left: AxisResidual) -> str:
    return sentence(
        "Axis {axis}: the records kept out miss {after:.2g} {unit} rms, {floors_left:.1f} "
        "times the noise, of which those fitted show nothing: fit records like them.",
        axis=left.axis,
        after=left.after,
        unit=left.unit,
        floors_left=floors_left(left),
    )


def residuals(recording: Recording, before: AxisMissing, after: AxisMissing) -> list[AxisResidual]:
    """Missing torque of each axis without causes, with them, and by the sensors alone."""
    unit = unit_of("torque", recording.linear)
    return [
        AxisResidual(axis, unit, float(b), float(a), float(f))
        for axis, b, a, f in zip(recording.axes, before.missing, after.missing, after.floor, strict=True)
    ]


def _with_tones(residual: AxisResidual, tones: Sequence[AxisTones], recording: Recording) -> AxisResidual:
    """The residual with what repeats with no period in it, of which a period's lines show little."""
    power = sum(t.power for t in tones if recording.axes[t.axis] == residual.axis)
    before, after = (float(np.sqrt(v**2 + power)) for v in (residual.before, residual.after))
    return replace(residual, before=before, after=after)


def named_terms(found: ElasticSearch) -> list[NamedTerm]:
    """Every cause that stays, with its size."""
    end = found.end
    structure = end.hypothesis.structure
    writer = CauseWriter(end, found.recording.axes, linear=found.recording.linear)
    stays = {w.key: w.rise for w in found.worths if w.stays}
    terms = [
        NamedTerm(_with_table(found, placed, writer.law(placed)), placed.key, stays[placed.key])
        for placed in end.hypothesis.laws
        if placed.key in stays
    ]
    waiting = {w.key for w in found.worths if not w.is_weighed}
    for motor in range(structure.motors):
        parts = frozenset(p for p in Part if (p, motor) in stays)
        if (Part.DRY, motor) in stays and (Part.RISE, motor) in waiting:
            parts -= {Part.RISE}  # the simpler law is said while nobody has weighed the other
        for term in writer.friction(motor, parts):
            part = {"viscous_friction": Part.VISCOUS, "torque_offset": Part.OFFSET}.get(term.cause, Part.DRY)
            key = (part, motor) if (part, motor) in stays else (Part.RISE, motor)
            terms.append(NamedTerm(term, key, stays[key]))
    terms += [NamedTerm(writer.load_spring(p), p, stays[p]) for p in structure.pairs if p in stays]
    terms += [NamedTerm(writer.channel(*c), c, stays[c]) for c in writer.late_channels if c in stays]
    terms += [NamedTerm(writer.addition(a), a, stays[a]) for a in additions_of(structure) if a in stays]
    return terms


def _with_table(found: ElasticSearch, placed: PlacedLaw, term: EffectTerm) -> EffectTerm:
    """The term of a law, with its table where it has no name."""
    if not isinstance(placed.law, SmoothLaw):
        return term
    value, covariance = coefficients_of(found.end, placed)
    return replace(term, table=placed.law.law.table(value, covariance, linear=found.recording.linear))


def _hold_doubts(end: FittedHypothesis, key: Hashable, axes: Sequence[str]) -> list[str]:
    """What is said of viscous friction of a motor that an unknown hold works on while it is driven."""
    if not isinstance(key, tuple) or key[0] is not Part.VISCOUS:
        return []
    axis = int(key[1])
    records = [r for s in end.bench.stacks for r in s.records if r.driven[axis]]
    if not any(np.isnan(r.hold[axis]) for r in records):
        return []
    return [
        sentence(
            "viscous friction of {axes}: a hold works while the axis is driven, nothing says "
            "when it acts, and half a sample of it looks like such friction: record the "
            "demanded torque over whole periods, or drive the axis without a hold",
            axes=axes[axis],
        )
    ]


def _is_seen(effect: EffectTerm) -> bool:
    """Whether a size stands out of its deviation: a cause that is not weighed is else said by name alone."""
    size = effect.parameters[BY_CAUSE[effect.cause].main]
    return size.std is not None and abs(size.value) > SEEN * size.std


def named_causes(
    found: ElasticSearch, before: AxisMissing, after: AxisMissing, explained: float
) -> list[Cause]:
    """Every cause that stays, with its share of what is ``explained`` and how sure it is.

    Where that is less than half of what was missing, a cause at whose very place something without a name
    acts is none: it is a part of that. Of a search that was cut what was found is said.
    """
    axes = found.recording.axes
    contested = contests(found.end, found.worths, found.pursued, found.recording)
    terms, out = named_terms(found), []
    waiting = {w.key for w in found.worths if not w.is_weighed}
    whole = max(sum(t.rise for t in terms), 1.0)
    for term in terms:
        axis = axes.index(term.effect.axis)
        contest = contested.get(term.key, SURE)
        is_part = is_part_of_more(term.key, found.forces)
        of_shapes = any(w.key == term.key and is_of_shapes(w, found.end, found.bare) for w in found.worths)
        if is_part and explained < MOST and not found.is_cut_short:
            continue
        is_weighed = term.key not in waiting
        is_begun = found.end.fit.ended is Ended.CUT  # sizes of a fit that was cut say nothing
        if not is_weighed and (is_begun or not _is_seen(term.effect)):
            continue
        out.append(
            Cause(
                term.effect,
                float(before.missing[axis]),
                float(after.missing[axis]),
                explained * term.rise / whole,
                contest.share,
                contest.alternatives,
                doubts=(
                    *((BESIDE_MORE,) if is_part else ()),
                    *((OF_SHAPES,) if of_shapes else ()),
                    *(() if is_weighed else (UNWEIGHED,)),
                    *_hold_doubts(found.end, term.key, axes),
                ),
                size_is_significant=False if is_part or not is_weighed else None,
            )
        )
    return sorted(out, key=lambda c: -c.fraction)
