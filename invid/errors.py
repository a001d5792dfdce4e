"""The errors invid raises on purpose, and the exit status each one ends a command with.

An error says what was found, where (file, field, axis, value) and the way out. Each is also the
matching builtin, so that library users may catch what they know::

    InvidError
    +-- InputError        (ValueError)       exit 2: usage, config, file or data that cannot be used
    |   +-- ChoiceNeeded                     exit 2: a file that can be read in several ways
    |   +-- RecordingError                   exit 2: an HDF5 recording that breaks the contract
    |   |   +-- DiskFullError                exit 2: a disk that takes no more of a recording or a result
    |   +-- ConfigError                      exit 2: a config that cannot be used
    |   +-- ModelError                       exit 2: masses, springs, couplings that are no model
    +-- NotIdentifiableError                 exit 3: the data cannot carry the result asked for
    +-- SafetyStop                           exit 4: a limit was met; motion is stopped
    +-- BusError          (ConnectionError)  exit 5: the bus failed
        +-- DriveError                       exit 5: a drive failed, or cannot do the job
"""

from __future__ import annotations

import copy
from typing import Any, Self


class InvidError(Exception):
    """Base of every error raised on purpose; ``exit_code`` is the command's exit status.

    Attributes
    ----------
    reason
        What was found, without what to do.
    way_out
        What to do; the text of the error is both.
    code, axis
        What stopped a motion, as a stable word (``position_window``, …), and on which axis; empty and
        ``None`` elsewhere.
    moment
        Where a sweep stood when this ended it (``invid.sweep.Moment``); ``None`` where nothing moved yet.
    """

    exit_code = 2

    def __init__(
        self, reason: str = "", *, way_out: str = "", code: str = "", axis: str | None = None
    ) -> None:
        super().__init__(f"{reason}; {way_out}" if way_out else reason)
        self.reason, self.way_out, self.code, self.axis = reason, way_out, code, axis
        self.moment: Any = None

    def saying(self, text: str) -> Self:
        """The same error in other words."""
        other = copy.copy(self)
        other.args = (text,)
        other.reason, other.way_out = text, ""
        return other


class InputError(InvidError, ValueError):
    """Usage or input that cannot be used: says what, where, the value found and the way out."""

    exit_code = 2


class ChoiceNeeded(InputError):
    """A file that can be read in several ways: the key of a map's ``source`` that says which, and a value."""

    def __init__(self, reason: str, key: str, value: str | int) -> None:
        super().__init__(reason)
        self.key, self.value = key, value

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.reason, self.key, self.value)


class RecordingError(InputError):
    """A recording that breaks the ``invid-recording`` contract."""


class DiskFullError(RecordingError):
    """A disk that takes no more of a recording or a result: which file, what room, the way out."""


class ConfigError(InputError):
    """A config that cannot be used."""


class ModelError(InputError):
    """Parameters that do not make a model (shape, sign, positive definiteness)."""


class NotIdentifiableError(InvidError):
    """The data cannot carry the result that was asked for; says which and what would."""

    exit_code = 3


class SafetyStop(InvidError):
    """Motion was stopped because a limit was met or a watched quantity left its window."""

    exit_code = 4


class BusError(InvidError, ConnectionError):
    """The bus failed (no adapter, bus-off, send queue full)."""

    exit_code = 5


class DriveError(BusError):
    """A drive failed, does not answer, or cannot do the job."""

    exit_code = 5
