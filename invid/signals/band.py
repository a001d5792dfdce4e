"""The band in which a record speaks of its machine: where its torque stands above noise, and up to twice the
highest resonance.

Above its resonances a machine is its motor alone: torque over acceleration is level there. Those lines tell
its inertia again and again, while fits that start in so wide a band do not find the resonances far below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.numerics.arrays import Bool, Complex128, Float64
from invid.recording.model import Experiment

ABOVE = 6.0
"""Power over noise from which lines, averaged over half a hertz, are excited."""
RATIO = 1.12
"""Upper over lower edge of the bands in which inertia is read."""
LEAST_LINES = 6
"""Lines of a band."""
LEVEL = 0.15
"""Logarithm of the inertia up to which it is level: at twice a resonance that has its antiresonance a third
below it has come within an eighth of the motor's."""
COHERENT = 0.5
"""Squared coherence of a band that is read."""
BEYOND = 2.6
"""Band over the highest frequency at which the inertia is not level (empirical: 24 axes of other hands)."""
FEWEST, FEWEST_BANDS = 60, 4
"""Lines that the band of a record has at least, and bands in which its inertia has to be seen."""


def excited_band(experiment: Experiment, frequency: Float64, torque: Complex128) -> float:
    """Highest frequency [Hz] that is excited: as stated, else where torque (F, M) stands above its noise, a
    tenth added."""
    if experiment.frequencies_hz.size:
        return float(np.max(experiment.frequencies_hz))
    nyquist = float(frequency[-1])
    power = (np.abs(torque) ** 2).mean(axis=1)
    noise = float(np.median(power[frequency > 0.3 * nyquist])) / np.log(2.0)
    width = max(3, round(0.5 / float(frequency[1])))
    mean = np.convolve(power, np.ones(width) / width, "same")
    above = np.flatnonzero((mean > ABOVE * noise) & (frequency < 0.4 * nyquist))
    return float(min(1.1 * frequency[above[-1]], 0.4 * nyquist)) if above.size else 0.1 * nyquist


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
CARRIED = 0.999
"""Share of their power up to which they count."""


def sparse_lines(torque: Complex128) -> Bool | None:
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
    total = np.cumsum(np.where(found, power[:, strongest], 0.0))
    found &= total - np.where(found, power[:, strongest], 0.0) < CARRIED * total[-1]
    return found


def elastic_band(
    frequency: Float64, position: Complex128, torque: Complex128, driven: Bool, excited: float
) -> float:
    """Highest frequency [Hz] of interest: well above that at which a driven motor (M,) is not yet alone, and
    not above that to which torque and motion are coherent.

    Beyond it there is the encoder's noise alone, which the missing torque shows as large as |Z| is: a plant
    with a small |Z| would seem to miss less. Lines (F, M) of position and torque are those of whole spans; a
    Hann window is put over them here, which takes the ends of a record away.
    """
    within = int(np.searchsorted(frequency, excited))
    lines = frequency[:within], position[None, :within], torque[None, :within]
    tops = [
        _own_band(frequency[within - 1], apparent_inertia(*lines, int(m))) for m in np.flatnonzero(driven)
    ]
    least = frequency[min(FEWEST, within - 1)]
    return float(np.clip(max(tops, default=excited), least, excited))


@dataclass(frozen=True, eq=False)
class ApparentInertia:
    """Torque over acceleration (B,) of a motor in bands about ``frequency`` (B,) [Hz], where the two are
    coherent; ``scatter`` (B,) of its logarithm."""

    frequency: Float64
    inertia: Float64
    scatter: Float64


def apparent_inertia(
    frequency: Float64, position: Complex128, torque: Complex128, motor: int, hold: float = 0.0
) -> ApparentInertia:
    """Of a motor from the lines (R, F, M) of R whole spans, all of one width from 0 Hz on.

    Lines count by the command on them, torque + ``hold``·position: on those of another axis the torque is
    the hold's alone.
    """
    turning = -((2 * np.pi * frequency[1:-1]) ** 2)
    command = np.abs(hann((torque + hold * position)[..., motor]))
    acceleration = command * turning * hann(position[..., motor])
    push = command * hann(torque[..., motor])
    edges = np.unique(np.searchsorted(frequency, _edges(frequency)).clip(0, turning.size - 1))
    cross, force, motion = (
        np.add.reduceat(x.sum(axis=0), edges)
        for x in (acceleration * push.conj(), np.abs(push) ** 2, np.abs(acceleration) ** 2)
    )
    middle = 0.5 * (frequency[edges] + frequency[np.append(edges[1:], turning.size)])
    width = np.diff(edges, append=turning.size)
    count = width * position.shape[0]
    coherence = np.abs(cross) ** 2 / np.maximum(force * motion, 1e-300)
    read = (coherence > COHERENT) & (width >= LEAST_LINES - 1)
    inertia = force[read] / np.abs(cross[read])
    scatter = np.sqrt(np.maximum(1.0 - coherence[read], 0.0) / (2.0 * count[read] * coherence[read]))
    return ApparentInertia(middle[read], inertia, scatter)


def _own_band(whole: float, seen: ApparentInertia) -> float:
    """Of one motor; the whole band where nothing is seen."""
    if seen.frequency.size < FEWEST_BANDS:
        return float(whole)
    level = np.log(seen.inertia)
    coherent = float(seen.frequency[-1])
    upper = seen.frequency > 0.5 * coherent
    bent = np.abs(level - np.median(level[upper])) > np.maximum(LEVEL, 4.0 * seen.scatter)
    return min(BEYOND * float(seen.frequency[bent].max(initial=0.0)), float(np.sqrt(RATIO)) * coherent)


def _edges(frequency: Float64) -> Float64:
    """Edges of bands [Hz], each of at least ``LEAST_LINES`` lines."""
    line, top = float(frequency[1]), float(frequency[-1])
    out = [line, LEAST_LINES * line]
    while out[-1] < top:
        out.append(max(out[-1] * RATIO, out[-1] + LEAST_LINES * line))
    return np.array(out)


def hann(lines: Complex128) -> Complex128:
    """(…, F − 2) lines (…, F) of a span under a Hann window, the first and last left out."""
    out: Complex128 = lines[..., 1:-1] - 0.5 * (lines[..., :-2] + lines[..., 2:])
    return out
