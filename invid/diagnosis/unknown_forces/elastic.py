"""Diagnosis of a machine of elastic chains: records, the basin, the search, what each cause is worth, the
document."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np

from invid.diagnosis.outcome import Cause, assemble_diagnosis, explained_share, finding_of
from invid.diagnosis.unknown_forces.backward import Worth, worths
from invid.diagnosis.unknown_forces.kept_out import records_of
from invid.diagnosis.unknown_forces.left_over import (
    AxisMissing,
    PlaceForce,
    axis_missing,
    missed_share,
    place_forces,
)
from invid.diagnosis.unknown_forces.named_terms import TermWriter, axis_and_element
from invid.diagnosis.unknown_forces.own_time import AxisTones, describe_tones, sized, tones_of
from invid.diagnosis.unknown_forces.pursuit import Pursued, Trial, is_sound, pursue, try_law
from invid.diagnosis.unknown_forces.structures import additions_of, without
from invid.effects.supposed_laws import supposed_laws
from invid.effects.units import unit_of
from invid.errors import NotIdentifiableError
from invid.identification.contest import begin, begin_open
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.plant import Kind, Structure
from invid.likelihood.unknown_forces.shapes import curvature
from invid.likelihood.unknown_forces.stack import hold_damping, stack_records
from invid.likelihood.unknown_forces.supposition import Bench, Supposed
from invid.model.chains import CoupledChains
from invid.model.diagnosis_document import Alternative, AxisResidual, Diagnosis, Unexplained
from invid.model.document import EffectTerm, Model, parameter_vector, std_by_name
from invid.numerics import budget
from invid.numerics.arrays import frozen_float
from invid.recording.model import Recording
from invid.signals.tones import refine_tones, remove_tones

SURE_RISE = 30.0
"""Rise of −2 ln L beyond a cause's price at which its confidence comes within a hundredth of one."""
COMPETES = 10.0
"""Rise of −2 ln L by which a rival is worse and still cannot be told from the cause (nine is three
deviations)."""


@dataclass(frozen=True, eq=False)
class Begun:
    """Where a search over causes of a recording starts."""

    recording: Recording
    first: Supposed
    warnings: tuple[str, ...]
    is_growing: bool = False
    """Whether chains may become longer."""
    tones: tuple[AxisTones, ...] = ()
    """Torque taken out since it repeats with no period: an undamped mode would take it for its own."""

    @property
    def sizes(self) -> tuple[int, ...]:
        """Masses of each axis."""
        return self.first.hypothesis.structure.sizes

    @property
    def missed(self) -> float:
        """Rms share of the torque that is missing beyond noise on what is kept out, of the worst axis."""
        return missed_share(self.first)


@dataclass(frozen=True, eq=False)
class ElasticSearch:
    """What a search found on one recording."""

    recording: Recording
    pursued: Pursued
    end: Supposed
    worths: tuple[Worth, ...]
    bare: Supposed
    forces: tuple[PlaceForce, ...]
    warnings: tuple[str, ...] = ()


def begin_elastic(recording: Recording, sizes: Sequence[int] | None) -> Begun:
    """The fit with friction at the motors that a search starts from, of the recording without tones.

    ``sizes``: masses of each axis; as many as the records ask for where not given.
    """
    begun = _begin(recording, sizes)
    tones = tuple(tones_of(begun.first))
    if not tones:
        return begun
    hz = refine_tones(recording, sorted({t.hz for axis in tones for t in axis.tones}))
    again = _begin(remove_tones(recording, hz), sizes)
    return replace(again, tones=sized(tones, recording, again.first.numbers.plant))


def _begin(recording: Recording, sizes: Sequence[int] | None) -> Begun:
    split = records_of(recording)
    damping = hold_damping((*split.fitted, *split.kept))
    bench = Bench(stack_records(split.fitted, damping))
    try:
        beside = Bench(stack_records(split.kept, damping))
        if sizes is None:
            first = begin_open(bench, recording.axis_count, beside)
        else:
            first = begin(bench, Structure(tuple(sizes)), beside)
    except np.linalg.LinAlgError as error:
        raise NotIdentifiableError(
            f"{recording.source}: {error}; check signs, units and the number of masses"
        ) from None
    return Begun(recording, first, split.warnings, is_growing=sizes is None)


def search_elastic(begun: Begun) -> ElasticSearch:
    """The search over causes on the records for fitting, judged on those kept out."""
    laws = supposed_laws(linear=begun.recording.linear)
    pursued = pursue(begun.first, laws, growing=begun.is_growing)
    found = tuple(worths(pursued.end))
    end = only(pursued.end, found)
    forces = tuple(place_forces(end))
    return ElasticSearch(begun.recording, pursued, end, found, without_causes(end), forces, begun.warnings)


def only(now: Supposed, found: Sequence[Worth]) -> Supposed:
    """The hypothesis with the causes that pay, fitted."""
    for addition in additions_of(now.hypothesis.structure):
        if any(w.key == addition and not w.stays for w in found):
            now = without(now, addition)
    gone = {w.key for w in found if not w.stays}
    # Friction that rises at slow speed rises above dry friction.
    gone -= {(Part.DRY, w.key[1]) for w in found if w.stays and _is_rise(w.key)}
    laws = tuple(p for p in now.hypothesis.laws if p.key not in gone)
    columns = {k for k in gone if isinstance(k, tuple) and isinstance(k[0], Part)}
    pairs = {k for k in now.hypothesis.structure.pairs if not any(w.key == k and w.stays for w in found)}
    absent = now.hypothesis.absent | columns | pairs
    channels = frozenset(c for c in now.hypothesis.channels if c not in gone)
    return now.refit(
        replace(now.hypothesis, laws=laws, absent=frozenset(absent), channels=channels), iterations=15
    )


def _is_rise(key: Hashable) -> TypeGuard[tuple[Part, int]]:
    return isinstance(key, tuple) and key[0] is Part.RISE


def without_causes(now: Supposed) -> Supposed:
    """The plant alone, fitted to the same records."""
    names = {c.name for c in now.fit.problem.columns}
    absent = frozenset(now.hypothesis.absent | names | set(now.hypothesis.structure.pairs))
    return now.refit(replace(now.hypothesis, laws=(), absent=absent), iterations=15)


def diagnose_elastic(begun: Begun) -> Diagnosis:
    """What the chains get wrong on a recording, in the contract's terms."""
    recording, found = begun.recording, search_elastic(begun)
    before, after = axis_missing(found.bare), axis_missing(found.end)
    residual = residuals(recording, before, after)
    causes = named_causes(found, before, after)
    effects = tuple(c.effect for c in causes)
    explained = explained_share(residual)
    masses = found.end.hypothesis.structure.sizes
    findings = [finding_of(c, explained, masses, recording.axes, at_noise=True) for c in causes]
    sure = [f for f in found.forces if f.is_sure]
    tones = begun.tones
    residual = [_with_tones(r, tones, recording) for r in residual]
    left = describe_tones(tones, recording) or describe_left(found, sure, recording)
    return assemble_diagnosis(
        recording,
        residual,
        findings,
        model_of(found, effects),
        missing=bool(findings) or bool(sure) or bool(tones),
        complete=not sure and not tones,
        explained=explained if findings else None,
        left=left,
        warnings=list(found.warnings),
        details={"value": found.end.total},
    )


def residuals(recording: Recording, before: AxisMissing, after: AxisMissing) -> list[AxisResidual]:
    """Missing torque of each axis without causes, with them, and by the sensors alone."""
    unit = unit_of("torque", recording.linear)
    return [
        AxisResidual(axis, unit, float(b), float(a), float(f))
        for axis, b, a, f in zip(recording.axes, before.missing, after.missing, after.floor, strict=True)
    ]


def _with_tones(residual: AxisResidual, tones: Sequence[AxisTones], recording: Recording) -> AxisResidual:
    """The residual with what repeats with no period in it, which its lines show little of."""
    power = sum(t.power for t in tones if recording.axes[t.axis] == residual.axis)
    return replace(
        residual,
        before=float(np.sqrt(residual.before**2 + power)),
        after=float(np.sqrt(residual.after**2 + power)),
    )


def named_causes(found: ElasticSearch, before: AxisMissing, after: AxisMissing) -> list[Cause]:
    """Every cause that stays, with its size and its share of what was missing."""
    end, axes = found.end, found.recording.axes
    writer = TermWriter(end, axes, linear=found.recording.linear)
    stays = {w.key: w for w in found.worths if w.stays}
    whole = max(found.bare.total - end.total, 1.0)
    terms: list[tuple[EffectTerm, float]] = []
    rivals: dict[int, tuple[Alternative, ...]] = {}
    contested = rivals_of(found)
    for placed in end.hypothesis.laws:
        rivals[len(terms)] = tuple(
            Alternative(r.cause, axes[axis], element, missing)
            for r, missing in contested.get(placed.key, [])
            for axis, element in (axis_and_element(end.hypothesis.structure, r.spot),)
        )
        terms.append((writer.law(placed), stays[placed.key].rise))
    for motor in range(end.hypothesis.structure.motors):
        parts = frozenset(p for p in Part if (p, motor) in stays)
        for term in writer.friction(motor, parts):
            part = {"viscous_friction": Part.VISCOUS, "torque_offset": Part.OFFSET}.get(term.cause, Part.DRY)
            worth = stays.get((part, motor)) or stays[Part.RISE, motor]
            terms.append((term, worth.rise))
    terms += [(writer.load_spring(p), stays[p].rise) for p in end.hypothesis.structure.pairs if p in stays]
    terms += [(writer.channel(*c), stays[c].rise) for c in end.hypothesis.channels if c in stays]
    terms += [(writer.addition(a), stays[a].rise) for a in additions_of(end.hypothesis.structure)]
    out = []
    for number, (term, rise) in enumerate(terms):
        axis = axes.index(term.axis)
        out.append(
            Cause(
                term,
                float(before.missing[axis]),
                float(after.missing[axis]),
                float(np.clip(rise / whole, 0.0, 1.0)),
                float(1.0 - 0.5 * np.exp(-rise / SURE_RISE)),
                rivals.get(number, ()),
            )
        )
    return sorted(out, key=lambda c: -c.fraction)


def describe_left(
    found: ElasticSearch, sure: Sequence[PlaceForce], recording: Recording
) -> Unexplained | None:
    """What still acts where, in words."""
    if not sure:
        return None
    worst = max(sure, key=lambda f: f.rms)
    axis, element = (
        axis_and_element(found.end.hypothesis.structure, worst.spot)
        if worst.spot.other < 0
        else (worst.spot.number, "load")
    )
    unit = unit_of("torque", recording.linear)
    said = f"{recording.axes[axis]}: a force of {worst.rms:.2g} {unit} rms at {element} has no name"
    return Unexplained(recording.axes[axis], (), (), said)


def model_of(found: ElasticSearch, effects: tuple[EffectTerm, ...]) -> Model:
    """The chains with their covariance, and the causes."""
    end, recording = found.end, found.recording
    plant, structure = end.numbers.plant, end.hypothesis.structure
    around = curvature(end)
    size = plant.x.size
    slope = plant.slope
    covariance = around.covariance[:size, :size] * slope[:, None] * slope
    masses = plant.of_kind(Kind.MASS)
    names: dict[str, int] = {}
    axes = recording.axes
    springs, dampers = plant.of_kind(Kind.SPRING), plant.of_kind(Kind.DAMPER)
    link = 0
    parts: dict[str, list[list[float]]] = {"mass": [], "spring": [], "damper": []}
    for axis, (first, n) in enumerate(zip(structure.motor, structure.sizes, strict=True)):
        parts["mass"].append(list(masses[first : first + n]))
        parts["spring"].append(list(springs[link : link + n - 1]))
        parts["damper"].append(list(dampers[link : link + n - 1]))
        for q in range(n):
            names[f"{axes[axis]}.mass.{q + 1}"] = structure.index(Kind.MASS).start + first + q
        for q in range(n - 1):
            names[f"{axes[axis]}.spring.{q + 1}"] = structure.index(Kind.SPRING).start + link + q
            names[f"{axes[axis]}.damper.{q + 1}"] = structure.index(Kind.DAMPER).start + link + q
        link += n - 1
    couplings = np.zeros((len(axes), len(axes)))
    for k, (i, j) in enumerate(structure.pairs):
        couplings[i, j] = couplings[j, i] = plant.of_kind(Kind.COUPLING)[k]
        names[f"{axes[i]}-{axes[j]}.coupling"] = structure.index(Kind.COUPLING).start + k
    built = CoupledChains.build(parts["mass"], parts["spring"], parts["damper"], couplings, axes=axes)
    known, _ = parameter_vector(built)
    index = [names[n] for n in known]
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    std = std_by_name(built, {n: float(deviation[names[n]]) for n in known})
    return Model(
        robot=recording.robot,
        method="refined",
        chains=built,
        std=std,
        linear=recording.linear,
        effects=effects,
        covariance=frozen_float(covariance[np.ix_(index, index)]),
        parameter_names=known,
        fit={"value": end.total},
        provenance={"recording": recording.source, "recorded": recording.created},
    )


def rivals_of(found: ElasticSearch) -> dict[Hashable, list[tuple[Trial, float]]]:
    """By the key of a law that stays: rivals that do as well in its place, with what all axes then miss."""
    out: dict[Hashable, list[tuple[Trial, float]]] = {}
    for taken, rival in found.pursued.rivals:
        own = next((p for p in found.end.hypothesis.laws if taken.placed and p.key == taken.placed.key), None)
        if own is None or rival.placed is None or budget.is_left_out("rivals of the causes"):
            continue
        others = tuple(p for p in found.end.hypothesis.laws if p is not own)
        if any(p.key == rival.placed.key for p in others):
            continue
        less = found.end.refit(replace(found.end.hypothesis, laws=others), iterations=10)
        instead = try_law(less, rival.placed)
        worse = instead.total - found.end.total + instead.kept_total - found.end.kept_total
        if is_sound(instead) and worse < COMPETES:
            missing = float(np.sqrt((axis_missing(instead).missing ** 2).mean()))
            out.setdefault(own.key, []).append((rival, missing))
    return out
