"""Poles and zeros of an FRF matrix with sub-line resolution and standard deviations."""

from invid.modes.fit import fit_modes
from invid.modes.model import Modes

__all__ = ["Modes", "fit_modes"]
