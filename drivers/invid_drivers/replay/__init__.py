"""A recording that plays the part of a cell."""

from invid_drivers.replay.cell import ReplayCell

__all__ = ["ReplayCell"]
