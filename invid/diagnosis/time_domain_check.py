"""The extended model simulated over time on the held-out records: a check by other equations than the fit's.

The regression that names a cause works on lines and takes inner motion from the model. Here the extended
model is integrated over time from the torque alone (``invid.simulate``), and the difference between its
record and the measured one is expressed as torque again, r = Z(Θ − Θ_sim) − A(T − T_sim): comparable line by
line with the residual of the regression and with the noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from invid.diagnosis.thresholds import CONTESTED
from invid.effects.motion import View
from invid.effects.registry import effects_of_plant
from invid.errors import InvidError
from invid.likelihood.evaluation import Evaluation, evaluate, record_views
from invid.likelihood.joint_fit import JointFit
from invid.likelihood.nuisance.transients import jump_response
from invid.likelihood.null_test import rms_torque
from invid.likelihood.placed_effect import Candidate
from invid.model.diagnosis_document import Diagnosis
from invid.model.document import Model
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.parallel import parallel_map
from invid.numerics.whitening import orthonormal, stack, unstack, unwhitener
from invid.recording.model import Experiment, Recording
from invid.signals.periods import fold, remove_drift
from invid.signals.spectra import LineSpectra, spectra_of
from invid.signals.spectral_record import SpectralRecord
from invid.signals.timebase import resample_uniformly
from invid.simulation.run import simulate

REFUSED = (
    "simulated over time on held-out data the extended model gains no more than the uncertainty of that "
    "gain: the extension is refused"
)
MOTION_LOST = (
    "simulated over time the motion ends among other ripples than the measured one, at the least difference: "
    "the extension is judged by the missing torque alone"
)
AGREEMENT = 2.0
"""Factor over the residual of the regression, or the noise, that the simulation over time may leave.
Empirical (hidden plants): it leaves 1.0 to 1.5 times either; more means that one of the two has the physics
wrong."""

TRAINING_WEIGHT = 0.01
"""Weight of the training records beside the simulated ones where the two methods are compared. Empirical: ten
standard deviations of the training fit cost one, so the held-out records decide where they can."""


@dataclass(frozen=True, eq=False)
class Replay:
    """Residual of the simulation over time on the held-out records.

    ``torque_after`` (M,) [N·m or N] missing torque between the simulated and the measured record;
    ``position_before``, ``position_after`` (M,) [rad or m] rms error of the simulated motion with the linear
    and with the extended model, ``motion`` (M,) rms of the measured one about its mean, ``reach`` (M,) the
    error up to which the forces are the same. ``gain`` is the decrease of χ², ``std`` its standard deviation.
    """

    keys: tuple[str, ...]
    torque_after: Float64
    position_before: Float64
    position_after: Float64
    motion: Float64
    reach: Float64
    gain: float
    std: float
    linear: Recording
    extended: Recording
    shift: Float64 = field(default_factory=lambda: np.zeros(0))
    """(n,) change of every parameter of the fit that would agree with the simulation over time."""

    @property
    def is_refused(self) -> bool:
        """Whether the gain is smaller than its own standard deviation."""
        return not self.gain > self.std

    @property
    def is_lost(self) -> bool:
        """Whether the simulated motion of an axis is too far off to judge the law.

        Farther off than the measured one moves, or so far that a ripple found there acts in another
        direction: a soft axis among ripples ends in another one at the least difference.
        """
        return bool((self.position_after > self.reach).any())

    def to_json(self, recording: Recording) -> dict[str, Any]:
        """Entry ``details.replay`` of the document."""
        return {
            "experiments": list(self.keys),
            "gain_chi2": self.gain,
            "gain_std": self.std,
            "axes": [
                {
                    "axis": axis,
                    "torque_after": float(self.torque_after[i]),
                    "torque_unit": recording.torque_unit,
                    "position_before": float(self.position_before[i]),
                    "position_after": float(self.position_after[i]),
                    "motion": float(self.motion[i]),
                    "position_unit": recording.position_unit,
                }
                for i, axis in enumerate(recording.axes)
            ],
        }


def simulate_held_out(
    recording: Recording,
    spectra: Sequence[LineSpectra],
    linear: Model,
    extended: Model,
    fitted: JointFit,
    held: Sequence[SpectralRecord],
) -> Replay | str:
    """Both models simulated on the held-out records; a sentence where that cannot be done.

    ``fitted`` gives Z and A of the extended model. Both models are simulated, so the noise of the torque that
    drives a simulation and the ends of the records are in both residuals. Compared with the regression of the
    linear model instead, an effect of half the noise was refused.
    """
    keys = tuple(dict.fromkeys(r.key for r in held))
    # Lost rows were interpolated before anything was fitted.
    plant_model = replace(extended, effects=effects_of_plant(extended.effects))
    views = record_views(fitted.layout, held, fitted.p)
    driven = _with_acting_torque(recording, spectra, views)
    try:
        models = [_without_offsets(m) for m in (linear, plant_model)]
        plain, answer = parallel_map(lambda m: simulate(m, driven, only=keys), models, known=[driven])
    except InvidError as error:
        return f"the extended model could not be simulated over time: {error}"
    evaluation = _residual_of_simulation(answer, spectra, views, fitted)
    before = _residual_of_simulation(plain, spectra, views, fitted)
    if evaluation is None or before is None:
        return "the held-out records are not whole: the extension was not simulated over time"
    shift = _parameter_shift(fitted, held, evaluation)
    gain = before.cost - evaluation.cost
    # χ² of two residuals with the same noise differs by ‖d‖² ± 2‖d‖, d their whitened difference.
    spread = max(1.0, evaluation.cost / max(evaluation.dof, 1))
    measured = [e for e in recording.experiments if e.key in keys]
    motion = np.sqrt(np.mean([e.position.var(axis=0) for e in measured], axis=0))
    return Replay(
        keys=keys,
        torque_after=np.array([rms_torque(evaluation, i)[0] for i in range(recording.axis_count)]),
        position_before=_rms_error(measured, plain),
        position_after=_rms_error(measured, answer),
        motion=motion,
        reach=np.minimum(motion, _ripple_reach(extended)),
        gain=gain,
        std=float(2.0 * np.sqrt(abs(gain) * spread)),
        linear=plain,
        extended=answer,
        shift=shift,
    )


def _ripple_reach(model: Model) -> Float64:
    """(M,) a third of a radian of the finest ripple of each axis [rad]; infinite where there is none.

    Farther away the force is no longer that at the measured motion plus a linear term; its error there is a
    twentieth.
    """
    out = np.full(len(model.axes), np.inf)
    for effect in model.effects:
        if "cycles_per_rev" in effect.parameters:
            at = model.axes.index(effect.axis)
            out[at] = min(out[at], 1.0 / 3.0 / effect.parameters["cycles_per_rev"].value)
    return out


def _residual_of_simulation(
    answer: Recording, spectra: Sequence[LineSpectra], views: Sequence[View], fitted: JointFit
) -> Evaluation | None:
    """Residual between the held-out records and a simulation of them, as torque; ``None`` where lines do not
    match."""
    left = _difference_records(answer, spectra, views)
    if left is None:
        return None
    structure = fitted.layout.structure
    sampled = replace(
        fitted.layout,
        free_delays=(),
        free_zoh=(),
        known_zoh=np.zeros(structure.motors),
        holds=(),
        smoothed=(),
    )
    evaluation = evaluate(sampled, left, fitted.p[: structure.count], Candidate(), jacobian=False)
    return _remove_mode_transients(evaluation, fitted.candidate)


def _parameter_shift(fitted: JointFit, held: Sequence[SpectralRecord], replayed: Evaluation) -> Float64:
    """(n,) Gauss–Newton step of all parameters from the residual of the regression to that of the simulation.

    The noise is the same in both, so the step is the disagreement of two methods and not chance. The training
    records, which were not simulated, keep only what the held-out ones do not determine.
    """
    own = evaluate(fitted.layout, held, fitted.p, fitted.candidate)
    train_jacobian = fitted.evaluation.jacobian
    scale = np.linalg.norm(train_jacobian, axis=0)
    scale[scale == 0] = 1.0
    train_jacobian = train_jacobian / scale
    normal = TRAINING_WEIGHT * train_jacobian.T @ train_jacobian
    slope = np.zeros(scale.size)
    at = 0
    for view, basis in zip(own.views, replayed.bases, strict=True):
        rows = slice(at, at + 2 * view.acting.size)
        jacobian, residual = own.jacobian[rows] / scale, own.residual[rows]
        jacobian = jacobian - basis @ (basis.T @ jacobian)
        residual = residual - basis @ (basis.T @ residual)
        slope += jacobian.T @ (replayed.residual[rows] - residual)
        normal += jacobian.T @ jacobian
        at = rows.stop
    out: Float64 = -np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ slope / scale
    return np.where(np.isfinite(out), out, 0.0)


def add_time_domain_check(
    result: Diagnosis, answer: Replay | str, recording: Recording, *, is_lost: bool = False
) -> Diagnosis:
    """The diagnosis with the result of the simulation over time; ``is_lost``: its motion judges nothing."""
    if isinstance(answer, str):
        return replace(result, warnings=(*result.warnings, answer))
    details = {**result.details, "replay": answer.to_json(recording)}
    result = replace(result, details=details)
    if answer.is_refused and not result.findings:
        return result
    doubtful = [
        r
        for r, torque in zip(result.residual, answer.torque_after, strict=True)
        if torque > AGREEMENT * max(r.after, r.floor) and torque > 0.1 * r.before
    ]
    if not doubtful and not is_lost:
        return result
    warning = (
        "simulated over time the extended model leaves more on "
        + ", ".join(r.axis for r in doubtful)
        + " than the regression that named the cause: the size of the cause or its place may be wrong"
    )
    return replace(
        result,
        warnings=(*result.warnings, MOTION_LOST if is_lost else warning),
        findings=tuple(replace(f, confidence=min(f.confidence, CONTESTED)) for f in result.findings),
    )


def _remove_mode_transients(evaluation: Evaluation, candidate: Candidate) -> Evaluation:
    """The evaluation without the transient of extra modes and of a base from the state in which the
    simulation started them.

    The mode's own coordinate starts and ends somewhere as every coordinate of the chains does, but is none of
    them: a jump Δx and Δẋ of it over the record is two real unknowns of each record and mode.
    """
    residual, missing, at = evaluation.residual.copy(), list(evaluation.missing), 0
    for number, (view, root, basis) in enumerate(
        zip(evaluation.views, evaluation.roots, evaluation.bases, strict=True)
    ):
        plant = 2 * view.base.shape[1]
        none = np.zeros((*view.base.shape, plant), dtype=complex)
        columns = jump_response(view, candidate, none)[0][..., plant:]
        if not columns.shape[-1]:
            return evaluation
        part = stack(root @ columns)
        jumps = orthonormal(part - basis @ (basis.T @ part))
        rows = slice(at, at + part.shape[0])
        transient = jumps @ (jumps.T @ residual[rows])
        residual[rows] -= transient
        missing[number] = missing[number] - unstack(unwhitener(root), transient, missing[number].shape)
        at = rows.stop
    seen = tuple(replace(s, missing=m) for s, m in zip(evaluation.parts, missing, strict=True))
    return replace(evaluation, residual=residual, parts=seen, cost=float(residual @ residual))


def _rms_error(measured: Sequence[Experiment], simulated: Recording) -> Float64:
    found: Float64 = np.sqrt(
        np.mean(
            [
                np.mean((s.position - e.position) ** 2, axis=0)
                for e, s in zip(measured, simulated.experiments, strict=True)
            ],
            axis=0,
        )
    )
    return found


def _without_offsets(model: Model) -> Model:
    """The model without time offsets: the drive is given the torque as it acts."""
    return replace(model, fit={**model.fit, "time_offset_s": {}})


def _with_acting_torque(
    recording: Recording, spectra: Sequence[LineSpectra], views: Sequence[View]
) -> Recording:
    """The recording with the torque as it acts, A·T: delayed, held over the sample, holds inside the
    drives."""
    known = {s.key: s for s in spectra}
    waves: dict[str, Float64] = {}
    for view in views:
        record = view.record
        waves[record.key] = wave_from_amplitudes(
            view.acting + view.images - record.torque, record, known[record.key]
        )
    return add_torque(recording, spectra, waves)


def wave_from_amplitudes(lines: Complex128, record: SpectralRecord, s: LineSpectra) -> Float64:
    """(period, M) wave of (F, M) amplitudes at the sampling instants, without its mean."""
    period = s.position_wave.shape[0]
    half = np.zeros((period // 2 + 1, lines.shape[1]), dtype=complex)
    half[record.lines[1:]] = lines[1:] * (period / 2)
    out: Float64 = np.fft.irfft(half, period, axis=0)
    return out


def add_torque(
    recording: Recording, spectra: Sequence[LineSpectra], waves: Mapping[str, Float64]
) -> Recording:
    """The recording with waves (period, M) added to the torque of the experiments with these keys."""
    known = {s.key: s for s in spectra}
    experiments = []
    for e in recording.experiments:
        change = waves.get(e.key)
        if change is None:
            experiments.append(e)
            continue
        step = float(e.time[-1] - e.time[0]) / max(resample_uniformly(e).samples - 1, 1)
        # Periods are counted from the end of the record.
        phase = (e.time - e.time[-1]) / step - 1.0
        if known[e.key].periods <= 1 and known[e.key].transient:
            phase = (e.time - e.time[0]) / step
        whole = np.arange(change.shape[0] + 1)
        closed = CubicSpline(whole, np.concatenate((change, change[:1])), bc_type="periodic")
        experiments.append(replace(e, torque=e.torque + closed(np.mod(phase, change.shape[0]))))
    return replace(recording, experiments=tuple(experiments))


def _difference_records(
    answer: Recording, spectra: Sequence[LineSpectra], views: Sequence[View]
) -> list[SpectralRecord] | None:
    """Records of measured minus simulated motion and torque as it acts; ``None`` where the lines do not
    match."""
    known = {s.key: s for s in spectra}
    out = []
    for view in views:
        record = view.record
        motors = record.torque.shape[1]
        simulated = next(e for e in answer.experiments if e.key == record.key)
        lines = _lines_of_simulation(simulated, known[record.key], record)
        if lines is None:
            return None
        position = record.position - lines[:, :motors]
        position[0] = 0.0
        out.append(
            replace(
                record,
                position=position,
                torque=view.acting + view.images - lines[:, motors:],
                command=None,
                # Recorded torque noise acts in the simulation, so its motion does not close over the record.
                transient=True,
            )
        )
    return out


def _lines_of_simulation(simulated: Experiment, s: LineSpectra, record: SpectralRecord) -> Complex128 | None:
    """(F, 2M) amplitudes of a simulated experiment on the lines and over the periods of a measured record.

    Not by ``spectra_of``: a simulation has no noise, so it would be judged settled at another period.
    """
    data = resample_uniformly(simulated)
    period = s.position_wave.shape[0]
    if s.periods <= 1 and s.transient:
        own = spectra_of(simulated)
        if not np.array_equal(own.frequency_hz, s.frequency_hz):
            return None
        wave = np.concatenate((own.position_wave, own.torque_wave), axis=1)
        rest = np.concatenate((own.position, own.torque), axis=1)[: record.omega.size - 1]
    else:
        if s.periods * period > data.samples:
            return None
        position = remove_drift(fold(data.position, period)[-s.periods :])
        torque = fold(data.torque, period)[-s.periods :]
        both = np.concatenate((position, torque), axis=2)
        if record.alone:
            first = float(simulated.time[-1]) - s.periods * record.period_time
            at = round((record.start_time - first) / record.period_time)
            both = both[[int(np.clip(at, 0, s.periods - 1))]]
        wave = both.mean(axis=0)
        rest = np.fft.rfft(wave, axis=0)[record.lines[1:]] * (2.0 / period)
    found: Complex128 = np.concatenate((wave.mean(axis=0)[None].astype(complex), rest))
    return found
