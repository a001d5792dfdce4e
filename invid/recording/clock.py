"""Read the stamps of a log, and find which sample of an even clock each row is.

Stamps are measured as everything else: a logger stamps late, its counter wraps, its clock wanders. Rows are
counted against the whole clock, never step by step, so a late stamp is no lost sample and gives back what it
took; what stays away is lost.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy

from invid.errors import InputError
from invid.numerics.arrays import Bool, Float64, Int64

EVEN = 1e-3
"""Lateness of every stamp [steps] up to which a clock is even beyond question: a lost row is a step."""
EVENTS_SPREAD = 0.6
"""Steps of robust spread about an even clock from which rows come at events: a jitter of half a step has at
most 0.43, instants without any clock 0.7 or more."""
WALKS = 0.2
"""Steps of spread from which it is looked at whether lateness is handed on; of jitter, drawn anew for each
row, differences spread 1.4 times as far as it does."""
COHERENT = 0.2
"""Mean phasor of the stamps about the clock from which its slow wander can be followed; that of a thousand
stamps spread over the whole step is 0.03."""
INCOHERENT = 0.2
"""Robust spread of the differences, in steps, from which the stamps' phase is looked for in means over rows:
a jitter of a tenth of a step."""
_RUN = 8
"""Rows in such a mean: jitter over a whole step is then 0.1, and a lost row spoils eight means."""
_BLOCK = 1024
"""Rows that one value of the wander is taken from."""
LONGEST_WRAP = 100
"""Steps that may be missing where a counter wraps: a hundred rows lost at just that place."""
DIFFERENCES = 0.2
"""Share of falls among all changes from which stamps are no instants: of differences it is a half."""
REPEATED = 0.05
"""Share of stamps equal to the one before from which the stamps are too coarse to tell a lost row."""
FAR = 3.0
"""Steps off the even clock beyond which a stamp out of order is a broken row, not a late one (empirical)."""
LONGEST_STEP = 1.0
"""Seconds between two rows up to which what is added up may be time: a drive is logged ten times a second."""
RISING = 0.98
"""Share of steps that rise from which a column may be time: a counter that wraps falls at times."""
_SAMPLE = 20_000
_POWERS = (16, 24, 31, 32)
_TICKS = (1e-9, 1e-6, 1e-5, 1e-4, 1e-3)
_ROUNDS = {1.0: "second", 60.0: "minute", 3600.0: "hour", 43200.0: "half day", 86400.0: "day"}


@dataclass(frozen=True, eq=False)
class Slots:
    """Rows on an even clock.

    Attributes
    ----------
    step
        Of the clock [s].
    index
        (n,) whole number of steps from the first row; increasing.
    late
        (n,) steps that each stamp is off the clock.
    even
        False where rows come at events: ``index`` is then no more than a count of rows.
    """

    step: float
    index: Int64
    late: Float64
    even: bool

    @property
    def lost(self) -> int:
        """Steps without a row."""
        return int(self.index[-1]) + 1 - self.index.size

    @property
    def jitter(self) -> float:
        """Robust standard deviation of the stamps [steps]."""
        return _spread(self.late)


def count_slots(time: Float64) -> Slots:
    """The slot of each of n ≥ 3 rows whose stamps ``time`` [s] may be late, but not in the long run."""
    rows = np.arange(time.size)
    even = float(time[-1] - time[0]) / (time.size - 1)
    straight = (time - time[0]) / even - rows if even > 0 else np.full(time.size, np.inf)
    if np.abs(straight).max() < EVEN:
        return Slots(even, rows, straight, even=True)
    # Stamps spread over a whole step have no phase; their means over some rows have.
    rough = _spread(np.diff(time)) > INCOHERENT * np.median(np.diff(time))
    run = min(_RUN, time.size // 2) if rough else 1
    step = _clock_step(time, run)
    u = (time - time[0]) / step - rows
    wander = _wander(scipy.ndimage.uniform_filter1d(u, run))
    level = _level(u - wander)
    # Who was late gives it back: a row is counted lost only where the clock stays ahead for good.
    count = np.minimum.accumulate(np.rint(level)[::-1])[::-1]
    index = (rows + count - count[0]).astype(np.int64)
    late, step = _off_line(time, index, step)
    jumps = int(np.count_nonzero(np.diff(count)))
    if jumps:
        # Each loss has a place and a size; those that the stamps do not pay for (BIC) are jitter.
        without, plain = _off_line(time, rows, float(time[-1] - time[0]) / (time.size - 1))
        if time.size * np.log(_mean_size(without) / _mean_size(late)) < jumps * np.log(time.size):
            index, late, step = rows, without, plain
    bend = wander - np.polyval(np.polyfit(rows, wander, 1), rows)
    late = late - bend if np.abs(bend).max() > 0.1 else late
    # A loop that sleeps after its work keeps no clock: what one turn is late the next ones are too, and
    # the clock seems to lose rows.
    lost = index[-1] + 1 > time.size
    walks = lost and _spread(late) > WALKS and _spread(np.diff(late)) < 0.5 * _spread(late)
    if _spread(late) > EVENTS_SPREAD or walks or index[-1] <= 0:
        return Slots(even, rows, straight, even=False)
    return Slots(step, index, late, even=True)


def _clock_step(time: Float64, run: int) -> float:
    """Step of the clock [s]: what most differences over more and more rows are whole multiples of.

    Instants are means over ``run`` rows.
    """
    apart = np.diff(time)
    step = float(np.median(apart))
    # Stamps of whole ticks, 2.5 to a row, differ by two or three: the step is their mean, not their median.
    usual = np.abs(apart - step) <= 0.5 * step
    step = float(apart[usual].mean()) if usual.any() else step
    if np.mean(apart == 0) > REPEATED:
        # Stamps coarser than the rows: their differences are none of a row's.
        far = min(64, time.size // 2)
        step = float(np.median(time[far:] - time[:-far])) / far
    if step <= 0:
        step = float(time[-1] - time[0]) / (time.size - 1)
    time, lag = scipy.ndimage.uniform_filter1d(time, run), max(run, 2)
    while lag <= min(max(time.size // 16, 2), _BLOCK) and lag < time.size:
        apart = time[lag:] - time[:-lag]
        steps = np.maximum(np.rint(apart / step), 1.0)
        step = float(np.median(apart / steps))
        lag *= 2
    return step


def _wander(u: Float64) -> Float64:
    """(n,) slow wander of the clock [steps], by the phase of many stamps: whole steps lost do not enter."""
    blocks = max(u.size // _BLOCK, 1)
    parts = np.array_split(np.arange(u.size), blocks)
    phasor = np.array([np.mean(np.exp(2j * np.pi * u[p])) for p in parts])
    if np.abs(phasor).min() < COHERENT:
        return np.full(u.size, float(np.median(u)))
    phase = np.unwrap(np.angle(phasor)) / (2 * np.pi)
    if blocks == 1:
        return np.full(u.size, phase[0])
    middles = [float(p.mean()) for p in parts]
    line = scipy.interpolate.make_interp_spline(middles, phase, k=1)
    found: Float64 = line(np.arange(u.size))
    return found


def _level(u: Float64) -> Float64:
    """(n,) what the stamps are ahead of the row's number, single late ones apart.

    A median over 2w + 1 rows has the deviation 1.25 σ/√(2w + 1), which is brought below a twelfth of a step.
    """
    spread = _spread(np.diff(u)) / np.sqrt(2.0)
    half = int(np.clip(np.ceil((1.25 * spread / 0.08) ** 2 / 2), 1, max((u.size - 1) // 4, 1)))
    level: Float64 = scipy.ndimage.median_filter(u, size=2 * half + 1, mode="mirror")
    return level


def _off_line(time: Float64, index: Int64, step: float) -> tuple[Float64, float]:
    """Steps that the stamps are off the line through them, and its slope; late ones do not bend it."""
    x = index - index[-1] / 2
    use = np.ones(time.size, dtype=np.bool_)
    late = (time - time[0]) / step - index
    for _ in range(4):
        slope, start = np.polyfit(x[use], time[use] - time[0], 1)
        if not slope > 0:
            return late, step
        late, step = (time - time[0] - start) / slope - x, float(slope)
        use = np.abs(late - np.median(late)) <= 4.0 * max(_spread(late), 1e-6)
        if use.sum() < 3:
            break
    return late, step


def _mean_size(values: Float64) -> float:
    return max(float(np.mean(np.abs(values - np.median(values)))), 1e-6)


def _spread(values: Float64) -> float:
    middle = np.median(values)
    return 1.4826 * float(np.median(np.abs(values - middle)))


@dataclass(frozen=True, eq=False)
class Stamps:
    """A time column as instants.

    Attributes
    ----------
    instants
        (n,) [s]; NaN where there was no stamp.
    said
        What the stamps are, in one sentence.
    remarks
        What was done about them, for the warnings; empty for an even clock.
    """

    instants: Float64
    said: str
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class StampsRead:
    """How a map reads its time column: what the sentences name, and the keys that it may have set."""

    column: str
    unit: float
    """Seconds of one unit of the column."""
    wraps_at: float | None = None
    """[s]"""
    differences: bool = False
    sums: Float64 | None = None
    """(n,) [s] stamps added up over everything that the file stamps, rows or not."""


def read_stamps(raw: Float64, how: StampsRead, where: str) -> Stamps:
    """The instants [s] of stamps ``raw`` [s]: differences added up, counters unwrapped, order restored.

    Raises
    ------
    InputError
        The stamps are no instants (constant, repeated, differences, set back): the key that reads the file.
    """
    known = np.isfinite(raw)
    stamps = raw[known]
    if stamps.size < 3:
        return Stamps(raw, "too few stamps to tell what they are")
    remarks: list[str] = []
    if how.differences:
        added = np.cumsum(np.where(known, raw, 0.0)) if how.sums is None else how.sums
        stamps = added[known]
        remarks.append("the stamps are differences, as the map says: they were added up")
    else:
        _refuse_no_instants(stamps, how, where)
    stamps, said = _unwrapped(stamps, how, where)
    remarks += said
    stamps, said = _in_order(stamps, how, where)
    remarks += said
    instants = np.full(raw.size, np.nan)
    instants[known] = stamps
    slots = count_slots(stamps)
    sentence = _sentence(slots)
    if (slots.even and (np.abs(slots.late).max() > 0.05 or slots.lost)) or not slots.even:
        remarks.append(sentence)
    return Stamps(
        instants, "; ".join([*remarks[: len(remarks) - (sentence in remarks)], sentence]), tuple(remarks)
    )


def _sentence(slots: Slots) -> str:
    if not slots.even:
        return (
            f"the rows come at events, at no rate ({1 / slots.step:.4g} a second on the mean): what lies "
            "between them is interpolated"
        )
    text = f"even clock of {1 / slots.step:.6g} Hz"
    jitter = slots.jitter
    late = int(np.sum(np.abs(slots.late - np.median(slots.late)) > max(6 * jitter, 0.05)))
    if jitter > 1e-2:
        text += f", stamps jitter by {1e3 * jitter * slots.step:.3g} ms (standard deviation)"
    if 0 < late <= 0.05 * slots.late.size:
        worst = float(np.abs(slots.late).max())
        text += f", {late} stamps up to {1e3 * worst * slots.step:.3g} ms off it"
    if slots.lost:
        text += f", {slots.lost} of {int(slots.index[-1]) + 1} rows missing"
    return text


def best_clock(columns: Iterable[Float64]) -> int | None:
    """The number of the column that keeps time best; ``None`` where none rises throughout.

    A motion in one direction rises as time does, but not in even steps.
    """
    found: tuple[float, int] | None = None
    for number, column in enumerate(columns):
        known = column[np.isfinite(column)][:_SAMPLE]
        rise = np.diff(known)
        if known.size < 3 or float(np.mean(rise >= 0)) < RISING or not np.mean(rise > 0) > REPEATED:
            continue
        uneven = _spread(rise) / float(np.mean(rise[rise >= 0]))
        if found is None or uneven < found[0] - EVEN:
            found = uneven, number
    return None if found is None else found[1]


def is_count(column: Float64) -> bool:
    """Whether numbers only count rows (0, 1, 2, …, some perhaps missing): a clock in no unit.

    Stamps in whole milliseconds of a record at 1 kHz look the same; their name or unit tells them apart.
    """
    known = column[np.isfinite(column)]
    step = np.diff(known)
    return known.size > 2 and bool(np.all(known == np.rint(known)) and np.median(step) == 1.0)


def nice_rate(rate: float, doubt: float) -> str:
    """The shortest number within ``doubt`` (relative) of ``rate``."""
    return next(
        (t for t in (f"{rate:.{d}g}" for d in range(1, 12)) if abs(float(t) / rate - 1) <= doubt),
        f"{rate:.9g}",
    ).replace("e+0", "e")


def _rate_line(rate: float, doubt: float) -> str:
    return f"time: {{sample_rate_hz: {float(nice_rate(rate, doubt)):.9g}}}"


def _refuse_no_instants(stamps: Float64, how: StampsRead, where: str) -> None:
    d = np.diff(stamps)
    same = float(np.mean(d == 0))
    fall = float(np.sum(d < 0)) / max(int(np.sum(d != 0)), 1)
    name = f"{where}: the stamps in {how.column!r}"
    added = np.cumsum(stamps) if how.sums is None else how.sums
    step = float(added[-1] - added[0]) / (stamps.size - 1)
    positive = how.sums is not None or (np.median(stamps) > 0 and np.mean(stamps < 0) < 0.01)
    sums = positive and 0 < step < LONGEST_STEP
    rate = 1.0 / step if sums else 0.0
    doubt = 3e-3
    lines = (
        "if each is the time since the one before, write 'differences: true' beside 'column' in the map's "
        f"'time' (about {float(nice_rate(rate, doubt)):.9g} rows a second), or '{_rate_line(rate, doubt)}' "
        "where no row is missing"
        if rate
        else "write 'time: {sample_rate_hz: …}' with the rate at which the rows were taken (for a CAN log "
        "that of SYNC) in place of the column; the file is then read row by row"
    )
    if np.ptp(stamps[1:]) == 0:
        raise InputError(f"{name} are all the same, so they are no instants; {lines}")
    if fall > DIFFERENCES and sums:
        raise InputError(f"{name} fall as often as they rise: they are differences, not instants; {lines}")
    if fall > DIFFERENCES:
        raise InputError(
            f"{name} fall at {fall:.0%} of their changes: it is no clock; name another column, or {lines}"
        )
    if same > REPEATED:
        raise InputError(f"{name} {_coarse(stamps, same)}")


def _coarse(stamps: Float64, same: float) -> str:
    """Return what is said of stamps that repeat: they are coarser than the rows."""
    # Means over the rows of one tick are as even as the rows.
    slots = count_slots(scipy.ndimage.uniform_filter1d(stamps, max(round(1.0 / (1.0 - same)), 1)))
    d = np.diff(stamps)
    tick = float(np.min(d[d > 0]))
    gaps = np.flatnonzero(np.diff(slots.index) > 1)
    ends = np.concatenate(([0], gaps + 1, [stamps.size]))
    longest = int(np.argmax(np.diff(ends)))
    doubt = min(0.01, tick / max(float(stamps[-1] - stamps[0]), tick))
    text = (
        f"repeat ({same:.0%} equal the one before): they count in steps of {tick:.3g} s, coarser than the "
        f"rows; write '{_rate_line(1 / slots.step, doubt)}' in place of the column, which takes the rows as "
        "even"
    )
    if gaps.size and slots.even:
        text += (
            f"; {slots.lost} rows are missing, so take a stretch without gaps: 'rows: [{ends[longest]}, "
            f"{ends[longest + 1]}]' in the experiment"
        )
    return text


def find_restarts(raw: Float64, how: StampsRead) -> list[int]:
    """Rows at which a clock starts anew, as another record behind the first; empty where there is none.

    After each fall stamps ``raw`` [s] begin again where the first ones did. A counter of 2^n ticks that
    wraps does too where it began at 0: it falls by that number, which no record is as long as by chance.
    """
    rows = np.flatnonzero(np.isfinite(raw))
    stamps = raw[rows]
    d = np.diff(stamps)
    if how.wraps_at is not None or how.differences or not (d > 0).any():
        return []
    step = float(np.median(d[d > 0]))
    falls = np.flatnonzero(d < -10 * step)
    if not 0 < falls.size * 16 < stamps.size or (np.abs(stamps[falls + 1] - stamps[0]) > 2 * step).any():
        return []
    if _modulus(-d[falls], step, how.unit, rounds=False) is not None:
        return []
    return [int(rows[k + 1]) for k in falls.tolist() if _stays(stamps, int(k), step)]


def _unwrapped(stamps: Float64, how: StampsRead, where: str) -> tuple[Float64, list[str]]:
    """Stamps of a counter that starts over, or of a clock that was set back or forth by an hour."""
    d = np.diff(stamps)
    step = float(np.median(d[d > 0])) if (d > 0).any() else 0.0
    jumps = [int(k) for k in np.flatnonzero(d < -10 * step) if _stays(stamps, int(k), step)]
    if not jumps or step <= 0:
        return stamps, []
    modulus = how.wraps_at or _modulus(-d[jumps], step, how.unit)
    if modulus is None or (modulus + d[jumps] < 0).any():
        k = jumps[0]
        raise InputError(
            f"{where}: the stamps in {how.column!r} fall by {-d[k] / how.unit:.9g} after row {k} "
            f"({stamps[k] / how.unit:.9g}, then {stamps[k + 1] / how.unit:.9g}): a counter that wraps, a "
            "clock that was set back, or two records in one file; write 'wraps_at' (in the column's unit) "
            f"beside 'column' in the map's 'time', or make two experiments of it: 'rows: [0, {k + 1}]' and "
            f"'rows: [{k + 1}, null]'"
        )
    out = stamps.copy()
    for k in jumps:
        out[k + 1 :] += modulus
    times = "once" if len(jumps) == 1 else f"{len(jumps)} times"
    return out, [f"the clock starts over at {_named(modulus)} ({times}): it was unwrapped"]


def _stays(stamps: Float64, k: int, step: float) -> bool:
    """Return whether what comes after row k goes on from its lower stamp; a single wrong stamp does not."""
    before, after = np.median(stamps[max(k - 2, 0) : k + 1]), np.median(stamps[k + 1 : k + 4])
    return bool(before - after > 5 * step)


def _modulus(falls: Float64, step: float, unit: float, *, rounds: bool = True) -> float | None:
    """The number at which a counter wraps that falls like this, with the least time between."""
    known = {2.0**p * tick for p in _POWERS for tick in (*_TICKS, unit)} | (set(_ROUNDS) if rounds else set())
    left = {m: m - falls for m in known}
    most = LONGEST_WRAP if rounds else 2
    fitting = [m for m, e in left.items() if (e > -0.5 * step).all() and (e < most * step).all()]
    return min(fitting, key=lambda m: float(np.sum(left[m])), default=None)


def _named(modulus: float) -> str:
    for p in _POWERS:
        for tick, name in zip(_TICKS, ("ns", "µs", "× 10 µs", "× 0.1 ms", "ms"), strict=True):
            if abs(modulus / (2.0**p * tick) - 1) < 1e-12:
                return f"2^{p} {name}"
    return f"a whole {_ROUNDS[modulus]}" if modulus in _ROUNDS else f"{modulus:.9g} s"


def _in_order(stamps: Float64, how: StampsRead, where: str) -> tuple[Float64, list[str]]:
    """Stamps that increase where rows of an even clock were stamped out of order; broken ones stay."""
    d = np.diff(stamps)
    slots = count_slots(stamps)
    if slots.lost > max(stamps.size, 1000) and slots.even:
        k = int(np.argmax(np.diff(slots.index)))
        raise InputError(
            f"{where}: {d[k]:.4g} s lie between row {k} and row {k + 1} by {how.column!r}, longer than all "
            f"rows take: two records, so make two experiments of them: 'rows: [0, {k + 1}]' and 'rows: "
            f"[{k + 1}, null]'"
        )
    if (d > 0).all() or not slots.even:
        return stamps, []
    wrong: Bool = np.concatenate(([False], d <= 0))
    near = np.abs(slots.late) <= FAR
    if not (wrong & near).any():
        return stamps, []
    even = stamps[0] + slots.step * (slots.index - slots.index[0] - slots.late[0])
    return np.where(near, even, stamps), [
        f"{int((wrong & near).sum())} stamps are out of order, which samples cannot be: the instants are "
        "those of the even clock that the rows keep"
    ]


__all__ = [
    "Slots",
    "Stamps",
    "StampsRead",
    "best_clock",
    "count_slots",
    "find_restarts",
    "is_count",
    "nice_rate",
    "read_stamps",
]
