"""What ``invid tune`` finds: the values of every axis, and the margins they leave."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from invid.clauses import cause_name
from invid.errors import NotIdentifiableError
from invid.exchange.linear_plant import LeftOut, LinearPlant, linear_plant
from invid.model.diagnosis_document import Diagnosis
from invid.model.document import EffectTerm, Estimate, Model
from invid.numerics.arrays import Float64
from invid.tuning.axis_loop import AxisLoop
from invid.tuning.closed_loop import ClosedLoop, closed_loop, load_mode
from invid.tuning.feedforward import NONE, Feedforward, feedforward
from invid.tuning.gains import PROMISE, design_gains, gains_at, own_inertias, slower
from invid.tuning.margins import Margins, drawn_plants, seen_modes, worst_margins
from invid.tuning.plant_draws import candidates, drawn_models
from invid.tuning.servo_loop import DriveTiming, Gains
from invid.tuning.shapers import Shaper, choose_shaper
from invid.tuning.simulated_loops import (
    Command,
    LoopRun,
    MoveFigures,
    move_figures,
    reference_move,
    run_loops,
)
from invid.wording.sentence import Figure, joined, sentence

DESIGN_DRAWS = 40
KEPT = 0.98
"""Least share of draws whose peak of sensitivity is within ``PROMISE``; else the axis is slowed down."""
_SLOWER, _ROUNDS = 0.8, 12
_SHAPER_DRAWS = 60
SOFTENED = 1e-3
"""What is left of a spring's stiffness where it has free play and the loops are designed for that, too:
within the play the motor has no load."""
SATURATED = 0.5
"""Share of a torque limit that the reference move may ask of the inertia."""
UNTUNED = 0.25
"""Crossover of the loops of a drive that nobody has tuned, as a share of the first antiresonance: slow
enough to shake nothing. Stands in for its values as delivered, which are not known here."""
RIPPLE = 0.01
"""Torque that an encoder's counts may make, rms, as a share of rated torque (a convention; drives are heard
from a few per cent)."""
_RIPPLE_SLACK = 1.15
"""The promise of draws that the design has not seen, over what it kept in those that it saw."""
HELD = 0.1
"""Least share of an error that a position loop takes away in the rest of the reference move, K_p times its
length. Empirical (benchmarks/drivers/bench_closed_loop.py): loops that hold 0.65 and more, one that does not
0.01."""
SPREAD_DRAWS = 6
"""Machines of the covariance in which the reference move is made as well."""
STAND_IN = sentence("timid gains without feedforward (the drive's own values were not given)")


@dataclass(frozen=True)
class TuneSettings:
    """``timing`` of the drives, most ``notches`` an axis, ``draws`` on which margins are promised,
    ``seed``, ``ripple``: torque that counts may make, rms, as a share of rated torque."""

    timing: DriveTiming = field(default_factory=DriveTiming)
    notches: int = 2
    draws: int = 200
    seed: int = 0
    ripple: float = RIPPLE


@dataclass(frozen=True, eq=False)
class Sensors:
    """Counts of the encoders [rad or m] and rated torques [N·m or N] (M,), NaN: not stated."""

    counts: Float64
    rated: Float64

    def noise_gain(self, ripple: float) -> Float64:
        """(M,) rms torque per rms position that keeps to ``ripple``; infinite where it is not known."""
        bound = ripple * self.rated / (self.counts / math.sqrt(12.0))
        return np.asarray(np.where(np.isfinite(bound), bound, math.inf), dtype=float)


def sensors_of(model: Model) -> Sensors:
    """What the recording that a model comes from stated of its drives."""
    stated = model.provenance.get("sensors")
    by_axis = stated if isinstance(stated, Mapping) else {}

    def column(name: str) -> Float64:
        found = [by_axis.get(a, {}) for a in model.axes]
        return np.array([float(f.get(name, math.nan)) if isinstance(f, Mapping) else math.nan for f in found])

    return Sensors(column("encoder_resolution"), column("rated_torque"))


@dataclass(frozen=True, kw_only=True)
class TunedLoop(AxisLoop):
    """A loop with the margins that it leaves and how it makes the reference move."""

    margins: Margins
    move: MoveFigures


@dataclass(frozen=True)
class AxisTuning:
    """One axis, as the document has it. ``inertia`` is all that the motor moves, ``motor_inertia`` its own
    side [kg·m² or kg]; antiresonance and resonance at the motor, the other motors held, ``None`` where
    nothing swings; ``backlash`` is full free play [rad or m], 0 where none was named; ``rated_torque`` NaN
    where the model does not say. ``spread``: least and most of the figures of the move with the new values in
    ``SPREAD_DRAWS`` machines drawn from the covariance."""

    axis: str
    inertia: Estimate
    motor_inertia: Estimate
    antiresonance_hz: float | None
    resonance_hz: float | None
    backlash: float
    rated_torque: float
    spread: Mapping[str, tuple[float, float]]
    before: TunedLoop
    after: TunedLoop


@dataclass(frozen=True, eq=False)
class Tuning:
    """The result. ``before_source`` says what ``before`` was; ``remarks`` what was open or left out."""

    model: Model
    settings: TuneSettings
    axes: tuple[AxisTuning, ...]
    remarks: tuple[str, ...]
    before_source: str
    command: Command
    run_before: LoopRun
    run_after: LoopRun
    plant: LinearPlant


def untuned(plant: LinearPlant, axis: int, inertia: float, timing: DriveTiming) -> Gains:
    """Gains that stand in for those of a drive as delivered."""
    antiresonance, _ = seen_modes(plant, axis)
    highest = 1.0 / (2.0 * timing.total(float(plant.delay[axis]), float(plant.lag[axis])))
    crossover = highest if antiresonance is None else min(highest, 2 * math.pi * antiresonance)
    return gains_at(inertia, UNTUNED * crossover)


def tune_model(
    source: Model | Diagnosis,
    settings: TuneSettings,
    before: Mapping[str, AxisLoop] | None = None,
) -> Tuning:
    """Gains, notches, feedforward and shaper for every axis; see ``invid.tune``."""
    found = candidates(source)
    lost = [left for left in linear_plant(found.models[0]).nonlinear if left.reason]
    known = tuple(_without(m, [left.term for left in lost]) for m in found.models)
    model, timing = known[0], settings.timing
    rng = np.random.default_rng(settings.seed)
    plant = linear_plant(model)
    inertia = own_inertias(plant)
    seen = [linear_plant(m) for m in drawn_models(known, DESIGN_DRAWS, rng)]
    soft = [linear_plant(m) for m in (softened(m) for m in known) if m is not None]
    fresh = [linear_plant(m) for m in drawn_models(known, settings.draws, rng)]
    sensors = sensors_of(model)
    most = sensors.noise_gain(settings.ripple)
    gains = design_gains(drawn_plants([plant, *seen, *soft], timing), plant, settings.notches, most)
    gains, margins = _kept(fresh, gains, timing, sensors, settings.ripple)
    command = reference_move(plant, timing, bearable(model, inertia))
    _require_hold(model, gains, margins, sensors, command.arrived * timing.cycle)
    loop = closed_loop(plant, gains, timing)
    shapers = _shapers(loop, [closed_loop(p, gains, timing) for p in fresh[:_SHAPER_DRAWS]])
    forward = [feedforward(model, plant, i, float(inertia[i]), found.open_terms) for i in range(len(gains))]
    after = [AxisLoop(g, f, s) for g, f, s in zip(gains, forward, shapers, strict=True)]
    old = [
        (before or {}).get(name) or AxisLoop(untuned(plant, i, float(inertia[i]), timing), NONE)
        for i, name in enumerate(model.axes)
    ]
    margins_before = worst_margins(fresh, tuple(a.gains for a in old), timing, PROMISE, sensors.counts)
    run_before, run_after = (run_loops(model, each, command, timing, sensors.counts) for each in (old, after))
    drawn = drawn_models(known, SPREAD_DRAWS, rng)
    spread = [move_figures(run_loops(m, after, command, timing, sensors.counts), command) for m in drawn]
    moves_before, moves_after = move_figures(run_before, command), move_figures(run_after, command)
    unit = "kg" if model.linear else "kg·m²"
    axes = []
    for i, name in enumerate(model.axes):
        masses, std = model.chains.masses[i], float(model.std.masses[i][0])
        figures = [vars(moves[i]) for moves in spread]
        axes.append(
            AxisTuning(
                name,
                Estimate(float(masses.sum()), forward[i].inertia_std, unit),
                Estimate(float(masses[0]), std if math.isfinite(std) else None, unit),
                *seen_modes(plant, i),
                sum(e.value("gap") for e in model.effects if e.cause == "backlash" and e.axis == name),
                float(sensors.rated[i]),
                {key: (min(f[key] for f in figures), max(f[key] for f in figures)) for key in figures[0]},
                TunedLoop(**vars(old[i]), margins=margins_before[i], move=moves_before[i]),
                TunedLoop(**vars(after[i]), margins=margins[i], move=moves_after[i]),
            )
        )
    unknown = [name for name in model.axes if name not in (before or {})]
    said = sentence("as given")
    if unknown:
        said = sentence("{source}; {axes}: {rest}", source=said, axes=joined(unknown), rest=STAND_IN)
    return Tuning(
        model,
        settings,
        tuple(axes),
        (*found.remarks, *_left_out(lost, forward, model.axes), *_remarks(axes, settings.ripple)),
        said if before else STAND_IN,
        command,
        run_before,
        run_after,
        plant,
    )


def _require_hold(
    model: Model, gains: Sequence[Gains], margins: Sequence[Margins], sensors: Sensors, rest_s: float
) -> None:
    """NotIdentifiableError where counts leave no loop that holds an axis."""
    for axis, g, m, count, rated in zip(
        model.axes, gains, margins, sensors.counts, sensors.rated, strict=True
    ):
        held = g.position_gain * rest_s
        if held < HELD and math.isfinite(m.ripple / rated):
            raise NotIdentifiableError(
                f"axis {axis}: its encoder's counts of {count:.3g} leave no loop that holds it: within the "
                f"ripple asked for the position gain is {g.position_gain:.2g} 1/s",
                way_out=f"a finer encoder, a longer --cycle, or more torque of counts: --ripple "
                f"{100 * m.ripple / rated / held:.2g} (% of rated)",
            )


def bearable(model: Model, inertia: Float64) -> dict[int, float]:
    """Largest acceleration of the axes whose torque saturates: the move is to show loops, not the limit."""
    limits = {
        model.axes.index(e.axis): e.value("limit") for e in model.effects if e.cause == "torque_saturation"
    }
    return {i: SATURATED * limit / float(inertia[i]) for i, limit in limits.items()}


def _without(model: Model, terms: Sequence[EffectTerm]) -> Model:
    return replace(model, effects=tuple(e for e in model.effects if not any(e is t for t in terms)))


def _kept(
    fresh: Sequence[LinearPlant],
    gains: tuple[Gains, ...],
    timing: DriveTiming,
    sensors: Sensors,
    ripple: float,
) -> tuple[tuple[Gains, ...], tuple[Margins, ...]]:
    """Gains slowed down until margins and ripple hold in ``KEPT`` of draws that the design has not seen."""
    for _ in range(_ROUNDS):
        margins = worst_margins(fresh, gains, timing, PROMISE, sensors.counts)
        short = [m.kept < KEPT or m.unstable > 0 for m in margins]
        loud = [
            m.ripple > _RIPPLE_SLACK * ripple * rated for m, rated in zip(margins, sensors.rated, strict=True)
        ]
        if not any(short) and not any(loud):
            return gains, margins
        unstable = any(m.unstable for m in margins)
        gains = tuple(
            slower(g, _SLOWER) if unstable or s or n else g
            for g, s, n in zip(gains, short, loud, strict=True)
        )
    margins = worst_margins(fresh, gains, timing, PROMISE, sensors.counts)
    if all(m.kept >= KEPT and m.unstable == 0 for m in margins):  # such encoders leave no quieter loop: said
        return gains, margins
    raise NotIdentifiableError(
        f"no gains keep a peak of sensitivity of {PROMISE:g} in {KEPT:.0%} of the machines drawn",
        way_out="measure longer, or with more amplitude, until the model is surer",
    )


def softened(model: Model) -> Model | None:
    """The model with little left of the springs that have free play; ``None`` where none has."""
    springs = [np.array(s) for s in model.chains.springs]
    loose = [e for e in model.effects if e.cause == "backlash"]
    for term in loose:
        number = int((term.element or "spring 1").rpartition(" ")[2])
        springs[model.axes.index(term.axis)][number - 1] *= SOFTENED
    return replace(model, chains=replace(model.chains, springs=tuple(springs))) if loose else None


def _shapers(loop: ClosedLoop, drawn: Sequence[ClosedLoop]) -> list[Shaper | None]:
    """Of every axis for the lowest mode of its load, and the nearest mode of each machine drawn."""
    modes = [d.modes() for d in drawn]
    out: list[Shaper | None] = []
    for i in range(loop.load_compliance.ninputs):
        if (mode := load_mode(loop, i)) is None:
            out.append(None)
            continue
        nearest = [int(np.argmin(np.abs(np.log(hz / mode[0])))) for hz, _ in modes]
        out.append(choose_shaper(mode, [(hz[k], d[k]) for (hz, d), k in zip(modes, nearest, strict=True)]))
    return out


def _left_out(lost: Sequence[LeftOut], forward: Sequence[Feedforward], axes: Sequence[str]) -> list[str]:
    out = [
        sentence(
            "{axis}: {cause} cannot be simulated here and is in nothing below: {why}",
            axis=left.term.axis,
            cause=cause_name(left.term.cause),
            why=left.reason,
        )
        for left in lost
    ]
    for name, f in zip(axes, forward, strict=True):
        out += [sentence("{axis}: no feedforward for {what}", axis=name, what=text) for text in f.left_out]
    return out


def _remarks(axes: Sequence[AxisTuning], ripple: float) -> list[str]:
    """What of free play and of the encoders' counts these values leave."""
    out = [
        sentence(
            "{axis}: free play of {size} is a limit of its own: margins hold while the teeth "
            "touch and for the motor alone; no drive value repairs it",
            axis=a.axis,
            size=Figure(f"{a.backlash:.3g}"),
        )
        for a in axes
        if a.backlash
    ]
    shares = {a.axis: a.after.margins.ripple / a.rated_torque for a in axes}
    for axis, share in shares.items():
        if share > _RIPPLE_SLACK * ripple:
            out.append(
                sentence(
                    "{axis}: its encoder's counts make {share} of rated torque, rms, more than {most}; a "
                    "slower loop is not quieter enough: a finer encoder is needed",
                    axis=axis,
                    share=Figure(f"{share:.2g}"),
                    most=Figure(f"{ripple:g}"),
                )
            )
    if unknown := [axis for axis, share in shares.items() if math.isnan(share)]:
        out.append(
            sentence(
                "{axes}: the model does not say the encoder's count and rated torque, so the torque "
                "that counts make is not bounded; identify a recording that states both",
                axes=", ".join(unknown),
            )
        )
    return out
