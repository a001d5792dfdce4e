"""The diagnosis of a large motion: what the rigid model misses, the cause, the gain on rows kept out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from invid.effects.registry import effect_of
from invid.errors import InputError, ModelError, NotIdentifiableError
from invid.model.chains import CoupledChains
from invid.model.diagnosis_document import Alternative, AxisResidual, Diagnosis, Finding, Unexplained, Verdict
from invid.model.document import ChainStd, EffectTerm, Model
from invid.numerics import budget
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.model import Recording
from invid.rigid_motion.analysis import Analysis, analyse, counts_at_most, row_floor
from invid.rigid_motion.effect_terms import separating, term_of
from invid.rigid_motion.load_friction import load_terms
from invid.rigid_motion.regression import Fit, fit
from invid.rigid_motion.regressors import ASYMMETRIC, Term
from invid.rigid_motion.selection import (
    INDISTINCT,
    best_of_label,
    held_out_p,
    judged,
    may_join,
    needed,
    rms,
    training_p,
)
from invid.rigid_motion.words import sentence_of
from invid.signals.motion_record import Motion
from invid.simulation.rigid import errors_of

AT_FLOOR = 1.3
"""Held-out residual over noise floor that counts as at the floor: the floor's own error (noise not quite
white) is some 20 %; empirical, on simulated axes with white noise the ratio stays below 1.15."""
CONTESTED = 0.89
"""Most that is claimed where a cause may be another's disguise."""
DISGUISE = 0.02
"""Part of what a cause took away that may be left as a function of the same driver. A guess: a law right to
a tenth leaves a hundredth of its power; viscous friction fitted to friction that grows with the square of
speed leaves 6 % on evenly spread speeds."""
RESOLUTION = 0.005
"""Part of the torque below which nothing is said to be missing: resampling, differentiation and a torque held
over the sample leave up to 0.2 % on simulated axes without any fault (empirical)."""


def identify_trajectory(recording: Recording, *, analysis: Analysis | None = None) -> Model:
    """Rigid (or grounded) model with the effects the data ask for, fitted together.

    ``analysis``: that of this recording, where it is there already.
    """
    return _model(analyse(recording) if analysis is None else analysis, None)


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
    extended = _model(a, model)
    rows = judged(a.design)
    floor = row_floor(a)
    residual = _residuals(a, floor)
    findings = tuple(_finding(a, t) for t in a.final.terms if not t.base)
    findings = tuple(sorted(findings, key=lambda f: f.after - f.before))
    power = [float(np.sum(r[rows] ** 2)) for r in (a.base.held_out, a.final.held_out)]
    noise = float(np.sum(floor[rows]))
    explained = 1 - (power[1] - noise) / (power[0] - noise) if power[0] > 1.05 * noise else None
    sizes = [rms(a.design.torque[rows & (a.design.axis == i)]) for i in range(a.design.axes)]
    at_floor = all(
        r.after <= max(AT_FLOOR * r.noise_floor, RESOLUTION * size, float(np.hypot(r.noise_floor, steps)))
        for r, size, steps in zip(residual, sizes, counts_at_most(a), strict=True)
    )
    if not findings:
        # Without a cause the rigid model is either enough or wrong in a way that has no name here.
        verdict = Verdict.CONSISTENT if at_floor else Verdict.UNEXPLAINED
    else:
        verdict = Verdict.EXPLAINED if at_floor else Verdict.PARTLY_EXPLAINED
    left = None if at_floor else _unexplained(a, residual)
    return Diagnosis(
        verdict=verdict,
        residual=residual,
        explained_fraction=None if explained is None else float(np.clip(explained, 0.0, 1.0)),
        findings=findings,
        unexplained=left,
        model=extended,
        warnings=extended.warnings,
        sentences=tuple(f.sentence for f in findings) + (() if left is None else (left.sentence,)),
        details={
            **_details(a),
            "simulation": _simulated(a, extended),
            **({"cut_short": True} if a.selection.cut else {}),
        },
    )


def _simulated(a: Analysis, extended: Model) -> list[dict[str, Any]]:
    """The model run through time beside the record, and the best linear model in its place."""
    if budget.is_left_out("the model simulated over time"):
        return []
    found = errors_of(extended, a.recording)
    if not found:
        return []
    count = a.recording.axis_count
    linear = [t for t in a.final.terms if t.base or t.cause == "torque_delay"]
    linear += [Term("viscous_friction", i, ("coefficient",)) for i in range(count)]
    linear += [Term("torque_offset", i, ("torque",)) for i in range(count)]
    plain = _model(replace(a, final=fit(a.design, linear)), None)
    for entry, before in zip(found, errors_of(plain, a.recording), strict=True):
        entry["linear_model"] = {k: before[k] for k in ("position", "torque", "failed") if k in before}
    return found


def _residuals(a: Analysis, floor: Float64) -> tuple[AxisResidual, ...]:
    rows, unit = judged(a.design), a.recording.torque_unit
    result = []
    for i, name in enumerate(a.recording.axes):
        mine = rows & (a.design.axis == i)
        before, after = rms(a.base.held_out[mine]), rms(a.final.held_out[mine])
        result.append(AxisResidual(name, unit, before, after, float(np.sqrt(np.mean(floor[mine])))))
    return tuple(result)


def _finding(a: Analysis, term: Term) -> Finding:
    design, final = a.design, a.final
    rest = [t for t in final.terms if t is not term]
    mine = judged(design) & (design.axis == term.axis)
    without = fit(design, rest)
    p = max(training_p(without, final), held_out_p(design, without, final))
    before, after = rms(without.held_out[mine]), rms(final.held_out[mine])
    rivals = _rivals(a, term, rest, mine)
    effect, remark = _plain(a, term, rest)
    share = 1.0 / (1 + sum(float(np.exp(-0.5 * max(excess, 0.0))) for _, excess in rivals))
    causes = {term.cause, *(r.cause for r, _ in rivals)}
    name = a.recording.axes[term.axis]
    doubt = _doubt(a, term, before, after, mine)
    return Finding(
        effect=effect,
        confidence=min(CONTESTED if doubt else 0.999, (1 - p) * share),
        before=before,
        after=after,
        fraction=float(np.clip(1 - after**2 / before**2, 0.0, 1.0)) if before > 0 else 0.0,
        alternatives=tuple(r for r, _ in rivals),
        separating_experiment=separating(name, causes, float(a.reach.speed[term.axis]), a.recording.linear)
        if rivals
        else None,
        sentence=sentence_of(effect, before, after, a.recording.torque_unit, tuple(r for r, _ in rivals))
        + remark
        + doubt,
    )


def _doubt(a: Analysis, term: Term, before: float, after: float, mine: np.typing.NDArray[np.bool_]) -> str:
    """Why a cause that helps may be another's disguise; empty where nothing says so."""
    removed = before**2 - after**2
    left = after**2 - float(np.mean(row_floor(a)[mine]))
    if left > removed:
        return "; likely, not certain: more is left than this takes away"
    driver_name = _driver_name(term)
    if driver_name is None:
        return ""
    if term.cause == "viscous_friction":
        grown = fit(a.design, [*a.final.terms, Term("square_of_speed", term.axis, ("coefficient",))])
        if needed(a.design, a.final, grown):
            return "; likely, not certain: what is left grows with the square of the speed"
    driver = np.concatenate([_driver(m, driver_name, term.axis) for m in a.motions])
    own = a.final.held_out[a.design.axis == term.axis]
    if _function_of(own, driver, own.size / max(a.final.effective / a.design.axes, 1.0)) > DISGUISE * removed:
        return f"; likely, not certain: what is left depends on {driver_name} as well, so its law is another"
    return ""


def _driver_name(term: Term) -> str | None:
    """What a cause's torque is a function of: velocity or position; ``None`` where it is of neither."""
    effect = effect_of(term.cause)
    if effect is None or effect.family == "constant":
        return None
    return {"velocity": "velocity", "position": "position", "deflection": "position"}.get(effect.over)


def _driver(motion: Motion, name: str, axis: int) -> Float64:
    fine = motion.velocity if name == "velocity" else motion.position
    rows: Float64 = motion.rows(fine)[:, axis]
    return rows


def _function_of(residual: Float64, driver: Float64, length: float) -> float:
    """Mean square of what of ``residual`` is a function of ``driver``, beyond what chance makes of it."""
    edges = np.quantile(driver, np.linspace(0, 1, 21)[1:-1])
    bins = np.searchsorted(edges, driver)
    sums, counts = np.bincount(bins, residual, 20), np.maximum(np.bincount(bins, minlength=20), 1)
    chance = 20.0 * length * float(np.mean(residual**2)) / residual.size
    return float(np.sum(sums**2 / counts)) / residual.size - chance


def _plain(a: Analysis, term: Term, rest: list[Term]) -> tuple[EffectTerm, str]:
    """The effect in the cause's own parameters, and what the model has beyond them, in words.

    Friction that differs by direction has four parameters; where it also bends at low speed, the four are
    those of the best law without the bend (with the bend they would mean something else), and the bend stands
    in the model's effect. The symmetric law beside it lets a reader compare with tables.
    """
    effect = term_of(a, term)
    if term.cause != "asymmetric_friction":
        return effect, ""
    remark = ""
    if len(term.names) > len(ASYMMETRIC):
        bend = {n: effect.parameters[n] for n in effect.parameters if n.startswith("low_speed")}
        own = Term("asymmetric_friction", term.axis, ASYMMETRIC)
        beyond = effect
        effect = term_of(replace(a, final=fit(a.design, [*rest, own])), own)
        up, down, speed = (p.value for p in bend.values())
        word = (
            "; below about {:.3g} {} it changes by {:.3g} (forward) and {:.3g} {} (backward): see the model"
        )
        unit = bend["low_speed_velocity"].unit
        remark += word.format(speed, unit, up, down, beyond.parameters["coulomb_positive"].unit)
    same = [
        Term("coulomb_friction", term.axis, ("torque",)),
        Term("viscous_friction", term.axis, ("coefficient",)),
        Term("torque_offset", term.axis, ("torque",)),
    ]
    if any(t.cause == "gravity" and t.axis == term.axis for t in rest):
        return effect, remark
    # As tables in the literature are made: without the sampling instant of the torque.
    symmetric = fit(a.design, [*(t for t in rest if t.cause != "time_offset"), *same])
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
    remark += "; as one law for both directions: " + ", ".join(sizes)
    return effect, remark


def _rivals(
    a: Analysis, term: Term, rest: list[Term], mine: np.typing.NDArray[np.bool_]
) -> list[tuple[Alternative, float]]:
    """Other causes in this one's stead that unseen rows cannot tell from it, with their excess cost."""
    design, final = a.design, a.final
    labels: dict[Any, list[Term]] = {}
    for c in a.candidates:
        if c.axis == term.axis and not c.base and c.label != term.label and may_join(rest, c):
            labels.setdefault(c.label, []).append(c)
    found = []
    for options in labels.values():
        if budget.is_left_out("rivals of the causes found"):
            break
        # What contains the term is a refinement that was tried and not needed, not a rival.
        if term.cause in options[0].replaces or options[0].cause in term.replaces:
            continue
        trial = best_of_label(design, rest, options)
        if trial is None or held_out_p(design, trial, final) <= INDISTINCT:
            continue
        # A rival that explains as little as nothing at all is none.
        nothing = fit(design, rest)
        if held_out_p(design, nothing, trial) > INDISTINCT:
            continue
        excess = final.effective * float(np.log(max(trial.cost, 1e-300) / max(final.cost, 1e-300)))
        rival = trial.terms[-1]
        name = a.recording.axes[term.axis]
        after = rms(trial.held_out[mine])
        found.append((Alternative(rival.cause, name, "mass 1", after), excess))
    return found


def _unexplained(a: Analysis, residual: tuple[AxisResidual, ...]) -> Unexplained:
    worst = max(range(len(residual)), key=lambda i: residual[i].after / max(residual[i].noise_floor, 1e-300))
    mine = a.design.axis == worst
    left = a.final.held_out[mine]
    motion = max(a.motions, key=lambda m: int(m.keep.sum()))
    character = []
    position = np.concatenate([m.rows(m.position)[:, worst] for m in a.motions])
    velocity = np.concatenate([m.rows(m.velocity)[:, worst] for m in a.motions])
    time = np.arange(left.size, dtype=float)
    for name, driver in (("position", position), ("velocity", velocity), ("time", time)):
        if _depends(left, driver, a.final.effective / a.design.axes):
            character.append(f"{name}-dependent")
    frequencies: tuple[float, ...] = ()
    if not motion.steady and left.size >= 64:
        power = np.abs(np.fft.rfft(left - left.mean())) ** 2
        line = np.fft.rfftfreq(left.size, motion.row_step)
        top = sorted(float(f) for f in line[np.argsort(power)[-3:]])
        frequencies = tuple(round(f, 3) for f in top)
    r = residual[worst]
    how = (", " + ", ".join(character)) if character else ""
    where = f" around {', '.join(f'{f:g}' for f in frequencies)} Hz" if frequencies else ""
    return Unexplained(
        axis=r.axis,
        frequencies_hz=frequencies,
        character=tuple(character),
        sentence=f"{r.axis}: {r.after:.3g} {r.unit} rms is left over a noise floor of {r.noise_floor:.3g} "
        f"{r.unit}{where}{how}; no cause of the catalogue explains it",
    )


def _depends(residual: Float64, driver: Float64, effective: float) -> bool:
    """More than a tenth of the residual's power, and significant, in its mean over ten bins of ``driver``."""
    edges = np.quantile(driver, np.linspace(0, 1, 11)[1:-1])
    bins = np.searchsorted(edges, driver)
    sums = np.bincount(bins, residual, 10)
    counts = np.maximum(np.bincount(bins, minlength=10), 1)
    share = float(np.sum(sums**2 / counts) / max(np.sum(residual**2), 1e-300))
    return share > max(0.1, 20.0 / max(effective, 1.0))


def _model(a: Analysis, given: Model | None) -> Model:
    recording, final = a.recording, a.final
    count = recording.axis_count
    mass, mass_std = np.ones(count), np.full(count, np.nan)
    coupling, coupling_std = np.zeros((count, count)), np.full((count, count), np.nan)
    spring, spring_std = np.zeros(count), np.full(count, np.nan)
    warnings = list(_warnings(a))
    if a.reach.steady:
        if given is not None and given.chains.branches == count:
            mass = np.array([m.sum() for m in given.chains.masses])
        warnings.append(
            "constant velocity shows no inertia: the masses in this model are placeholders; record moves "
            "that accelerate to identify them"
        )
    facts: dict[str, Any] = {}
    for term in final.terms:
        value, std = final.of(term)
        if term.cause == "inertia":
            mass[term.axis], mass_std[term.axis] = value[0], std[0]
        elif term.cause == "coupling" and term.other is not None:
            for i, j in ((term.axis, term.other), (term.other, term.axis)):
                coupling[i, j], coupling_std[i, j] = value[0], std[0]
        elif term.cause == "time_offset":
            offsets = facts.setdefault("time_offset_s", {})
            offsets[f"{recording.axes[term.axis]}.time_offset"] = {
                "value": float(value[0]),
                "std": float(std[0]),
            }
        elif term.cause == "ground_spring":
            spring[term.axis], spring_std[term.axis] = value[0], std[0]
        elif term.cause == "configuration":
            facts["inertia_with_angle"] = {
                "axes": [recording.axes[term.axis], recording.axes[term.other or 0]],
                "cosine": {"value": float(value[0]), "std": float(std[0])},
                "sine": {"value": float(value[1]), "std": float(std[1])},
                "meaning": "M11 += 2 b cos q2, M12 += b cos q2, with the Coriolis terms that belong to it",
            }
    for i in range(count):
        if mass[i] <= 0:
            raise NotIdentifiableError(
                f"{recording.source}: the inertia of {recording.axes[i]} comes out as {mass[i]:.3g}: nothing "
                f"in its band accelerates enough; record faster moves"
            )
    try:
        chains = CoupledChains.build(
            [[m] for m in mass],
            [[] for _ in mass],
            None,
            coupling,
            ground_springs=spring,
            axes=recording.axes,
        )
    except ModelError as error:
        warnings.append(f"inertia couplings left out: {error}")
        chains = CoupledChains.build([[m] for m in mass], [[] for _ in mass], axes=recording.axes)
    unknown = ChainStd.unknown(chains)
    std_of = ChainStd(
        masses=tuple(frozen_float([s]) for s in mass_std),
        springs=unknown.springs,
        dampers=unknown.dampers,
        couplings=frozen_float(coupling_std),
        ground_springs=frozen_float(spring_std),
    )
    return Model(
        robot=recording.robot,
        method="trajectory",
        chains=chains,
        std=std_of,
        linear=recording.linear,
        effects=tuple(term_of(a, t) for t in final.terms if not t.base),
        warnings=tuple(warnings),
        fit={**facts, "rows": int(a.design.torque.size), "independent_rows": round(final.effective, 1)},
        provenance={"recording": recording.source, "model_of": "rigid body with gravity and friction"},
    )


def _warnings(a: Analysis) -> list[str]:
    found = []
    if not a.design.has_validation:
        found.append(
            "the recording names no validation data: whole pieces (or constant-speed records) were kept out "
            "in turn"
        )
    if any(e.attributes.get("position_source") == "integrated_velocity" for e in a.recording.experiments):
        found.append(
            "position is the integral of a measured velocity: causes that depend on position were weak"
        )
    if not a.reach.steady:
        cutoffs = ", ".join(f"{f:.3g}" for f in a.band.rows_hz)
        found.append(
            f"residuals are judged below {cutoffs} Hz; the noise floor is read from the upper quarter of the "
            f"spectra and taken as white"
        )
    return found


def _details(a: Analysis) -> dict[str, Any]:
    design, rows = a.design, judged(a.design)
    train = ~design.validate if design.has_validation else rows
    relative = {}
    for i, name in enumerate(a.recording.axes):
        mine = design.axis == i
        relative[name] = {
            "fit": _percent(a.final.residual, design.torque, train & mine),
            "held_out": _percent(a.final.held_out, design.torque, rows & mine),
            "fit_rms": rms(a.final.residual[train & mine]),
        }
    return {
        "relative_torque_error_percent": relative,
        "relative_torque_error_percent_all_axes": {
            "fit": _percent(a.final.residual, design.torque, train),
            "held_out": _percent(a.final.held_out, design.torque, rows),
        },
        "band_hz": [float(f) for f in a.band.rows_hz],
        "independent_rows": a.final.effective,
        "ladder": _ladder(a),
        "not_shown": _not_shown(a),
    }


def _percent(residual: Float64, torque: Float64, rows: np.typing.NDArray[np.bool_]) -> float:
    size = rms(torque[rows])
    return 100 * rms(residual[rows]) / size if size > 0 else 0.0


def _ladder(a: Analysis) -> list[dict[str, Any]]:
    """Friction models of rising size on every axis at once, whatever was selected: to compare with tables."""
    design, rows = a.design, judged(a.design)
    train = ~design.validate if design.has_validation else rows
    friction = {
        "viscous_friction",
        "coulomb_friction",
        "stribeck_friction",
        "asymmetric_friction",
        "torque_offset",
    }
    # As tables in the literature: without the sampling instant of the torque.
    others = [t for t in a.final.terms if t.cause not in friction and t.cause != "time_offset"]
    falls = {t.axis for t in others if t.cause == "gravity"}
    count = a.recording.axis_count
    viscous = [Term("viscous_friction", i, ("coefficient",)) for i in range(count)]
    coulomb = [Term("coulomb_friction", i, ("torque",)) for i in range(count)]
    offset = [Term("torque_offset", i, ("torque",)) for i in range(count) if i not in falls]
    rungs: list[tuple[str, list[Term]]] = [
        ("no friction", []),
        ("viscous", viscous + offset),
        ("coulomb + viscous", coulomb + viscous),
        ("coulomb + viscous + offset", coulomb + viscous + offset),
        ("selected", [t for t in a.final.terms if t.cause in friction]),
    ]
    table = []
    for name, terms in rungs:
        result: Fit = fit(design, others + terms)
        parameters = {}
        for term in result.terms:
            value, std = result.of(term)
            label = f"{a.recording.axes[term.axis]}.{term.cause}"
            parameters[label] = {
                n: {"value": float(v), "std": float(s)}
                for n, v, s in zip(term.names, value, std, strict=True)
            }
        table.append(
            {
                "friction": name,
                "relative_error_percent": _percent(result.residual, design.torque, train),
                "held_out_percent": _percent(result.held_out, design.torque, rows),
                "fit_rms": rms(result.residual[train]),
                "held_out_rms": rms(result.held_out[rows]),
                "parameters": parameters,
            }
        )
    return table


def _not_shown(a: Analysis) -> list[str]:
    missing = []
    for i, name in enumerate(a.recording.axes):
        if not a.reach.both_ways[i]:
            missing.append(f"{name}: asymmetric friction (the axis moves one way only)")
        if not a.recording.linear and a.reach.travel[i] <= 0.2:
            missing.append(f"{name}: gravity (the axis turns by less than 0.2 rad)")
        own = [t for t in load_terms(a.final, a.design) if t.axis == i and not t.exponent]
        if any(t.cause == "gravity" and i in (t.axis, t.other) for t in a.final.terms) and not own:
            missing.append(
                f"{name}: friction that depends on the load (its weight hardly varies over this motion, "
                "and such friction is then Coulomb friction)"
            )
        if i not in a.springs:
            missing.append(f"{name}: stiffness of the transmission (no resonance in the band)")
    return missing
