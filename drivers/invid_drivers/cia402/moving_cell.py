"""What the stop test and the way out are given of a cell whose drives are energised."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from invid.config import CellConfig
from invid.sweep.ports import Sample
from invid_drivers.cia402.axis import Drive
from invid_drivers.cia402.cycle import Cycle
from invid_drivers.cia402.link import Link


@dataclass(frozen=True, eq=False)
class MovingCell:
    """The drives of a cell, the bus they are on, and the cycle that commands them.

    ``exchange`` is one cycle of the cell: torque (M,) out, sample in. ``resolution`` (M,) is the position of
    one encoder count [rad or m], ``permitted`` (M,) the speed of each axis [rad/s or m/s].
    """

    config: CellConfig
    link: Link
    drives: Sequence[Drive]
    cycle: Cycle
    exchange: Callable[[Sequence[float]], Sample]
    resolution: Sequence[float]
    permitted: Sequence[float]
