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

import re
from collections.abc import Iterable, Mapping
from typing import Any

from invid.wording.sentence import joined


class InvidError(Exception):
    """Base of every error raised on purpose; ``exit_code`` is the command's exit status.

    Attributes
    ----------
    reason
        What was found, without what to do.
    way_out
        What to do; the text of the error is both, then ``left``.
    left
        What is known of axes, drives and file after a motion that this ended, as sentences (``note_left``).
    code
        What stopped a motion (``position_window``, …) or why a file is refused (``no_record_in_time``, …),
        as a stable word; else empty.
    values
        What was measured, by name, for programs.
    axes, axis
        The axes it is about, and the only one of them; ``None`` where there are none or several.
    moment
        Where a sweep stood when this ended it (``invid.sweep.Moment``); ``None`` where nothing moved yet.
    """

    exit_code = 2

    def __init__(
        self,
        reason: str = "",
        *,
        way_out: str = "",
        code: str = "",
        axis: str | None = None,
        axes: Iterable[str] = (),
        values: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(joined([reason, way_out], "; ") if way_out else reason)
        self.reason, self.way_out, self.code = reason, way_out, code
        self.values = dict(values or {})
        self.axes = tuple(axes) if axis is None else (axis,)
        self.left: tuple[str, ...] = ()
        self.moment: Any = None

    @property
    def word(self) -> str:
        """What a program branches on: ``code``, else the kind (``recording``, ``not_identifiable``)."""
        kind = type(self).__name__.removesuffix("Error")
        return self.code or re.sub(r"(?<=[a-z])(?=[A-Z])", "_", kind).lower()

    @property
    def axis(self) -> str | None:
        """The axis it is about, where that is one."""
        return self.axes[0] if len(self.axes) == 1 else None

    def __str__(self) -> str:
        """The text for a person, a ``Sentence`` where its parts are."""
        return joined([*self.args[:1], *self.left], ". ")


def note_left(error: BaseException, left: Iterable[str]) -> None:
    """Add what is known of axes, drives and file after a motion to whatever error ended it, each thing once.

    Errors of others carry it as notes (PEP 678).
    """
    if isinstance(error, InvidError):
        error.left = tuple(dict.fromkeys((*error.left, *left)))
        return
    for sentence in left:
        if sentence not in getattr(error, "__notes__", ()):
            error.add_note(sentence)


def left_by(error: BaseException) -> tuple[str, ...]:
    """What ``note_left`` added to an error."""
    return error.left if isinstance(error, InvidError) else tuple(getattr(error, "__notes__", ()))


class InputError(InvidError, ValueError):
    """Usage or input that cannot be used: says what, where, the value found and the way out."""

    exit_code = 2


class ChoiceNeeded(InputError):
    """A file that can be read in several ways: the key of a map's ``source`` that says which, and a value."""

    def __init__(self, reason: str, key: str, value: str | int) -> None:
        super().__init__(reason, code="choice_needed", values={key: value})
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
