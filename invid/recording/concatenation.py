"""Several recordings of one machine as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from invid.errors import InputError
from invid.recording.model import Experiment, Recording

GAP = 60.0
"""Seconds that stand for the unknown time between two recordings (a convention)."""


def concatenate_recordings(recordings: Sequence[Recording]) -> Recording:
    """Recordings of one robot as one, one after another in time, keys numbered through.

    The plant is one; noise is estimated for each experiment as in a single recording. Name, config and
    attributes are those of the first; numbers of masses, rated torques and encoder resolutions those of the
    first that names them. The clocks are not one: a minute stands for what lies between two recordings.

    Raises
    ------
    InputError
        No recording; recordings of other axes, in other units, with other numbers of masses, rated torques or
        encoder resolutions: says which recording, what it has and what the first has.
    """
    if not recordings:
        raise InputError("no recording was given")
    first = recordings[0]
    if len(recordings) == 1:
        return first
    experiments: list[Experiment] = []
    clock = 0.0
    for number, r in enumerate(recordings):
        if (
            r.axes != first.axes
            or r.position_unit != first.position_unit
            or r.torque_unit != first.torque_unit
        ):
            raise InputError(
                f"{r.source}: axes {list(r.axes)} in {r.position_unit}, {r.torque_unit}; the first recording "
                f"has {list(first.axes)} in {first.position_unit}, {first.torque_unit}: not the same robot"
            )
        starts = [float(e.time[0]) for e in r.experiments]
        shift = 0.0 if number == 0 else clock + GAP - min(starts, default=0.0)
        for e in r.experiments:
            experiments.append(replace(e, key=f"{len(experiments):03d}", time=e.time + shift))
        clock = max((float(e.time[-1]) for e in experiments), default=0.0)
    return replace(
        first,
        experiments=tuple(experiments),
        masses_per_axis=_one_of("masses_per_axis", recordings),
        rated_torque=_one_of("rated_torque", recordings),
        encoder_resolution=_one_of("encoder_resolution", recordings),
        source=" + ".join(r.source for r in recordings),
    )


def _one_of(field: str, recordings: Sequence[Recording]) -> Any:
    """The value that all recordings which name one have."""
    named = [(r.source, getattr(r, field)) for r in recordings if getattr(r, field) is not None]
    if not named:
        return None
    where, value = named[0]
    for other, found in named[1:]:
        if not np.array_equal(value, found):
            raise InputError(
                f"{other}: {field} is {list(found)}; {where} has {list(value)}: "
                "not the same machine, or not the same settings of its drives; diagnose them one by one"
            )
    return value
