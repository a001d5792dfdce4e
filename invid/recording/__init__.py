"""Measured data: the recording in memory, as HDF5, and from elsewhere."""

from invid.recording.model import Experiment, Kind, Outcome, Recording, Role

__all__ = ["Experiment", "Kind", "Outcome", "Recording", "Role"]
