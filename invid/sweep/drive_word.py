"""Watch the statuswords of enabled drives: do they limit, do they follow their targets?"""

from __future__ import annotations

from collections.abc import Iterable

from invid.errors import SafetyStop
from invid.sweep.ports import Sample
from invid.wording.sentence import sentence

LIMITS, FOLLOWS = 1 << 11, 1 << 12
"""Internal limit active; in the cyclic modes: the drive follows the command value (CiA 402-2)."""
LONG_CYCLES, LONG_S = 5, 0.02
"""So long in a row before it is believed: a hand-over between controllers may touch a limit."""
SPOILT = 0.01
"""Share of an axis's samples at a limit from which on the result says so."""


class DriveWords:
    """Watch over bits 11 and 12 of every axis; whoever changes modes says so."""

    def __init__(self, names: list[str], cycle_s: float) -> None:
        self._names = names
        self._long = max(LONG_CYCLES, round(LONG_S / cycle_s))
        count = len(names)
        self._at_rest = [False] * count
        self._limited = [0] * count
        self._longest = [0] * count
        self._total = [0] * count
        self._samples = 0
        self._followed = [False] * count
        self._ignored = [0] * count
        self._paused = False

    def pause(self) -> None:
        """Judge nothing until ``resume``, as modes change; in another mode bit 12 begins anew."""
        self._paused = True

    def resume(self) -> None:
        """Judge again: every drive is in its mode."""
        self._paused = False
        count = len(self._names)
        self._followed, self._ignored, self._limited = [False] * count, [0] * count, [0] * count

    def learn_rest(self) -> None:
        """Learn which drives report a limit though nothing is asked for: such a report says nothing."""
        self._at_rest = [n >= self._long for n in self._longest]
        self.begin()

    def begin(self) -> None:
        """Count limits from here on."""
        self._longest = [0] * len(self._names)
        self._limited = [0] * len(self._names)

    def check(self, sample: Sample) -> None:
        """Raise SafetyStop where a drive that followed its target does so no longer."""
        if self._paused:
            return
        self._samples += 1
        for i, fresh in enumerate(sample.fresh):
            if not fresh:
                continue
            word = sample.status[i]
            if word & LIMITS:
                self._total[i] += 1
                self._limited[i] += 1
                self._longest[i] = max(self._longest[i], self._limited[i])
            else:
                self._limited[i] = 0
            if word & FOLLOWS:
                self._followed[i], self._ignored[i] = True, 0
            elif self._followed[i]:
                self._ignored[i] += 1
                if self._ignored[i] >= self._long:
                    raise SafetyStop(
                        sentence(
                            "axis {axis}: the drive says that it no longer follows its target (statusword "
                            "bit 12 is 0 for {cycles} cycles); look at its enable inputs, its halt and limit "
                            "switches, and whether something else commands it",
                            axis=self._names[i],
                            cycles=self._ignored[i],
                        ),
                        axis=self._names[i],
                    )

    def ignores(self, axis: int) -> bool:
        """Return True where a drive has not reported in this mode that it follows its target: some
        never do.
        """
        return not self._followed[axis]

    def require_no_limit(self, axes: Iterable[int], what: str) -> None:
        """Raise SafetyStop where a drive limited since ``begin``; ``what`` was asked of it."""
        for i in axes:
            if self._longest[i] >= self._long and not self._at_rest[i]:
                raise SafetyStop(
                    f"axis {self._names[i]}: the drive reports that it limits (statusword bit 11) at {what}: "
                    "a limit of its own is tighter than those that were read, or its supply does not give "
                    "what is asked; look at 0x6072, 0x6073, 0x607F, 0x6080, 0x607D, the vendor's current "
                    "limits and its error memory, or lower the amplitude",
                    axis=self._names[i],
                )

    def said(self) -> tuple[str, ...]:
        """Return the warnings about axes that were limited."""
        return tuple(
            sentence(
                "axis {axis}: the drive reported that it limits (statusword bit 11) in {total:.0%} "
                "of the samples: what it was asked for is not what it did there",
                axis=name,
                total=total / self._samples,
            )
            for name, total, rest in zip(self._names, self._total, self._at_rest, strict=True)
            if not rest and total > SPOILT * max(self._samples, 1)
        )
