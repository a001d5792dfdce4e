"""The diagnosis of a large motion: rows of time instead of spectral lines, judged as every other."""

from __future__ import annotations

import numpy as np

from invid.clauses import cause_name, dependent_on
from invid.diagnosis.outcome import (
    Cause,
    Outcome,
    assemble_diagnosis,
    axis_above_floor,
    explained_share,
    finding_of,
    floors_left,
    limit_unfinished_search,
    share_among_rivals,
)
from invid.diagnosis.thresholds import COMPETES, NAMED, UNSIZED
from invid.effects.large_motion.load_dependent_friction import LoadFrictionLaw
from invid.effects.laws.empirical_law import NAMELESS
from invid.effects.registry import BY_CAUSE, CATALOGUE
from invid.errors import InputError
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.price import NUMBER
from invid.model.diagnosis_document import Alternative, AxisResidual, Diagnosis, Unexplained
from invid.model.document import EffectTerm, Model
from invid.numerics import budget
from invid.recording.model import Recording
from invid.rigid_motion import search
from invid.rigid_motion.analysis import Analysis, analyse, missed_by
from invid.rigid_motion.effect_terms import effect_of_cause, place_of
from invid.rigid_motion.figures import figures_of
from invid.rigid_motion.fit import Fit, axes_at_noise, falls, missing_torque, noise_powers, settled
from invid.rigid_motion.model import model_of
from invid.rigid_motion.smooth_law import depends_on, law_fits
from invid.rigid_motion.terms import BEND, BY_DIRECTION, GRAVITY, RISE, Term
from invid.wording.sentence import Figure, joined, sentence


def diagnose_trajectory(
    recording: Recording, *, model: Model | None = None, analysis: Analysis | None = None
) -> Diagnosis:
    """Diagnosis of moves, constant velocities, start and stop, velocity without position.

    ``model`` only lends what such a record cannot show (the inertia at constant velocity); ``analysis`` is
    that of this recording, where it is there already.
    """
    if model is not None and model.axes != recording.axes:
        raise InputError(
            f"the model has the axes {list(model.axes)}, the recording {list(recording.axes)}; diagnose with "
            "the model of this robot, or without one"
        )
    a = analyse(recording) if analysis is None else analysis
    extended = model_of(a, model)
    residual = _residuals(a)
    found = search.causes_of(a.final.terms)
    explained = explained_share(residual) if found else None
    near = axis_above_floor(residual) is None
    every, left = a.rows.every, missing_torque(a.rows, a.final)
    missing = not near and not axes_at_noise(every, a.final, left).all()
    causes = sorted(_causes(a, found, explained or 0.0), key=lambda c: c.after - c.before)
    sizes = extended.chains.masses_per_branch
    outcome = Outcome(
        missing=missing,
        complete=True,
        explained=explained,
        left=None if near or not (found or missing) else _describe_residual(a, residual),
        warnings=extended.warnings,
        details=figures_of(a),
    )
    # Each was tested against the model without it on rows kept out: it stands on its own evidence.
    share, axes = explained or 0.0, recording.axes
    findings = [finding_of(c, share, sizes, axes, at_noise=near, own=True) for c in causes]
    result = assemble_diagnosis(recording, residual, findings, extended, outcome)
    return limit_unfinished_search(result) if a.is_cut_short else result


def _residuals(a: Analysis) -> tuple[AxisResidual, ...]:
    unit = a.recording.torque_unit
    columns = (missed_by(a.rows, a.base), missed_by(a.rows, a.final), np.sqrt(noise_powers(a.rows, a.final)))
    return tuple(
        AxisResidual(name, unit, float(before), float(after), float(noise))
        for name, before, after, noise in zip(a.recording.axes, *columns, strict=True)
    )


def _causes(a: Analysis, found: list[search.Cause], explained: float) -> list[Cause]:
    """The causes with what each explains and its rivals."""
    without = [search.without(a.rows, a.final, c) for c in found]
    gains = [max(sum(falls(w, a.final)), 0.0) for w in without]
    after = missed_by(a.rows, a.final)
    # What leaves more is wrong somewhere: of a drag with the square of the speed viscous friction takes six
    # sevenths, and is not what is there.
    most = 1.0 if explained >= NAMED else UNSIZED
    out = []
    for cause, bare, gain in zip(found, without, gains, strict=True):
        axis = cause.terms[0].axis
        rivals = _rivals(a, cause, bare)
        effect, remarks = _plain_effect(a, cause)
        out.append(
            Cause(
                effect,
                float(missed_by(a.rows, bare)[axis]),
                float(after[axis]),
                explained * gain / max(sum(gains), 1e-300),
                min(most, share_among_rivals([gain, *(worse for worse, _ in rivals)])),
                tuple(said for worse, said in rivals if worse < COMPETES),
                remarks=remarks,
            )
        )
    return out


def _rivals(a: Analysis, cause: search.Cause, bare: Fit) -> list[tuple[float, Alternative]]:
    """Other causes in the place of one: by how much −2 ln L is higher, and what they leave."""
    if cause.name == NAMELESS or budget.is_left_out(sentence("rivals of the causes")):
        return []
    axis, laws = cause.terms[0].axis, {t.label for t in (*cause.terms, *a.final.terms)}
    alike = {*BY_CAUSE[cause.name].looks_like}
    alike |= {e.cause for e in CATALOGUE if cause.name in e.looks_like}
    here = {t.law for t in bare.terms if t.axis == axis}
    others = [
        t
        for t in a.candidates
        # A law that contains the cause is a refinement that was not needed, no rival.
        if t.axis == axis
        and t.label not in laws
        and t.cause in alike
        and t.law not in (RISE, BEND, BY_DIRECTION)
        and not (t.law is Part.OFFSET and GRAVITY in here)
    ]
    fits = [(t, search.with_term(a.rows, bare, t)) for t in search.leaders(a.rows, bare, others)]
    out = [(t.cause, place_of(t, a.recording.axes), f) for t, f in fits]
    if isinstance(cause.terms[0].law, LoadFrictionLaw):
        # On one way a load that follows the pose is a law of position, and any other such law is like it.
        place = place_of(cause.terms[0], a.recording.axes)
        out += [(NAMELESS, place, f) for f in law_fits(a.rows, bare, axis, ("position", ""))]
    return [
        (worse, Alternative(name, at, element, float(missed_by(a.rows, f)[axis]), other))
        for name, (at, element, other), f in out
        for worse in (sum(falls(f, a.final)) + NUMBER * (f.numbers - a.final.numbers),)
    ]


def _plain_effect(a: Analysis, cause: search.Cause) -> tuple[EffectTerm, tuple[str, ...]]:
    """The effect in the cause's own parameters, and sentences about what the model has beyond them.

    Friction by direction has four parameters. Where it also bends at low speed, the four are those of the
    best law without the bend (with it they would mean something else), and the bend stands in the model.
    """

    def effect_in(final: Fit, of: search.Cause) -> EffectTerm:
        return effect_of_cause(a.rows, final, of, a.recording.axes, linear=a.recording.linear)

    effect = effect_in(a.final, cause)
    if isinstance(cause.terms[0].law, LoadFrictionLaw):
        counted = "weight and inertia" if effect.value("inertia_counts") else "weight"
        return effect, (sentence("The load is the joint's {counted}.", counted=counted),)
    bend = {n: p for n, p in effect.parameters.items() if n.startswith("low_speed")}
    if not bend:
        return effect, ()
    bare = search.without(a.rows, a.final, cause)
    own = [t for t in cause.terms if isinstance(t.law, Part)]
    plain = search.Cause(cause.name, (Term(BY_DIRECTION, own[0].axis), *own))
    whole = settled(a.rows, [*bare.terms, *plain.terms])
    up, down, speed = (p.value for p in bend.values())
    unit, force = bend["low_speed_velocity"].unit, effect.parameters["coulomb_positive"].unit
    said = sentence(
        "Below about {speed:.3g} {unit} it changes by {up:.3g} (forward) and {down:.3g} "
        "{force} (backward): see the model.",
        speed=speed,
        unit=unit,
        up=up,
        down=down,
        force=force,
    )
    return effect_in(whole, plain), (said,)


def _describe_residual(a: Analysis, residual: tuple[AxisResidual, ...]) -> Unexplained:
    """Size, frequencies and character of the unexplained torque on the axis farthest above its floor."""
    worst = max(range(len(residual)), key=lambda i: floors_left(residual[i]))
    motions, left = a.rows.motions, a.final.held_out[a.rows.axis == worst]
    drivers = {
        "position": [m.position for m in motions],
        "velocity": [m.velocity for m in motions],
        "time": [np.cumsum(np.ones_like(m.position), axis=0) + 1e9 * k for k, m in enumerate(motions)],
    }
    character = tuple(dependent_on(q) for q, d in drivers.items() if depends_on(a.rows, a.final, worst, d))
    frequencies: tuple[float, ...] = ()
    if not a.reach.steady and left.size >= 64:
        power = np.abs(np.fft.rfft(left - left.mean())) ** 2
        line = np.fft.rfftfreq(left.size, a.rows.step)
        frequencies = tuple(round(f, 3) for f in sorted(float(f) for f in line[np.argsort(power)[-3:]]))
    r = residual[worst]
    lines = joined([Figure(f"{f:g}") for f in frequencies])
    return Unexplained(
        axis=r.axis,
        frequencies_hz=frequencies,
        character=character,
        sentence=sentence(
            "{axis}: {after:.3g} {unit} rms is left over a noise floor of {floor:.3g} {unit}{where}{how}; no "
            "cause explains it that is searched for in moves of rigid axes (not searched for: {others})",
            axis=r.axis,
            after=r.after,
            unit=r.unit,
            floor=r.floor,
            where=sentence(" around {frequencies} Hz", frequencies=lines) if frequencies else "",
            how=joined(["", *character]) if character else "",
            others=joined(_not_searched(a)),
        ),
    )


def _not_searched(a: Analysis) -> list[str]:
    """Causes of the catalogue that such a record was not asked for."""
    asked = {t.cause for t in (*a.candidates, *a.final.terms)} | {"torque_delay"}
    inner = ("extra_mode", "coupling_stiffness", "base_compliance")
    others = [
        cause_name(e.cause)
        for e in CATALOGUE
        if e.cause not in (*asked, *inner, "dropped_samples") and e.home != "spring"
    ]
    return [*others, sentence("what is elastic")]
