"""The task of the process that tunes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from invid.tuning.motor_scale import MotorScale


@dataclass(frozen=True, kw_only=True)
class Order:
    """What to tune and where to put it."""

    folder: Path
    source: Path
    simulated: bool
    cycle_s: float
    notches: int
    draws: int
    drive: str | None
    motors: Mapping[str, MotorScale]
    config: dict[str, Any] | None
    """Of the cell whose drives say what they hold now; ``None``: they are not asked."""
