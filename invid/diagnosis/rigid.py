"""The diagnosis of a large motion: regression over time instead of spectra, judged as every other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from invid.diagnosis.outcome import (
    Cause,
    assemble_diagnosis,
    axis_above_floor,
    explained_share,
    finding_of,
    floors_left,
    is_rival,
    likelihood_share,
    limit_unfinished_search,
)
from invid.diagnosis.thresholds import FLOOR, NAMED, NEAR, UNSIZED
from invid.effects.registry import CATALOGUE
from invid.errors import InputError
from invid.model.diagnosis_document import Alternative, AxisResidual, Diagnosis, Unexplained
from invid.model.document import EffectTerm, Model
from invid.numerics import budget
from invid.recording.model import Recording
from invid.rigid_motion.analysis import Analysis, analyse, depends_on, row_floor, sampling_error
from invid.rigid_motion.effect_terms import place_of, term_of
from invid.rigid_motion.figures import figures_of
from invid.rigid_motion.model import model_of
from invid.rigid_motion.regression import Fit, fit_terms
from invid.rigid_motion.regressors import ASYMMETRIC, Regressor
from invid.rigid_motion.selection import (
    best_of_label,
    can_join,
    held_out_cost,
    held_out_p,
    hold_at_bounds,
    judged_rows,
    root_mean_square,
    training_p,
)


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
    terms = [t for t in a.final.terms if not t.base]
    explained = explained_share(residual) if terms else None
    near = axis_above_floor(residual) is None
    missing = any(
        r.after > max(FLOOR * r.floor, allowed)
        for r, allowed in zip(residual, sampling_error(a), strict=True)
    )
    causes = sorted(_causes(a, terms, explained or 0.0), key=lambda c: c.after - c.before)
    sizes = extended.chains.masses_per_branch
    result = assemble_diagnosis(
        recording,
        residual,
        # Each was tested against the model without it on rows kept out: it stands on its own evidence.
        [finding_of(c, explained or 0.0, sizes, recording.axes, at_noise=near, own=True) for c in causes],
        extended,
        missing=missing,
        complete=True,
        explained=explained,
        left=None if near or not (terms or missing) else _describe_residual(a, residual),
        warnings=extended.warnings,
        details=figures_of(a, extended),
    )
    return limit_unfinished_search(result) if a.selection.is_cut_short else result


def _residuals(a: Analysis) -> tuple[AxisResidual, ...]:
    rows, unit, floor = judged_rows(a.design), a.recording.torque_unit, row_floor(a)
    result = []
    for i, name in enumerate(a.recording.axes):
        axis_rows = rows & (a.design.axis == i)
        before, after = (
            root_mean_square(a.base.held_out[axis_rows]),
            root_mean_square(a.final.held_out[axis_rows]),
        )
        result.append(AxisResidual(name, unit, before, after, float(np.sqrt(np.mean(floor[axis_rows])))))
    return tuple(result)


class _Costs:
    """χ² of fits over independent rows, with the residual variance of the final fit as unit."""

    def __init__(self, a: Analysis) -> None:
        self.design, self.final = a.design, a.final
        own = a.design.has_validation
        train = a.design.train
        length = train.sum() / max(a.final.effective, 1.0)
        self.held = float(judged_rows(a.design).sum() / length)
        # In cross-validation every row is predicted by a fit without it and counts once.
        self.trained = a.final.effective if own else 0.0
        rows = judged_rows(a.design)
        noise = float(np.mean((row_floor(a) * a.design.weight**2)[rows]))
        share = 1.0 - noise / max(held_out_cost(a.design, a.final), 1e-300)
        count = self.held + self.trained
        self.left = max(count * share - 3.0 * float(np.sqrt(2.0 * count)), 0.0)
        """χ² that even the final fit leaves beyond noise, three standard deviations subtracted."""

    def of(self, result: Fit) -> float:
        """χ² of a fit."""
        held = held_out_cost(self.design, result) / max(held_out_cost(self.design, self.final), 1e-300)
        return self.held * held + self.trained * result.cost / max(self.final.cost, 1e-300)

    def score(self, result: Fit) -> float:
        """−2 ln(likelihood) and Schwarz' penalty of all coefficients and shapes."""
        count = self.held + self.trained
        numbers = result.value.size + sum(t.shape is not None for t in result.terms)
        return self.of(result) + float(np.log(max(count, 2.0))) * numbers


def _causes(a: Analysis, terms: list[Regressor], explained: float) -> list[Cause]:
    """The terms as causes, with what each explains and its competitors."""
    costs, design = _Costs(a), a.design
    others = [[t for t in a.final.terms if t is not term] for term in terms]
    without = [fit_terms(design, rest) for rest in others]
    gains = [max(costs.of(w) - costs.of(a.final), 0.0) for w in without]
    # What leaves more is wrong somewhere: of a drag with the square of the speed viscous friction takes six
    # sevenths, and is not what is there.
    most = 1.0 if explained >= NAMED else UNSIZED
    found = []
    for term, rest, bare, gain in zip(terms, others, without, gains, strict=True):
        axis_rows = judged_rows(design) & (design.axis == term.axis)
        near = _near_fits(a, term, rest, costs, costs.of(a.final) + NEAR * gain)
        scores = np.array([costs.score(f) for f in (a.final, *near)])
        chance = max(training_p(bare, a.final), held_out_p(design, bare, a.final))
        alternatives = tuple(
            _alternative(f.terms[-1], a, root_mean_square(f.held_out[axis_rows]))
            for f, score in zip(near, scores[1:], strict=True)
            if is_rival(score - scores[0], costs.of(f) - costs.of(a.final), costs.left)
        )
        effect, remarks = _plain_effect(a, term, rest)
        found.append(
            Cause(
                effect,
                root_mean_square(bare.held_out[axis_rows]),
                root_mean_square(a.final.held_out[axis_rows]),
                explained * gain / max(sum(gains), 1e-300),
                min(most, 1.0 - chance) * likelihood_share(scores, [True, *(False for _ in near)]),
                alternatives,
                remarks=remarks,
            )
        )
    return found


def _alternative(term: Regressor, a: Analysis, after: float) -> Alternative:
    axis, element, other = place_of(term, a.recording.axes)
    return Alternative(term.cause, axis, element, after, other)


def _near_fits(a: Analysis, term: Regressor, rest: list[Regressor], costs: _Costs, most: float) -> list[Fit]:
    """Fits with another cause in place of ``term`` that cost less than ``most``."""
    labels: dict[Any, list[Regressor]] = {}
    for c in a.candidates:
        # A law that contains the term is a refinement that was not needed, not a rival.
        nested = term.cause in c.replaces or c.cause in term.replaces or c.cause == term.cause
        if c.axis == term.axis and not (c.base or nested) and c.label != term.label and can_join(rest, c):
            labels.setdefault(c.label, []).append(c)
    found = []
    for options in labels.values():
        if budget.is_left_out("rivals of the causes found"):
            break
        trial = best_of_label(a.design, rest, options)
        if trial is not None and costs.of(trial) < most:
            found.append(trial)
    return found


def _plain_effect(a: Analysis, term: Regressor, rest: list[Regressor]) -> tuple[EffectTerm, tuple[str, ...]]:
    """The effect in the cause's own parameters, and sentences about what the model has beyond them.

    Friction that differs by direction has four parameters. Where it also bends at low speed, the four are
    those of the best law without the bend (with the bend they would mean something else), and the bend stands
    in the model's effect. The symmetric law beside it lets a reader compare with tables.
    """
    effect = term_of(a, term)
    if term.cause == "load_dependent_friction":
        counted = "weight and inertia" if effect.value("inertia_counts") else "weight"
        return effect, (f"The load is the joint's {counted}.",)
    if term.cause != "asymmetric_friction":
        return effect, ()
    remarks: list[str] = []
    if len(term.names) > len(ASYMMETRIC):
        bend = {n: effect.parameters[n] for n in effect.parameters if n.startswith("low_speed")}
        own = Regressor("asymmetric_friction", term.axis, ASYMMETRIC, ASYMMETRIC)
        own = hold_at_bounds(a.design, [*rest, own], own) or own
        beyond = effect
        effect = term_of(replace(a, final=fit_terms(a.design, [*rest, own])), own)
        up, down, speed = (p.value for p in bend.values())
        unit, force = bend["low_speed_velocity"].unit, beyond.parameters["coulomb_positive"].unit
        remarks.append(
            f"Below about {speed:.3g} {unit} it changes by {up:.3g} (forward) and {down:.3g} {force} "
            "(backward): see the model."
        )
    same = [
        Regressor("coulomb_friction", term.axis, ("torque",)),
        Regressor("viscous_friction", term.axis, ("coefficient",)),
        Regressor("torque_offset", term.axis, ("torque",)),
    ]
    if any(t.cause == "gravity" and t.axis == term.axis for t in rest):
        return effect, tuple(remarks)
    # As tables in the literature are made: without the sampling instant of the torque.
    symmetric = fit_terms(a.design, [*(t for t in rest if t.cause != "time_offset"), *same])
    units = [p.unit for p in effect.parameters.values()]
    sizes = [
        f"{name} {value[0]:.4g} ± {std[0]:.2g} {unit}"
        for name, unit, (value, std) in zip(
            ("Coulomb", "viscous", "offset"),
            (units[0], units[2], units[0]),
            (symmetric.of(t) for t in same),
            strict=True,
        )
    ]
    remarks.append(f"As one law for both directions: {', '.join(sizes)}.")
    return effect, tuple(remarks)


def _describe_residual(a: Analysis, residual: tuple[AxisResidual, ...]) -> Unexplained:
    """Size, frequencies and character of the unexplained torque on the axis farthest above its floor."""
    worst = max(range(len(residual)), key=lambda i: floors_left(residual[i]))
    axis_rows = a.design.axis == worst
    residual_rows = a.final.held_out[axis_rows]
    motion = max(a.motions, key=lambda m: int(m.keep.sum()))
    character = []
    position = a.design.on_axis([m.rows(m.position) for m in a.motions], worst)
    velocity = a.design.on_axis([m.rows(m.velocity) for m in a.motions], worst)
    time = np.arange(residual_rows.size, dtype=float)
    for name, driver in (("position", position), ("velocity", velocity), ("time", time)):
        if depends_on(residual_rows, driver, a.final.effective / a.design.axes):
            character.append(f"{name}-dependent")
    frequencies: tuple[float, ...] = ()
    if not motion.steady and residual_rows.size >= 64:
        power = np.abs(np.fft.rfft(residual_rows - residual_rows.mean())) ** 2
        line = np.fft.rfftfreq(residual_rows.size, motion.row_step)
        top = sorted(float(f) for f in line[np.argsort(power)[-3:]])
        frequencies = tuple(round(f, 3) for f in top)
    r = residual[worst]
    how = (", " + ", ".join(character)) if character else ""
    where = f" around {', '.join(f'{f:g}' for f in frequencies)} Hz" if frequencies else ""
    return Unexplained(
        axis=r.axis,
        frequencies_hz=frequencies,
        character=tuple(character),
        sentence=f"{r.axis}: {r.after:.3g} {r.unit} rms is left over a noise floor of {r.floor:.3g} "
        f"{r.unit}{where}{how}; no cause explains it that is searched for in moves of rigid axes "
        f"(not searched for: {', '.join(_not_searched(a))})",
    )


def _not_searched(a: Analysis) -> list[str]:
    """Causes of the catalogue that such a record was not asked for."""
    asked = {t.cause for t in (*a.candidates, *a.final.terms)} | {"torque_delay"}
    inner = ("extra_mode", "coupling_stiffness", "base_compliance")
    others = [
        e.cause.replace("_", " ")
        for e in CATALOGUE
        if e.cause not in (*asked, *inner, "dropped_samples") and e.home != "spring"
    ]
    return [*others, "what is elastic"]
