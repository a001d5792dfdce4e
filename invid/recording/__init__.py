"""Measured data: the recording in memory, as HDF5, and from elsewhere."""

from invid.recording.hdf5 import read_recording, write_recording
from invid.recording.model import Experiment, Kind, Outcome, Recording, Role
from invid.recording.writer import RecordingWriter

__all__ = [
    "Experiment",
    "Kind",
    "Outcome",
    "Recording",
    "RecordingWriter",
    "Role",
    "read_recording",
    "write_recording",
]
