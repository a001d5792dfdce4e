"""Line spectra of an experiment with the noise covariance that the recording itself reveals.

Periodic records are averaged over settled periods. Everything else (from rest, chirp, stepped sine,
one period) is taken whole: the discrete Fourier transform of the record, corrected for its end
points, together with the boundary terms that the fit adds (``transient``) is exact for any motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from weakref import WeakKeyDictionary

import numpy as np

from invid.numerics.arrays import Bool, Complex128, Float64, frozen, frozen_float
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.recording.plausibility import held_sentence
from invid.signals.encoder_interpolation import position_steps
from invid.signals.lines import band_of, driven_axes, excited_lines, held_torque, highest_excited, known_lines
from invid.signals.noise import (
    ENOUGH,
    NoisePlateau,
    flat_covariance,
    noise_plateau,
    pooled_covariance,
    quantisation_step,
    repeating_power,
    rounding_power,
    sensor_noise_share,
)
from invid.signals.periods import find_period, find_settled_periods, fold, nonrepeating_share, remove_drift
from invid.signals.timebase import UniformRecord, resample_uniformly

NOT_PERIODIC = 0.3
"""Non-repeating share of the variance above which a declared period is rejected (empirical): noise of half
the signal's power still passes, a wrong period gives about 1."""

FEW_LINES = 32
"""A period of fewer lines than this, still settling, tells its motion from its ends hardly or not at all: the
ends of N masses an axis are 2N numbers an axis, each line gives two. The lines of the whole record do."""


_CACHE: WeakKeyDictionary[Experiment, LineSpectra] = WeakKeyDictionary()
"""Cache of spectra by experiment (by identity; experiments do not change)."""


@dataclass(frozen=True, eq=False)
class LineSpectra:
    """Averaged spectra of one experiment on F lines (excited or not).

    Convention: X_k = (2/n) Σ_t x(t) e^{−jω_k t}, so that |X_k| is the amplitude of a sinusoid.

    Attributes
    ----------
    frequency_hz
        (F,) lines, ascending, without 0.
    position, torque
        (F, M) complex amplitudes [rad or m], [N·m or N], averaged over periods.
    covariance
        (F, 2M, 2M) complex covariance E[n nᴴ] of the *averaged* n = [position noise; torque noise].
    excited
        (F,) True on lines that the excitation drives.
    transient
        True where the record is not periodic steady state (from rest, aperiodic): fits must add the
        boundary terms of every coordinate (see ``docs/explanations/identification.md``).
    time, position_wave, torque_wave
        (n,), (n, M), (n, M): the averaged period (or the whole record), sampled uniformly: what
        effects are evaluated on.
    span_s
        Duration T over which the boundary terms are spread: Z Θ = T − (2/T)·Wᵀ(…) for the whole of
        the periods averaged, or the whole record.
    driven
        (M,) True for axes that the excitation drives in this experiment.
    staircase
        (M,) 1 where the torque is known to be held over each sample (it follows a recorded demand),
        0 where it is known to be continuous, NaN where the recording does not tell.
    """

    key: str
    role: Role
    frequency_hz: Float64
    position: Complex128
    torque: Complex128
    covariance: Complex128
    excited: Bool
    periods: int
    sample_rate_hz: float
    transient: bool
    time: Float64
    position_wave: Float64
    torque_wave: Float64
    warnings: tuple[str, ...] = field(default=())
    span_s: float = 0.0
    driven: Bool = field(default_factory=lambda: np.zeros(0, dtype=bool))
    staircase: Float64 = field(default_factory=lambda: np.zeros(0))
    floor: Float64 = field(default_factory=lambda: np.zeros(0))
    """(2M,) noise power of the averaged spectra from lines above the band, white quantisation included."""

    @property
    def omega(self) -> Float64:
        """(F,) lines [rad/s]."""
        result: Float64 = 2 * np.pi * self.frequency_hz
        return result

    @property
    def axis_count(self) -> int:
        """M."""
        return int(self.position.shape[1])


def all_spectra(recording: Recording, role: Role | None = None) -> tuple[LineSpectra, ...]:
    """Spectra of every experiment that shakes an axis, of one role or of both.

    Slow constant-velocity moves carry friction, not elasticity, and are left out. Identification and every
    look of the diagnosis ask for the same experiments: their spectra are kept as long as these are.
    """
    found = []
    for e in recording.experiments:
        if e.kind is Kind.CONSTANT_VELOCITY or (role is not None and e.role is not role):
            continue
        if e not in _CACHE:
            _CACHE[e] = spectra_of(e)
        found.append(_CACHE[e])
    return tuple(found)


def spectra_of(
    experiment: Experiment, *, band_hz: tuple[float, float] | None = None, drop_transient: bool = True
) -> LineSpectra:
    """Spectra on every line of the band.

    ``band_hz`` defaults to everything from the first line to one and a half times the highest
    excited line (at most 0.45 of the sample rate). ``drop_transient=False`` keeps every period.

    Raises
    ------
    RecordingError
        Too few samples, or time that does not increase.
    """
    data = resample_uniformly(experiment)
    warnings: list[str] = []
    held = held_sentence(experiment)
    if held is not None:
        warnings.append(
            f"experiment {experiment.key}: {held}; keep one row of each ('every' in an import map), else "
            f"masses "
            "come out far too small"
        )
    if data.lost:
        warnings.append(
            f"experiment {experiment.key}: {data.lost} of {data.samples} samples are missing"
            + (f", up to {data.longest_gap - 1} in a row" if data.longest_gap > 2 else "")
            + "; they were interpolated"
        )
    period = _verified_period(experiment, data, warnings)
    if period is None:
        return _whole_spectra(experiment, data, band_hz, warnings)
    found = _periodic_spectra(experiment, data, period, band_hz, drop_transient, warnings)
    if found.transient and found.frequency_hz.size < FEW_LINES and drop_transient:
        return _whole_spectra(experiment, data, band_hz, warnings)
    return found


def verified_period(experiment: Experiment) -> int:
    """Samples of the period that a record repeats, 0 where it repeats none; one whole period is believed."""
    declared = experiment.period_samples
    data = resample_uniformly(experiment)
    if declared > 0 and data.samples // declared == 1:
        return declared
    return _verified_period(experiment, data, []) or 0


def _verified_period(experiment: Experiment, data: UniformRecord, warnings: list[str]) -> int | None:
    """The period to use [samples]; the declared one is verified, never trusted."""
    declared = experiment.period_samples
    key = experiment.key
    if declared <= 0 or declared > data.samples:
        if declared > data.samples:
            warnings.append(
                f"experiment {key}: the declared period of {declared} samples is longer than the record "
                f"({data.samples} samples); it is used as one aperiodic record"
            )
        return None
    if data.samples // declared < 2:
        return None
    strongest = int(np.argmax(_rms_torque(experiment, data.torque)))
    share = float(nonrepeating_share(fold(data.torque[:, [strongest]], declared))[0])
    if share <= NOT_PERIODIC:
        return declared
    found = find_period(data.torque[:, strongest], data.samples // 2)
    if (
        found is not None
        and float(nonrepeating_share(fold(data.torque[:, [strongest]], found))[0]) < NOT_PERIODIC / 3
    ):
        warnings.append(
            f"experiment {key}: the declared period of {declared} samples does not repeat; the torque "
            f"repeats every {found} samples, which is used instead"
        )
        return found
    warnings.append(
        f"experiment {key}: the declared period of {declared} samples does not repeat ({share:.0%} of the "
        "torque changes from one to the next); the record is used as aperiodic"
    )
    return None


def _rms_torque(experiment: Experiment, torque: Float64) -> Float64:
    """(M,) rms torque without its mean; the excited axis first where it is named."""
    rms: Float64 = torque.std(axis=0)
    if 0 <= experiment.excited_axis < rms.size and rms[experiment.excited_axis] > 0:
        rms = rms * 1.0
        rms[experiment.excited_axis] = np.inf
    return rms


def _amplitudes(channels: Sequence[Float64], lines: int) -> Complex128:
    """(…, F, C) one-sided amplitudes of lines 1…F from C channels of (…, n) samples.

    Channel by channel, as everything here that is as long as the record: half an hour of six axes takes
    170 MB once, and would take it several times over.
    """
    count = channels[0].shape[-1]
    out = np.empty((*channels[0].shape[:-1], lines, len(channels)), dtype=np.complex128)
    for c, values in enumerate(channels):
        out[..., c] = np.fft.rfft(values, axis=-1)[..., 1 : lines + 1]
    out *= 2.0 / count
    return out


def _channels(*parts: Float64) -> list[Float64]:
    """The channels of (…, n, M) arrays, one after the other."""
    return [part[..., c] for part in parts for c in range(part.shape[-1])]


def _periodic_spectra(
    experiment: Experiment,
    data: UniformRecord,
    period: int,
    band_hz: tuple[float, float] | None,
    drop_transient: bool,
    warnings: list[str],
) -> LineSpectra:
    motors = data.position.shape[1]
    position = remove_drift(fold(data.position, period))
    torque = fold(data.torque, period)
    nyquist = (period - 1) // 2
    spectra = _amplitudes(_channels(position, torque), nyquist)
    hz = np.arange(1, nyquist + 1) / (period * data.step)
    top = highest_excited(experiment, hz, spectra)
    quiet = (hz > 1.5 * hz[top]) & (hz < 0.45 / data.step)
    if not quiet.any():
        quiet = hz > 0.9 * hz[-1]
    plateaus, floor, share = _noise_floor(data, quiet, hz, period)
    floor_dof = min(p.dof for p in plateaus)
    band = band_of(hz, top, band_hz)
    known = known_lines(experiment, hz, spectra, top)
    excited = None if known is None else known[: top + 1]
    settling = find_settled_periods(spectra[:, : top + 1], floor, floor_dof, excited)
    first = settling.first if drop_transient else 0
    if first:
        position = remove_drift(fold(data.position, period)[first:])
        del spectra
        spectra = _amplitudes(_channels(position, torque[first:]), nyquist)
    used = spectra.shape[0]
    mean = spectra.mean(axis=0)
    # Quantisation error of a motion that repeats exactly repeats too: the quiet lines of the mean show it,
    # the spread between periods does not. Of odd lines alone it is half-wave symmetric: all on odd lines.
    repeating = np.array([repeating_power(mean[:, c], p.lines(hz)) for c, p in enumerate(plateaus)])
    share_of_mean = sensor_noise_share(mean[None, quiet], hz[quiet], data.step) if settling.settled else share
    own = np.maximum(floor / used * share, repeating * share_of_mean)
    step = np.concatenate((position_steps(experiment, data.position), quantisation_step(data.torque)))
    single = sum(np.abs(one) ** 2 for one in spectra) / used
    rounding = _rounding_power(single, np.abs(mean) ** 2, step, band)
    floor = np.maximum(floor, step**2 / 12 * 4 / period)
    averaged = np.maximum(np.maximum(repeating, floor / used), 1e-300)
    deviations = spectra[:, band] - mean[band]
    del spectra
    least = np.maximum(np.maximum(floor, averaged * used), rounding * used)
    covariance = pooled_covariance(deviations, least)
    if known is None:
        excited = excited_lines(experiment, hz[band], mean[band], covariance, motors, period * data.step)
    else:
        excited = known[band]
    floor = np.maximum(np.maximum(own, step**2 / 12 * 4 / period / used), 1e-300)
    lines = _Lines(hz[band], mean[band], covariance, excited, floor)
    wave = np.concatenate((position.mean(0), torque[first:].mean(0)), axis=1)
    found = _assemble(experiment, lines, wave, data.step, used)
    return replace(found, transient=not settling.settled, warnings=tuple(warnings))


def _whole_spectra(
    experiment: Experiment, data: UniformRecord, band_hz: tuple[float, float] | None, warnings: list[str]
) -> LineSpectra:
    """The whole record, end points corrected: Σ x e^{−jωt} h + h (x_n − x_0)/2 is the integral to O(h²)."""
    motors = data.position.shape[1]
    count = data.samples - 1
    wave = np.concatenate((data.position, data.torque), axis=1)
    channels = _channels(wave[:count])
    # A constant and a slope carry no line of their own; without them the ends and leakage are small.
    nyquist = (count - 1) // 2
    mean = _amplitudes(channels, nyquist)
    ends = (wave[count] - wave[0]) / count
    staircase = held_torque(experiment)
    held = np.concatenate((np.zeros(motors), np.nan_to_num(staircase, nan=0.0)))
    mean += ends * (1.0 - held)
    hz = np.arange(1, nyquist + 1) / (count * data.step)
    if is_integrated_velocity(experiment):
        mean[:, :motors] = _position_of_velocity(data.position, data.step, hz)
    top = highest_excited(experiment, hz, mean[None])
    quiet = (hz > 1.5 * hz[top]) & (hz < 0.45 / data.step)
    if quiet.sum() < 16:
        quiet = hz > 0.9 * hz[-1]
    single = np.empty((nyquist, 2 * motors))
    plateaus, share = _quiet_noise([wave[:count]], hz, quiet, data.step, single)
    floor = np.array([p.level for p in plateaus]) * share
    step = np.concatenate((position_steps(experiment, data.position), quantisation_step(data.torque)))
    band = band_of(hz, top, band_hz)
    rounding = _rounding_power(single, single, step, band)
    floor = np.maximum(np.maximum(floor, step**2 / 12 * 4 / count), 1e-300)
    if is_integrated_velocity(experiment):
        # White noise of a velocity is noise ∝ 1/ω of its integral; the quiet lines tell its level there.
        drift = (np.median(hz[quiet]) / hz[band])[:, None] ** 2
        rounding[:, :motors] = np.maximum(rounding[:, :motors], floor[:motors] * drift)
    covariance = flat_covariance(np.maximum(floor, rounding), int(band.sum()))
    excited = excited_lines(experiment, hz[band], mean[band], covariance, motors, count * data.step)
    lines = _Lines(hz[band], mean[band], covariance, excited, floor)
    return replace(_assemble(experiment, lines, wave[:count], data.step, 1), warnings=tuple(warnings))


def is_integrated_velocity(experiment: Experiment) -> bool:
    """Return whether the record has no position but the running sum of a velocity."""
    return bool(experiment.attributes.get("position_source") == "integrated_velocity")


def _position_of_velocity(position: Float64, step: float, hz: Float64) -> Complex128:
    """(F, M) position on the lines from a position (n, M) that is the running sum of a measured velocity.

    A running sum is no integral near half the sampling rate; the velocity that was summed up has exact lines.
    The jumps of position and velocity between the record's ends count as sampling shows them, which is how
    the boundary terms expect them: Σ 1/(ω + kω_s) = (h/2)/tan(ωh/2), Σ 1/(ω + kω_s)² = (h/2)²/sin²(ωh/2).
    """
    velocity = np.diff(position, axis=0) / step
    velocity = np.concatenate((velocity, velocity[-1:]))  # the last one is in no sum
    count = velocity.shape[0] - 1
    omega = 2 * np.pi * hz[:, None]
    first_sum = (step / 2) / np.tan(omega * step / 2)
    second_sum = ((step / 2) / np.sin(omega * step / 2)) ** 2
    faster = (velocity[count] - velocity[0]) * (2.0 / (count * step))
    displacement = 2.0 * velocity[:count].mean(axis=0) + 0.5 * step * faster
    smooth = _amplitudes(_channels(velocity[:count]), hz.size) + 0.5 * step * faster - 1j * faster * first_sum
    out: Complex128 = smooth / (1j * omega) + 1j * displacement * first_sum + faster * second_sum
    return out


def _noise_floor(
    data: UniformRecord, quiet: Bool, hz: Float64, period: int
) -> tuple[list[NoisePlateau], Float64, Float64]:
    """The noise of the whole record above the band, (2M,) its power on a line of one period, and the sensors'
    own share of it; windowed, for what is left of a transient leaks there otherwise."""
    count = data.samples
    lines = (count - 1) // 2
    fine = np.arange(1, lines + 1) / (count * data.step)
    band = hz[quiet]
    inside = (fine >= band[0]) & (fine <= band[-1]) if band.size else fine > 0.9 * fine[-1]
    plateaus, share = _quiet_noise([data.position, data.torque], fine, inside, data.step)
    return plateaus, np.array([p.level for p in plateaus]) * (count / period), share


def _rounding_power(single: Float64, mean: Float64, step: Float64, band: Bool) -> Float64:
    """(F, 2M) power of the encoders' rounding on the lines of the band; torque steps are taken as white."""
    motors = step.size // 2
    last = int(np.flatnonzero(band)[-1]) + 1
    power = np.zeros((int(band.sum()), 2 * motors))
    power[:, :motors] = rounding_power(single[:, :motors], mean[:, :motors], step[:motors], last)[band[:last]]
    return power


def _quiet_noise(
    parts: Sequence[Float64], hz: Float64, quiet: Bool, step: float, single: Float64 | None = None
) -> tuple[list[NoisePlateau], Float64]:
    """The noise of (n, …) samples of 2M channels from their ``quiet`` lines, and (2M,) the sensors' own share
    of it; through a window that lets nothing leak into them. ``single`` (F, 2M) gets the power of every line.
    """
    channels, means = _channels(*parts), np.concatenate([part.mean(axis=0) for part in parts])
    every = max(int(quiet.sum()) // ENOUGH, 1)
    plateaus, kept = list[NoisePlateau](), []
    for c, values in enumerate(channels):
        windowed = _windowed_spectrum(values - means[c], hz.size)
        plateaus.append(noise_plateau(np.abs(windowed[quiet]) ** 2, hz[quiet]))
        if single is not None:
            single[:, c] = np.abs(windowed) ** 2
        kept.append(windowed[quiet][::every].copy())  # or a view keeps all of it
    share = sensor_noise_share(np.stack(kept, axis=1)[None], hz[quiet][::every], step)
    return plateaus, share


def _windowed_spectrum(values: Float64, lines: int) -> Complex128:
    """(lines,) spectrum of (n,) samples through a Blackman window of unit noise gain: lines do not leak."""
    window = np.blackman(values.size)
    window = window / np.sqrt(np.mean(window**2))
    return _amplitudes([values * window], lines)[:, 0]


@dataclass(frozen=True, eq=False)
class _Lines:
    """What the lines of the band hold, as in ``LineSpectra``; ``mean`` (F, 2M) are both channels."""

    hz: Float64
    mean: Complex128
    covariance: Complex128
    excited: Bool
    floor: Float64


def _assemble(experiment: Experiment, lines: _Lines, wave: Float64, step: float, periods: int) -> LineSpectra:
    """The spectra of a record that does not repeat; ``wave`` (n, 2M) is its period or all of it."""
    motors, omega = wave.shape[1] // 2, 2 * np.pi * lines.hz
    position, torque = lines.mean[:, :motors], lines.mean[:, motors:]
    driven = driven_axes(experiment.excited_axis, position, torque, omega, lines.excited, lines.floor)

    def fixed(values: Complex128) -> Complex128:
        return frozen(values, np.complex128)  # type: ignore[return-value]

    return LineSpectra(
        key=experiment.key,
        role=experiment.role,
        frequency_hz=frozen_float(lines.hz),
        position=fixed(position),
        torque=fixed(torque),
        covariance=fixed(lines.covariance),
        excited=frozen(lines.excited, np.bool_),  # type: ignore[arg-type]
        periods=periods,
        sample_rate_hz=1.0 / step,
        transient=True,
        time=frozen_float(np.arange(wave.shape[0]) * step),
        position_wave=frozen_float(wave[:, :motors]),
        torque_wave=frozen_float(wave[:, motors:]),
        span_s=periods * wave.shape[0] * step,
        driven=frozen(driven, np.bool_),  # type: ignore[arg-type]
        staircase=frozen_float(held_torque(experiment)),
        floor=frozen_float(lines.floor),
    )
