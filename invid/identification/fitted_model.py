"""The fitted chains as a model: values, deviations, doubts, warnings, and the facts of the fit."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np

from invid.effects.units import unit_of
from invid.identification.identifiability import blind_directions
from invid.identification.missing_torque import AxisMissing, axis_missing
from invid.identification.open_holds import open_masses
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.shapes import curvature
from invid.likelihood.unknown_forces.timing import COMMAND, EXPECTED_DELAY, HOLD
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm, Model, parameter_vector, std_by_name
from invid.model.doubts import Doubt, DoubtCode, doubt_facts
from invid.model.plant import Kind, Plant, Structure
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.model import Recording, Role
from invid.wording.sentence import sentence

EARLY = 0.05
"""Samples by which a hold acts before its command from which a warning says so (empirical)."""
SEEN = 1e-3
"""Share of a motor's mass that a hold leaves open from which a warning says so (physical)."""
LIGHT, BEYOND = 0.01, 3.0
"""Share of its chain that no motor's mass is below (physical: gears are chosen near the load's inertia), and
its own frequency on its spring over the highest one of interest, from which no line shows it (physical)."""
KNOWN = 0.5
"""Deviation of its delay over that of the prior from which the records do not tell it."""


def chains_of(end: FittedHypothesis, axes: tuple[str, ...]) -> tuple[CoupledChains, dict[str, int]]:
    """The chains, and where each parameter's name stands among the plant's numbers."""
    plant, structure = end.numbers.plant, end.hypothesis.structure
    masses, springs, dampers = (plant.of_kind(k) for k in (Kind.MASS, Kind.SPRING, Kind.DAMPER))
    first_of = {kind: structure.index(kind).start for kind in Kind}
    names: dict[str, int] = {}
    parts: dict[str, list[list[float]]] = {"mass": [], "spring": [], "damper": []}
    link = 0
    for axis, (first, n) in enumerate(zip(structure.motor, structure.sizes, strict=True)):
        for kind, name, values, start, count in (
            (Kind.MASS, "mass", masses, first, n),
            (Kind.SPRING, "spring", springs, link, n - 1),
            (Kind.DAMPER, "damper", dampers, link, n - 1),
        ):
            parts[name].append(list(values[start : start + count]))
            for q in range(count):
                names[f"{axes[axis]}.{name}.{q + 1}"] = first_of[kind] + start + q
        link += n - 1
    couplings = np.zeros((len(axes), len(axes)))
    for k, (i, j) in enumerate(structure.pairs):
        couplings[i, j] = couplings[j, i] = plant.of_kind(Kind.COUPLING)[k]
        names[f"{axes[i]}-{axes[j]}.coupling"] = first_of[Kind.COUPLING] + k
    built = CoupledChains.build(parts["mass"], parts["spring"], parts["damper"], couplings, axes=axes)
    return built, names


def plant_of(chains: CoupledChains) -> Plant:
    """The plant of chains, without springs between their loads."""
    structure = Structure(chains.masses_per_branch)
    coupled = np.array([chains.couplings[pair] for pair in structure.pairs])
    parts = (*chains.masses, *chains.springs, *chains.dampers, coupled, np.zeros(coupled.size))
    return Plant.of_values(structure, np.concatenate(parts))


def chains_covariance(
    end: FittedHypothesis, axes: tuple[str, ...], open_part: Float64
) -> tuple[CoupledChains, Float64]:
    """The chains, and the covariance (n, n) of their parameters in the order of ``parameter_vector``.

    ``open_part`` (M,): mass of each motor that its hold leaves open (``open_masses``).
    """
    built, names = chains_of(end, axes)
    known, _ = parameter_vector(built)
    index = [names[n] for n in known]
    plant = end.numbers.plant
    around = curvature(end).covariance[: plant.x.size, : plant.x.size]
    covariance = around * plant.slope[:, None] * plant.slope
    motors = plant.structure.index(Kind.MASS).start + np.array(plant.structure.motor)
    covariance[motors, motors] += open_part**2
    return built, covariance[np.ix_(index, index)]


def model_of(end: FittedHypothesis, effects: tuple[EffectTerm, ...], recording: Recording) -> Model:
    """The chains with their covariance, the causes, and what the data do not tell."""
    axes, open_part = recording.axes, open_masses(end)
    built, covariance = chains_covariance(end, axes, open_part)
    known, values = parameter_vector(built)
    band = _band(recording)
    unseen, sentences = blind_directions(
        built, dict(zip(known, values.tolist(), strict=True)), covariance, band
    )
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    std = {n: np.nan if n in unseen else float(d) for n, d in zip(known, deviation, strict=True)}
    doubts = [
        *_short_experiments(recording),
        *_unmoved_motors(end, recording),
        *(Doubt(DoubtCode.UNSEEN, said) for said in sentences),
    ]
    said = [*(d.text for d in doubts), *hold_warnings(end, open_part, recording), *_lag_warnings(end, axes)]
    return Model(
        robot=recording.robot,
        method="refined",
        chains=built,
        std=std_by_name(built, std),
        linear=recording.linear,
        effects=effects,
        warnings=tuple(dict.fromkeys(said)),
        covariance=frozen_float(covariance),
        parameter_names=known,
        fit={
            **doubt_facts(doubts),
            "unseen": list(sentences),
            **_facts(end, axes, axis_missing(end)),
            "band_hz": list(band),
            **_timing(end, axes),
        },
        provenance=provenance_of(recording),
    )


def provenance_of(recording: Recording) -> dict[str, Any]:
    """What a model says of where it comes from."""
    return {
        "software": f"invid {version('invid')}",
        "recording": recording.source,
        "recorded": recording.created,
        "experiments": [e.key for e in recording.experiments if e.role is Role.IDENTIFY],
        "sensors": _sensors_of(recording),
    }


def _sensors_of(recording: Recording) -> dict[str, dict[str, float]]:
    """Counts of encoders and rated torques by axis, those that the recording states."""
    stated = {"encoder_resolution": recording.encoder_resolution, "rated_torque": recording.rated_torque}
    return {
        axis: {k: float(v[i]) for k, v in stated.items() if v is not None and np.isfinite(v[i]) and v[i] > 0}
        for i, axis in enumerate(recording.axes)
    }


def _short_experiments(recording: Recording) -> list[Doubt]:
    """The doubt about an experiment that ends before its first period does: its lines are not resolved."""
    return [
        Doubt(
            DoubtCode.SHORT_RECORD,
            sentence(
                "experiment {experiment} holds {samples:.0%} of one period of its excitation",
                experiment=e.key,
                samples=e.samples / e.period_samples,
            ),
        )
        for e in recording.experiments
        if 0 < e.samples < e.period_samples
    ][:1]


def _unmoved_motors(end: FittedHypothesis, recording: Recording) -> list[Doubt]:
    """The doubt about a torque that acts on everything but the motor's own mass, as one measured behind the
    spring does."""
    plant, structure = end.numbers.plant, end.hypothesis.structure
    mass, spring = plant.of_kind(Kind.MASS), plant.of_kind(Kind.SPRING)
    top = 2 * np.pi * max(r.top_hz for s in end.bench.stacks for r in s.records)
    out = []
    for i, (motor, load) in enumerate(zip(structure.motor, structure.load, strict=True)):
        if motor == load:
            continue
        share = float(mass[motor] / mass[motor : load + 1].sum())
        own = np.sqrt(spring[structure.links.index((motor, motor + 1))] / mass[motor])
        if share < LIGHT and own > BEYOND * top:
            unit = unit_of("mass", recording.linear)
            said = sentence(
                "{axes}: the torque hardly moves the motor: its mass comes out as {mass:.2g} "
                "{unit}, {share:.2g} % of its chain. The torque is measured behind the spring, "
                "where its load alone answers, or the motor is that light; these data cannot tell: "
                "record the motor's current beside it, or the position behind the spring",
                axes=recording.axes[i],
                mass=mass[motor],
                unit=unit,
                share=100 * share,
            )
            out.append(Doubt(DoubtCode.TORQUE_BEHIND_SPRING, said, {"share": share}))
    return out


def _band(recording: Recording) -> tuple[float, float]:
    """Lowest and highest frequency that any experiment excites; of none the lines of the longest."""
    lines = [e.frequencies_hz for e in recording.experiments if e.frequencies_hz.size]
    if not lines:
        seconds = max(float(e.time[-1] - e.time[0]) for e in recording.experiments)
        return 1.0 / seconds, 0.5 * max(e.sample_rate_hz for e in recording.experiments)
    return min(float(f.min()) for f in lines), max(float(f.max()) for f in lines)


def _facts(end: FittedHypothesis, axes: tuple[str, ...], left: AxisMissing) -> dict[str, Any]:
    """How well the model fits: by its own noise, by the sensors' alone, and of the torque."""
    value = end.fit.value
    rows = [w.missing + w.laws @ value.coefficients for w in value.work]
    count = sum(r.size for r in rows) - end.numbers.x.size - int(value.free.sum())
    torque = np.mean([np.nanvar(r.torque_wave, axis=0) for s in end.bench.stacks for r in s.records], axis=0)
    missed = float(
        (np.maximum(left.missing**2 - left.floor**2, 0.0)).sum() / max(float(torque.sum()), 1e-300)
    )
    return {
        "value": end.total,
        "chi2": float(sum((r**2).sum() for r in rows)),
        "dof": count,
        "noise_chi2_per_dof": float(np.mean((left.missing / np.maximum(left.floor, 1e-300)) ** 2)),
        "explained": max(1.0 - missed, 0.0),
        "lines": {r.key: int(r.omega.size) for s in end.bench.stacks for r in s.records},
        "periods": {r.key: r.periods for s in end.bench.stacks for r in s.records},
        "unknown_forces": {axis: float(v) for axis, v in zip(axes, _at_motors(end), strict=True)},
    }


def _at_motors(end: FittedHypothesis) -> Float64:
    motors = end.hypothesis.structure.motors
    number = end.fit.problem.spots.number
    rms = {number[s]: v for v, s in end.strength}
    return np.array([rms[k] for k in range(motors)])


def _timing(end: FittedHypothesis, axes: tuple[str, ...]) -> dict[str, Any]:
    """Sampling offset of each axis' torque, and the lag of what is shown of it behind what acts [s]."""
    timing, motors = end.numbers.timing, len(axes)
    first = end.numbers.plant.x.size
    deviation = np.sqrt(np.maximum(np.diag(end.fit.covariance), 0.0))[first:] * timing.step
    offsets, lags = {}, {}
    # Delays count from torque that is put where it acted already, as far as a logged command tells.
    late = float(np.mean([r.late for s in end.bench.stacks for r in s.records]))
    for i, axis in enumerate(axes):
        driven = any(r.driven[i] for s in end.bench.stacks for r in s.records)
        part = COMMAND if driven else HOLD
        offset = timing.delay[part, i] * timing.step - late
        offsets[f"{axis}.time_offset"] = {"value": float(offset), "std": float(deviation[part * motors + i])}
        if any(c[1] == i for c in end.hypothesis.channels) and timing.lag[i]:
            lags[axis] = {
                "value": float(-timing.lag[i] * timing.step),
                "std": float(deviation[4 * motors + i]),
            }
    return {"time_offset_s": offsets, "torque_lag_s": lags}


def hold_warnings(end: FittedHypothesis, open_part: Float64, recording: Recording) -> list[str]:
    """What holds that work while their axis is driven leave open: when they act."""
    timing, first = end.numbers.timing, end.numbers.plant.x.size
    motors, unit = timing.motors, unit_of("damping", recording.linear)
    masses = end.numbers.plant.of_kind(Kind.MASS)[list(end.hypothesis.structure.motor)]
    deviation = np.sqrt(np.maximum(np.diag(end.fit.covariance), 0.0))[first:]
    out = []
    for i, axis in enumerate(recording.axes):
        records = [r for s in end.bench.stacks for r in s.records if r.hold[i] > 0 and not r.tells_command(i)]
        at = HOLD * motors + i
        is_told = not records or deviation[at] < KNOWN * timing.prior[at]
        damping = 0.0 if is_told or not records[0].driven[i] else end.bench.stacks[0].damping[i]
        if open_part[i] + damping * timing.step * timing.prior[at] > SEEN * masses[i]:
            out.append(
                sentence(
                    "{axis}: a hold works while this axis is driven, and nothing tells whether it acts "
                    "inside the drive or is held over the sample: the standard deviation of its motor "
                    "mass covers both; record a torque_demand that leaves the hold out, drive the axis "
                    "without a hold, or state hold_by",
                    axis=axis,
                )
            )
        elif not is_told and timing.delay[HOLD, i] < EXPECTED_DELAY[HOLD] - EARLY:
            friction = -timing.delay[HOLD, i] * timing.step * max(float(r.hold[i]) for r in records)
            out.append(
                sentence(
                    "{axis}: its hold is taken to act up to half a sample before the command, as fits "
                    "best; viscous friction of {friction:.2g} {unit} at its motor would look alike: "
                    "record the demanded torque, or drive the axis without a hold, to tell",
                    axis=axis,
                    friction=friction,
                    unit=unit,
                )
            )
    return out


def _lag_warnings(end: FittedHypothesis, axes: tuple[str, ...]) -> list[str]:
    """Channels that low-pass what they record of the torque."""
    return [
        sentence(
            "{axis}: the recorded torque is low-passed ({lag:.3g} ± {std:.1g} ms, a lag, no mere delay); the "
            "parameters are corrected for it",
            axis=axis,
            lag=1e3 * lag["value"],
            std=1e3 * lag["std"],
        )
        for axis, lag in _timing(end, axes)["torque_lag_s"].items()
        if lag["value"] > 3.0 * lag["std"]
    ]
