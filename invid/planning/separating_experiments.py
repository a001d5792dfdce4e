"""The experiments that would tell the alternatives of a diagnosis apart, within a config's own limits.

Pure: diagnosis document and config in, config with other experiments out. They run through the normal
measurement, with its forecast, trial and limits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from invid.config import CellConfig, ConstantVelocitySpec, MultisineSpec
from invid.effects.registry import BY_CAUSE, effect_of
from invid.errors import InputError
from invid.planning.build import multisine_of
from invid.wording.sentence import sentence

Spec = MultisineSpec | ConstantVelocitySpec

LEVELS = (1.0, 0.4, 0.15)
"""Amplitudes of a ladder, of the config's: a factor of 2.5 each, over which dry friction, free play and a
cubic spring change their share of the torque by as much or by its square."""
SPEEDS = (0.01, 0.03, 0.1, 0.3)
"""Speeds of slow moves, of the axis's velocity limit: half a decade each, as a Stribeck curve asks for."""
USABLE_SHARE = 0.7
"""Share of the limits that slow moves use; the plan refuses above 0.8."""
MOST_LINE = 0.1
"""Highest line over the cycle rate that the plan takes."""


@dataclass(frozen=True)
class Separation:
    """What to run and why."""

    config: CellConfig
    sentences: tuple[str, ...]
    """What each part is for, in words; what only a person can do."""
    finding: int
    """Number of the first finding that is not told from its alternatives, from 0."""


def to_separate(document: Mapping[str, Any], config: CellConfig) -> Separation:
    """The config with the experiments that tell the alternatives of a diagnosis apart.

    Raises
    ------
    InputError
        No diagnosis, of another robot's axes, nothing to separate, or only what a machine cannot do.
    """
    if document.get("format") != "invid-diagnosis":
        raise InputError(
            f"--separate wants a diagnosis (format 'invid-diagnosis'), found {document.get('format')!r}; "
            "write one with 'invid diagnose REC.h5 -o DIAGNOSIS.json'"
        )
    names = [a.name for a in config.axes]
    findings = document.get("findings")
    specs: list[Spec] = []
    runs: list[list[Spec]] = []
    sentences: list[str] = []
    listed = findings if isinstance(findings, list | tuple) else []
    contested = [f for f in listed if _competing_causes(f)]
    if not contested:
        raise InputError(
            "the diagnosis has nothing to separate: no finding has alternatives that these data cannot "
            "tell from it"
        )
    for finding in contested:
        axis, causes = finding.get("axis"), _competing_causes(finding)
        if axis not in names:
            raise InputError(f"the diagnosis is of an axis {axis!r}; the config has {', '.join(names)}")
        new_specs, sentences_made = _experiments_for(config, str(axis), causes)
        if new_specs not in runs:
            runs.append(new_specs)
            specs += new_specs
        sentences += [s for s in sentences_made if s not in sentences]
    if not specs:
        raise InputError(f"no measurement of the drives alone separates these causes: {' '.join(sentences)}")
    specs.append(_validation_experiment(config))
    first = next(k for k, f in enumerate(listed) if _competing_causes(f))
    return Separation(config.model_copy(update={"experiments": specs}), tuple(sentences), first)


def is_measurable(cause: str) -> bool:
    """Return whether an experiment of the drives can tell a cause from others; else a person has to act."""
    effect = effect_of(cause)
    return effect is not None and effect.separating.kind != "hand"


def _competing_causes(finding: Any) -> set[str]:
    """Causes that compete for one finding; empty where it stands alone."""
    if not isinstance(finding, Mapping):
        return set()
    planned = finding.get("separating_experiment")
    rivals = finding.get("alternatives") or []
    named = {str(r.get("cause")) for r in rivals if isinstance(r, Mapping)}
    if isinstance(planned, Mapping) and isinstance(planned.get("separates"), list | tuple):
        named |= {str(c) for c in planned["separates"]}
    if not named:
        return set()
    return named | {str(finding.get("cause"))}


def _validation_experiment(config: CellConfig) -> MultisineSpec:
    """Return the experiment that is held out: another realisation at a level in between."""
    base = multisine_of(config)
    level = 0.6 * base.amplitude
    return base.model_copy(
        update={"role": "validate", "experiments": 1, "seed": base.seed + 101, "amplitude": level}
    )


def _amplitude_ladder(config: CellConfig, levels: Sequence[float] = LEVELS) -> list[Spec]:
    base = multisine_of(config)
    return [
        base.model_copy(
            update={
                "experiments": 1 if k else base.experiments,
                "seed": base.seed + 11 + k,
                "amplitude": level * base.amplitude,
            }
        )
        for k, level in enumerate(levels)
    ]


def _experiments_for(config: CellConfig, axis: str, causes: set[str]) -> tuple[list[Spec], list[str]]:
    specs: list[Spec] = []
    said: list[str] = []
    kinds = {e.separating.kind for c in causes if (e := effect_of(c)) is not None}
    limits = next(a.limits for a in config.axes if a.name == axis)
    base, rate = multisine_of(config), 1.0 / config.bus.cycle_s
    unit = "m" if config.linear else "rad"
    if "speeds" in kinds:
        speeds = tuple(round(USABLE_SHARE * s * limits.velocity, 9) for s in SPEEDS)
        specs += _amplitude_ladder(config)
        specs.append(
            ConstantVelocitySpec(
                kind="constant_velocity",
                axes=(axis,),
                velocities=speeds,
                travel=_travel_of(limits, speeds, 0.3),
            )
        )
        said.append(
            sentence(
                "Friction of {axis}: the same excitation at {count} amplitudes, and slow moves in "
                "both directions at {names} {unit}/s.",
                axis=axis,
                count=len(LEVELS),
                names=", ".join(f"{v:.3g}" for v in speeds),
                unit=unit,
            )
        )
    if "positions" in kinds:
        speed = round(USABLE_SHARE * 0.3 * limits.velocity, 9)
        travel = round(2.0 * USABLE_SHARE * limits.position, 9)
        specs += _amplitude_ladder(config, (1.0, 0.4))
        specs.append(
            ConstantVelocitySpec(kind="constant_velocity", axes=(axis,), velocities=(speed,), travel=travel)
        )
        said.append(
            sentence(
                "What depends on the position of {axis}: a slow move over {travel:.3g} {unit}, "
                "both ways, and two amplitudes. Positions farther apart than the window allows "
                "need a start from another pose.",
                axis=axis,
                travel=travel,
                unit=unit,
            )
        )
    if "amplitudes" in kinds:
        specs += _amplitude_ladder(config)
        said.append(
            sentence(
                "What depends on the amplitude of {axis}: the same excitation at {count} levels.",
                axis=axis,
                count=len(LEVELS),
            )
        )
    if "band" in kinds:
        top = round(min(MOST_LINE * rate, 2.5 * base.band_Hz[1]), 6)
        specs.append(base.model_copy(update={"band_Hz": (base.band_Hz[0], top), "seed": base.seed + 21}))
        said.append(
            sentence(
                "Delay or lag of {axis}: a band up to {top:.3g} Hz, where a lag loses amplitude "
                "and a delay does not.",
                axis=axis,
                top=top,
            )
        )
    if "lines" in kinds:
        specs.append(
            base.model_copy(update={"period_s": min(2.0 * base.period_s, 600.0), "seed": base.seed + 31})
        )
        said.append(sentence("Resonance at {axis}: lines twice as close.", axis=axis))
    if "time" in kinds:
        again = [base.model_copy(update={"seed": base.seed + 41 + k, "experiments": 1}) for k in range(3)]
        specs += [base, *again, base]
        said.append(sentence("What changes with time: the first experiment again at the end."))
    hand = sorted(c for c in causes if effect_of(c) is not None and not is_measurable(c))
    if hand:
        told = BY_CAUSE[hand[0]].separating.by_hand if len(hand) == 1 else ""
        said.append(f"{', '.join(hand)} on {axis}: {told or 'no experiment of the drives shows it.'}")
    return specs, said


def _travel_of(limits: Any, speeds: Sequence[float], seconds: float) -> float:
    """Return a travel long enough for the fastest move to last, short enough for the window."""
    longest = 2.0 * USABLE_SHARE * float(limits.position)
    return round(min(longest, max(10 * seconds * max(speeds), 1e-6)), 9)
