"""Columns that were sampled at instants of their own, put on one clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Bool, Float64, frozen_float
from invid.recording.tables import Table


def on_clock(table: Table, time: str, needed: Sequence[str]) -> tuple[Table, tuple[str, ...]]:
    """The table at the instants of one of its time columns, with a remark for each column moved there.

    Parameters
    ----------
    table
        With ``clocks``: which time column each column was sampled by.
    time
        The time column to keep.
    needed
        Columns that must be there. Those of other clocks are interpolated linearly, never beyond their ends:
        the rows kept are those that all of them cover.

    Raises
    ------
    InputError
        Columns that have no instant in common.
    """
    instants = table.columns[time]
    own = {n: c for n, c in table.columns.items() if table.clocks.get(n, time) == time}
    moved = [n for n in dict.fromkeys(needed) if n not in own]
    keep: Bool = np.isfinite(instants)
    remarks = []
    brought: dict[str, Float64] = {}
    for name in moved:
        clock = table.clocks[name]
        there, values = table.columns[clock], table.columns[name]
        good = np.isfinite(there) & np.isfinite(values)
        good[1:] &= there[1:] > np.maximum.accumulate(there)[:-1]
        if good.sum() < 2:
            raise InputError(f"{table.name}: column {name!r} has fewer than two samples that follow in time")
        there, values = there[good], values[good]
        keep &= (instants >= there[0]) & (instants <= there[-1])
        brought[name] = np.interp(instants, there, values)
        remarks.append(
            f"{name!r} was sampled at instants of its own ({clock!r}, {_interval(there)}); it was "
            f"interpolated to those of {time!r} ({_interval(instants)})"
        )
    if moved and keep.sum() < 2:
        raise InputError(f"{table.name}: {time!r} and the instants of {moved} have no time in common")
    rows = keep if moved else np.ones(instants.size, dtype=np.bool_)
    columns = {n: frozen_float(c[rows]) for n, c in (own | brought).items() if c.size == rows.size}
    lines = np.arange(rows.size, dtype=np.int64) if table.lines is None else table.lines[: rows.size]
    same = dict.fromkeys(columns, time)
    return replace(table, columns=columns, lines=lines[rows], clocks=same), tuple(remarks)


def _interval(instants: Float64) -> str:
    return f"every {float(np.median(np.diff(instants[np.isfinite(instants)]))):.4g}"
