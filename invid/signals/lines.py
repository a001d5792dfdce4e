"""Which lines of a record carry its excitation, which axes it drives, and whether its torque is held."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Bool, Complex128, Float64
from invid.numerics.linear_algebra import real_rows
from invid.recording.model import Experiment, Kind


def highest_excited(experiment: Experiment, hz: Float64, spectra: Complex128) -> int:
    """Index of the highest line that carries signal."""
    declared = experiment.frequencies_hz[np.isfinite(experiment.frequencies_hz)]
    declared = declared[(declared > 0) & (declared <= hz[-1])]
    if declared.size:
        return int(np.argmin(np.abs(hz - declared.max())))
    motors = spectra.shape[2] // 2
    power = (np.abs(spectra[..., motors:].mean(axis=0)) ** 2).sum(axis=1)
    return _last_of_power(power)


def _last_of_power(power: Float64) -> int:
    """Index of the line (F,) up to which all but a thousandth of the power lies."""
    cumulative = np.cumsum(power) / max(float(power.sum()), 1e-300)
    return int(np.searchsorted(cumulative, 0.999).clip(0, power.size - 1))


def band_of(hz: Float64, top: int, band_hz: tuple[float, float] | None) -> Bool:
    low, high = (0.0, min(1.5 * hz[top], 0.9 * hz[-1])) if band_hz is None else band_hz
    band: Bool = (hz >= low) & (hz <= max(high, hz[0]))
    return band


def declared_lines(experiment: Experiment, hz: Float64, duration: float) -> Bool | None:
    """(F,) lines of a multisine that the recording declares; ``None`` where it declares none."""
    declared = experiment.frequencies_hz[np.isfinite(experiment.frequencies_hz)]
    if not declared.size or experiment.kind is not Kind.MULTISINE:
        return None
    excited: Bool = np.zeros(hz.size, dtype=bool)
    nearest = np.round(declared * duration).astype(int)
    first = round(float(hz[0] * duration))
    inside = (nearest >= first) & (nearest < first + hz.size)
    excited[nearest[inside] - first] = True
    return excited


LEAST_KNOWN = 16
"""Lines of a multisine from which they stand for all: what settles between fewer may pass them (a guess)."""
NEIGHBOURS, LOW_SHARE = 20, 0.3
"""Lines on each side of one that it is compared with, and the quantile of their power: where odd lines alone
are driven, half of all are weak."""
STANDS_OUT = 30.0
"""Power over that quantile from which a line is one of few that are driven (statistical): a line of random
torque exceeds it once in forty thousand."""
SPARSE_POWER = 0.95
"""Share of the torque's power that such lines hold where a command was designed (empirical): what a machine
makes of it beside its lines is at most a tenth of it in amplitude."""


def known_lines(experiment: Experiment, hz: Float64, spectra: Complex128, top: int) -> Bool | None:
    """(F,) lines of a periodic multisine: as declared, or those few that hold its torque up to the line
    ``top``, from the spectra (P, F, 2M) of its periods; ``None`` where neither tells."""
    declared = declared_lines(experiment, hz, 1.0 / float(hz[0]))
    if declared is not None:
        return declared if declared[: top + 1].sum() >= LEAST_KNOWN else None
    sparse = _sparse_lines(spectra[:, : top + 1, spectra.shape[2] // 2 :].mean(axis=0))
    return None if sparse is None else np.concatenate((sparse, np.zeros(hz.size - sparse.size, dtype=bool)))


def _sparse_lines(torque: Complex128) -> Bool | None:
    """(F,) lines of a multisine that skips lines, from the torque (F, M) on all lines of its period.

    What is not linear shows on the lines between, far above the noise: taken for excited, 1,928 lines of a
    real arm stood for 203. ``None`` where no few lines hold all.
    """
    power = np.abs(torque) ** 2
    if power.shape[0] < 4 * NEIGHBOURS:
        return None
    padded = np.pad(power, ((NEIGHBOURS, NEIGHBOURS), (0, 0)), mode="reflect")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1, axis=0)
    stands = power > STANDS_OUT * np.quantile(around, LOW_SHARE, axis=-1)
    held = stands.sum(axis=0) >= LEAST_KNOWN
    held &= np.where(stands, power, 0.0).sum(axis=0) > SPARSE_POWER * power.sum(axis=0)
    # An axis that is only held shows the distortions of the others as much as their lines.
    strongest = int(np.argmax(power.sum(axis=0)))
    if not held[strongest]:
        return None
    found: Bool = stands[:, held].any(axis=1)
    found[_last_of_power(np.where(found, power[:, strongest], 0.0)) + 1 :] = False
    return found


def excited_lines(
    experiment: Experiment,
    hz: Float64,
    mean: Complex128,
    covariance: Complex128,
    motors: int,
    duration: float,
) -> Bool:
    """(F,) lines that the excitation drives: as declared, or by a test of every line's torque."""
    declared = declared_lines(experiment, hz, duration)
    if declared is not None:
        return declared
    power = np.abs(mean[:, motors:]) ** 2
    noise = np.einsum("fcc->fc", covariance).real[:, motors:]
    # |X|²/σ² is exponential for noise: exceeded once in 1e4 lines; a thousandth of the strongest
    # line's power is no excitation either, but distortion or leakage.
    limit = np.maximum(noise * np.log(1e4), 1e-4 * power.max(axis=0))
    above: Bool = (power > limit).any(axis=1)
    return above


def held_torque(experiment: Experiment) -> Float64:
    """(M,) 1 where the torque repeats a recorded demand, delayed by whole samples; NaN unknown."""
    motors = np.asarray(experiment.torque).shape[1]
    result = np.full(motors, np.nan)
    if experiment.torque_demand is None:
        return result
    demand = np.asarray(experiment.torque_demand)
    torque = np.asarray(experiment.torque)
    for i in range(motors):
        spread = demand[:, i].std()
        if spread <= 1e-9 * max(np.abs(torque[:, i]).max(), 1e-300):
            continue
        for lag in range(4):
            error = torque[lag:, i] - demand[: demand.shape[0] - lag, i]
            # Following to a tenth is a staircase with noise; a filtered torque or one with a hold
            # added inside the drive differs by more over a whole sample of delay.
            if error.std() < 0.1 * spread:
                result[i] = 1.0
                break
    return result


HELD = 0.01
"""Share of an axis' torque power that a hold law may leave: a driven axis' torque is the plant's, with
resonances that no −(P + jωD)θ has. A guess; beside it, noise."""
LINES = 8
"""Lines that a hold law is judged on at least: on fewer, anything is −(P + jωD)θ."""
DECADE = 2.0
"""Ratio of the highest to the lowest of these lines: in a narrow band a driven mass, −ω²mθ, is like a
spring."""


def driven_axes(
    excited_axis: int, position: Complex128, torque: Complex128, omega: Float64, excited: Bool, floor: Float64
) -> Bool:
    """(M,) axes that the excitation drives: the one that is named, or all but those that are only held.

    Where none is named (−1) an axis whose recorded torque is −(P + jωD)·position with P and D ≥ 0 is held,
    not driven: a hold takes power out of the machine. ``position`` and ``torque`` are (F, M), ``floor`` is
    (2M,).
    """
    motors = torque.shape[1]
    if 0 <= excited_axis < motors:
        driven: Bool = np.arange(motors) == excited_axis
        return driven
    w = omega[excited]
    if motors == 1 or w.size < LINES or w.max() < DECADE * w.min():
        return np.ones(motors, dtype=bool)
    loudest = int(
        np.argmax(np.sum(np.abs(torque[excited]) ** 2, axis=0) / np.maximum(floor[motors:], 1e-300))
    )
    held = [
        i != loudest and _only_held(w, position[excited, i], torque[excited, i], floor[[i, motors + i]])
        for i in range(motors)
    ]
    return ~np.array(held)


def _only_held(omega: Float64, position: Complex128, torque: Complex128, floor: Float64) -> bool:
    """Return whether one axis' torque is that of a hold, by least squares of −(P + jωD)θ."""
    power = float(np.sum(np.abs(torque) ** 2))
    # The mean power of noise lines has a relative error of 1/√lines; five times it is no noise.
    if power < 5.0 * torque.size * float(floor[1]):
        return False
    rows = np.stack((-position, -1j * omega * position), axis=1)
    both, goal = real_rows(rows), real_rows(torque)
    law = np.linalg.lstsq(both, goal, rcond=None)[0]
    left = float(np.sum((goal - both @ law) ** 2))
    stiffness = float(law[0] ** 2 + np.mean(omega**2) * law[1] ** 2)
    noise = torque.size * (float(floor[1]) + stiffness * float(floor[0]))
    return bool(law[0] > 0 and law[1] >= 0 and left < max(HELD * power, 3.0 * noise) and left < 0.5 * power)
