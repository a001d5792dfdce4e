"""Config to plan: every experiment as torque (and path) per cycle, within the limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.config import CellConfig, ChirpSpec, ConstantVelocitySpec, MultisineSpec, SteppedSineSpec
from invid.config.experiments import ExperimentSpec
from invid.errors import ConfigError, InputError
from invid.model.chains import CoupledChains
from invid.numerics.arrays import Float64, Int64, frozen_float
from invid.planning.belief import Belief, rigid
from invid.planning.budget import require_budget
from invid.planning.forecast import (
    fitted,
    foretold_doublets,
    limit_forecast,
    model_forecast,
    model_trials,
    scale_torque,
)
from invid.planning.model import Doublet, Plan, PlannedExperiment
from invid.planning.phases import (
    CLIMB_CYCLES,
    FADE_S,
    RECORDED_CLIMB_S,
    REST_S,
    fade_s,
    phases_of,
    played_once,
    trials_of,
)
from invid.recording.model import Kind, Role
from invid.signals import excitation
from invid.wording.sentence import sentence

UNKNOWN = sentence(
    "no model of this cell: how far it moves is not known before the trial at a small "
    "amplitude, which lowers every torque so that it stays within what is announced "
    "here"
)
CREEP_TRAVEL = 0.5
"""Share of the position window (±) that a creep may use; the excitation needs the rest."""


DEFAULT = MultisineSpec(kind="multisine", seed=1)
"""What is measured where the config asks for nothing: as many runs as axes, all of them shaken at once."""


def multisine_of(config: CellConfig) -> MultisineSpec:
    """The config's own identifying multisine on all axes, or the default one."""
    own = [e for e in config.experiments if isinstance(e, MultisineSpec)]
    base = ([e for e in own if e.role == "identify"] or own or [MultisineSpec(kind="multisine")])[0]
    return base.model_copy(update={"role": "identify", "axes": None})


def make_plan(
    config: CellConfig,
    *,
    axes: Sequence[str] | None = None,
    amplitude_scale: float = 1.0,
    model: CoupledChains | Belief | None = None,
    lowered: Sequence[float] | None = None,
) -> Plan:
    """The plan of a cell's experiments.

    Parameters
    ----------
    axes
        Excite only these; the others are held. ``None``: as each experiment says.
    amplitude_scale
        Factor on every torque that would be planned, 0 < scale ≤ 1.
    model
        The last accepted model, with its friction where that is known: what is announced comes from it, and
        torque is planned so that it keeps the limits. Without one the limits are announced, and the trial
        of the sweep lowers the torque.
    lowered
        Share of that torque that each axis keeps so that it comes to rest in time.

    Raises
    ------
    ConfigError
        An axis that is not there, an experiment that cannot be made, a bus over its budget.
    """
    names = require_known_axes(config, axes)
    if axes is not None and not axes:
        raise ConfigError(f"axes: none named; the config has {', '.join(names)}")
    if not 0 < amplitude_scale <= 1:
        raise ConfigError(f"amplitude scale is {amplitude_scale!r}; it must lie above 0 and be at most 1")
    require_budget(config)
    chosen = None if axes is None else {names.index(n) for n in axes}
    experiments: list[PlannedExperiment] = []
    specs = config.experiments or [DEFAULT]
    for spec in (*specs, *_climb(specs)):
        specs_wanted = range(len(names)) if spec.axes is None else [names.index(n) for n in spec.axes]
        excited = tuple(i for i in specs_wanted if chosen is None or i in chosen)
        if not excited:
            continue
        peaks = np.zeros(len(names))
        for i in excited:
            peaks[i] = spec.amplitude * amplitude_scale * config.axes[i].limits.torque
        try:
            if isinstance(spec, MultisineSpec):
                planned = _multisine(config, spec, excited, peaks)
            elif isinstance(spec, SteppedSineSpec):
                planned = _stepped_sine(config, spec, excited, peaks)
            elif isinstance(spec, ChirpSpec):
                planned = _chirp(config, spec, excited, peaks)
            else:
                planned = _constant_velocity(config, spec, excited)
        except ConfigError:
            raise
        except InputError as error:
            raise ConfigError(f"experiments: {error}") from None
        experiments += planned
    if not experiments:
        raise ConfigError(f"experiments: none excites any of the axes {', '.join(axes or names)}")
    climb = experiments.pop() if _climb(specs) else None
    warnings = []
    if climb is None and not any(e.role is Role.VALIDATE for e in experiments):
        warnings.append(
            sentence("no experiment has role 'validate': a diagnosis will have to hold data out by itself")
        )
    belief = model if isinstance(model, Belief) or model is None else _without_friction(model)
    kept = np.ones(len(names)) if lowered is None else np.asarray(lowered, dtype=float)
    made = assemble(config, experiments, belief, share=amplitude_scale, lowered=kept, climb=climb)
    return replace(made, warnings=(*warnings, *made.warnings))


def _climb(specs: Sequence[ExperimentSpec]) -> list[MultisineSpec]:
    """What the amplitude of multisines from rest is tried on, where none of them is there to validate.

    It is recorded at about a third of the amplitude, in another realisation, and judges what comes of them.
    """
    rest = [s for s in specs if isinstance(s, MultisineSpec) and s.is_from_rest and s.role == "identify"]
    if len(rest) < len(specs) or len({s.axes for s in rest}) > 1:
        return []
    first = rest[0]
    length = min(first.period_s, max(RECORDED_CLIMB_S, CLIMB_CYCLES / first.band_Hz[0]))
    # every line on all axes: the watch over signs learns on it how each follows its torque
    changes = {
        "role": "validate",
        "period_s": length,
        "experiments": 1,
        "lines": "all",
        "seed": first.seed + 1,
    }
    return [first.model_copy(update=changes)]


def require_known_axes(config: CellConfig, axes: Sequence[str] | None) -> tuple[str, ...]:
    """Names of the config's axes; ConfigError where ``axes`` holds another."""
    names = tuple(a.name for a in config.axes)
    unknown = [n for n in axes or () if n not in names]
    if unknown:
        raise ConfigError(f"axes: no axis {unknown[0]!r} in the config; it has {', '.join(names)}")
    return names


def assemble(
    config: CellConfig,
    experiments: Sequence[PlannedExperiment],
    belief: Belief | None,
    *,
    share: float,
    lowered: Float64 | None = None,
    climb: PlannedExperiment | None = None,
) -> Plan:
    """Experiments with keys, trials, phases and forecast; torque lowered where the model leaves a limit.

    ``share`` is the factor on every torque that was asked for, ``lowered`` (M,) what each axis keeps of it
    so that it comes to rest in time. ``climb`` is what multisines are tried on, and recorded before them.
    """
    known = belief is not None and not belief.guessed
    kept = np.ones(len(config.axes)) if lowered is None else lowered
    first = 0 if climb is None else 1
    played = scale_torque([*([] if climb is None else [climb]), *experiments], kept)
    played = tuple(replace(e, key=f"{k:03d}") for k, e in enumerate(played))
    sentences: list[str] = []
    doublets: tuple[Doublet | None, ...]
    inertia: list[float | None] = [a.inertia for a in config.axes]
    if belief is not None and known:
        inertia = [a.inertia or float(m) for a, m in zip(config.axes, belief.inertia, strict=True)]
        played, peaks, is_lowered = fitted(config, played, belief, share, kept)
        sentences += is_lowered
        doublets = foretold_doublets(config, played[first:], belief)
        trials = trials_of(config, played[first:], climb and played[0])
        trials = model_trials(config, trials, peaks[first:], belief)
        expected = model_forecast(config, played, peaks, belief)
    else:
        doublets = (None,) * len(inertia)
        rough = rigid(config)
        if rough is not None:
            played, _, is_lowered = fitted(config, played, rough, share, kept)
            sentences += is_lowered
        trials = trials_of(config, played[first:], climb and played[0])
        expected = limit_forecast(config, played, share)
        sentences.append(UNKNOWN)
    return Plan(
        axes=tuple(a.name for a in config.axes),
        cycle_s=config.bus.cycle_s,
        experiments=played[first:],
        rest_s=REST_S,
        budget=require_budget(config),
        forecast=expected,
        doublets=doublets,
        warnings=tuple(sentences),
        trials=trials,
        phases=phases_of(config, played[first:], trials, weights=list(zip(inertia, doublets, strict=True))),
        inertia=tuple(inertia),
        share=share,
    )


def _without_friction(chains: CoupledChains) -> Belief:
    zero = frozen_float(np.zeros(chains.branches))
    bare = replace(chains, ground_dampers=zero)
    return Belief(bare, chains.ground_dampers, zero, "the last model", False)


def _multisine(
    config: CellConfig, spec: MultisineSpec, excited: tuple[int, ...], peaks: Float64
) -> list[PlannedExperiment]:
    rate = 1.0 / config.bus.cycle_s
    count = len(excited)
    period = round(spec.period_s * rate)
    _check_below_nyquist(spec.band_Hz[1], rate)
    is_shared = spec.lines == "interleaved"
    from_rest = spec.is_from_rest
    rng = np.random.default_rng(spec.seed)
    # odd lines show distortion between them in settled periods alone
    kind = spec.lines if not is_shared else "all" if from_rest else "odd"
    lines = excitation.line_numbers(
        period / rate, spec.band_Hz, kind, detection_fraction=spec.detection_fraction, rng=rng
    )
    fade = round(fade_s(float(lines.min()) * rate / period) * rate)
    result = []
    is_own = is_shared or (spec.experiments == 1 and count > 1)
    for waves in _waves(spec, lines, (period, rate), count, rng):
        one = np.zeros((period, peaks.size))
        one[:, list(excited)] = waves * peaks[list(excited)]
        if from_rest:
            torque, first = played_once(one, 1.0 / rate, is_free=is_own), 0
            last = len(torque)
        else:
            # rows are laid out so that the recorded part starts with the first sample of a period
            rows = np.arange(period * (spec.settle_periods + spec.periods) + 2 * fade) - fade
            torque = excitation.apply_ramps(one[rows % period], fade, fade)
            first = fade + spec.settle_periods * period
            last = first + spec.periods * period
        reference = None
        if spec.creep_velocity > 0:
            reference = np.zeros_like(torque)
            for axis in excited:
                window = config.axes[axis].limits.position * CREEP_TRAVEL
                reference[:, axis] = excitation.triangle_path(spec.creep_velocity, len(torque), rate, window)
        result.append(
            PlannedExperiment(
                kind=Kind.MULTISINE,
                role=Role(spec.role),
                excited=excited,
                torque=frozen_float(torque),
                reference=None if reference is None else frozen_float(reference),
                record_from=first,
                record_to=last,
                period_samples=0 if from_rest else period,
                frequencies_hz=frozen_float(lines * rate / period),
                attributes={"seed": spec.seed, "amplitude": spec.amplitude, "lines": spec.lines}
                | ({"from_rest": True} if from_rest else {}),
            )
        )
    return result


def _waves(
    spec: MultisineSpec, lines: Int64, grid: tuple[int, float], count: int, rng: np.random.Generator
) -> list[Float64]:
    """(n, M) waves of peak 1 of so many axes for each run; ``grid``: samples of a period and their rate [Hz].

    Runs of one count are orthogonal. Lines of each axis alone, and those of a single run, have phases of
    their own, so that the axes do not all push at the same moment.
    """
    runs, (period, rate) = spec.experiments or count, grid
    if spec.lines == "interleaved" or (runs == 1 and count > 1):
        turns = range(count)
        own = [
            [lines[(t - run) % count :: count] if spec.lines == "interleaved" else lines for t in turns]
            for run in range(runs)
        ]
        if min(part.size for parts in own for part in parts) == 0:
            raise ConfigError(
                f"experiments: a period of {spec.period_s:g} s has too few lines in {spec.band_Hz[0]:g}…"
                f"{spec.band_Hz[1]:g} Hz for {count} axes; lengthen period_s or widen band_Hz"
            )
        return [
            np.stack(
                [
                    excitation.multisine(
                        part, period, rate, rng=np.random.default_rng([spec.seed, run, a])
                    ).period()
                    for a, part in enumerate(parts)
                ],
                axis=1,
            )
            for run, parts in enumerate(own)
        ]
    rotations = [
        excitation.orthogonal_rotation(a, run, max(count, runs)) for run in range(runs) for a in range(count)
    ]
    signal = excitation.multisine(lines, period, rate, rng=rng, rotations=rotations)
    waves = np.stack([signal.period(r) for r in rotations], axis=1)
    return [waves[:, run * count : (run + 1) * count] for run in range(runs)]


def _stepped_sine(
    config: CellConfig, spec: SteppedSineSpec, excited: tuple[int, ...], peaks: Float64
) -> list[PlannedExperiment]:
    """One experiment per axis and frequency: each is periodic by itself."""
    rate = 1.0 / config.bus.cycle_s
    result = []
    for axis in excited:
        for wanted in spec.frequencies_Hz:
            _check_below_nyquist(wanted, rate)
            fade = round(fade_s(wanted) * rate)
            period = max(2, round(rate / wanted))
            frequency = rate / period
            settle, keep = spec.settle_cycles * period, spec.cycles * period
            total = settle + keep + 2 * fade
            torque = np.zeros((total, peaks.size))
            # row ``fade`` is the crest of a cosine, whatever the length of the ramp before it
            phase = 2 * np.pi * frequency * (np.arange(total) - fade) / rate
            torque[:, axis] = peaks[axis] * np.cos(phase)
            result.append(
                PlannedExperiment(
                    kind=Kind.STEPPED_SINE,
                    role=Role(spec.role),
                    excited=(axis,),
                    torque=frozen_float(excitation.apply_ramps(torque, fade, fade)),
                    record_from=fade + settle,
                    record_to=fade + settle + keep,
                    period_samples=period,
                    frequencies_hz=frozen_float([frequency]),
                    attributes={"amplitude": spec.amplitude},
                )
            )
    return result


def _chirp(
    config: CellConfig, spec: ChirpSpec, excited: tuple[int, ...], peaks: Float64
) -> list[PlannedExperiment]:
    rate = 1.0 / config.bus.cycle_s
    _check_below_nyquist(spec.band_Hz[1], rate)
    fade = round(fade_s(spec.band_Hz[0]) * rate)
    samples = round(spec.duration_s * rate)
    wave = excitation.apply_ramps(
        excitation.chirp(spec.band_Hz, samples, rate), min(fade, samples // 4), round(FADE_S * rate)
    )
    after = round(
        2 * FADE_S * rate
    )  # the record ends with the ringing after the sweep, not in the middle of it
    result = []
    for axis in excited:
        torque = np.zeros((samples + after, peaks.size))
        torque[:samples, axis] = peaks[axis] * wave
        result.append(
            PlannedExperiment(
                kind=Kind.CHIRP,
                role=Role(spec.role),
                excited=(axis,),
                torque=frozen_float(torque),
                record_to=samples + after,
                attributes={"amplitude": spec.amplitude, "band_hz": list(spec.band_Hz)},
            )
        )
    return result


def _constant_velocity(
    config: CellConfig, spec: ConstantVelocitySpec, excited: tuple[int, ...]
) -> list[PlannedExperiment]:
    rate = 1.0 / config.bus.cycle_s
    result = []
    for axis in excited:
        limits, name = config.axes[axis].limits, config.axes[axis].name
        if spec.travel / 2 > 0.8 * limits.position:
            raise ConfigError(
                f"experiments: a move of {spec.travel:g} around the start leaves 80 % of axis {name}'s "
                f"position window of ±{limits.position:g}; shorten travel"
            )
        for velocity in spec.velocities:
            if velocity > 0.8 * limits.velocity:
                raise ConfigError(
                    f"experiments: velocity {velocity:g} is more than 80 % of axis {name}'s limit "
                    f"{limits.velocity:g}"
                )
            path = excitation.constant_velocity_path(velocity, spec.travel, rate)
            reference = np.zeros((path.size, len(config.axes)))
            reference[:, axis] = path
            result.append(
                PlannedExperiment(
                    kind=Kind.CONSTANT_VELOCITY,
                    role=Role(spec.role),
                    excited=(axis,),
                    torque=frozen_float(np.zeros_like(reference)),
                    reference=frozen_float(reference),
                    record_to=path.size,
                    attributes={"velocity": velocity, "travel": spec.travel},
                )
            )
    return result


def _check_below_nyquist(frequency: float, rate: float) -> None:
    # A tenth of the cycle rate: above it the zero-order hold and the delay of a cycle or two turn the
    # phase by more than a third of a turn, and a centring hold may no longer damp.
    if frequency > rate / 10:
        raise ConfigError(
            f"experiments: {frequency:g} Hz is above a tenth of the cycle rate ({rate / 10:g} Hz), the "
            "highest frequency to trust; shorten cycle_s or lower the band"
        )


WAY_OUT = (
    "shake all axes; where the cell has an accepted model, `invid measure --model MODEL.json --screen` tells "
    "in seconds what changed and shakes only that again"
)


def axes_left_out(config: CellConfig, axes: Sequence[str] | None) -> tuple[str, ...]:
    """Axes that an identification needs and a selection leaves out."""
    if axes is None:
        return ()
    return tuple(a.name for a in config.axes if a.name not in axes)


def subset_sentence(left_out: Sequence[str]) -> str:
    """Why a selection without these axes cannot yield a model."""
    some = ", ".join(left_out)
    one = len(left_out) == 1
    return (
        f"axis {some} would be held and not shaken: with one side of each coupling standing still neither "
        f"{'its' if one else 'their'} masses and springs nor the couplings can be identified"
    )


def require_all_axes(config: CellConfig, axes: Sequence[str] | None) -> None:
    """Raise ConfigError, before anything moves, where a selection of axes cannot yield a model."""
    names = {a.name for a in config.axes}
    if axes is None or not set(axes) <= names:
        return  # an unknown axis is the plan's to refuse
    left_out = axes_left_out(config, axes)
    if left_out:
        raise ConfigError(f"axes: {subset_sentence(left_out)}; {WAY_OUT}")
