"""States of an identification and the moves between them."""

from __future__ import annotations

from enum import StrEnum
from typing import Final


class State(StrEnum):
    """States that the contract names."""

    QUEUED = "queued"
    CHECKING = "checking"
    AWAITING_ARM = "awaiting_arm"
    RUNNING = "running"
    ANALYSING = "analysing"
    AWAITING_ACCEPT = "awaiting_accept"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"
    STOPPED = "stopped"
    INTERRUPTED = "interrupted"


_EARLY_ENDS = {State.FAILED, State.CANCELLED, State.STOPPED, State.INTERRUPTED}
ENDED = frozenset({State.SUCCEEDED, *_EARLY_ENDS})
"""They never change."""
OCCUPYING = frozenset({State.QUEUED, State.CHECKING, State.AWAITING_ARM, State.RUNNING, State.ANALYSING})
"""A runner process works for these: one of them per cell, and a restart cuts them off. A result that
awaits accept has everything it needs in the store: it outlives a restart and blocks nobody."""

IDLE: Final = "idle"
"""Said of a cell that was never measured."""
UPLOAD: Final = "upload"
"""Mode of a run whose recording came from elsewhere."""

_NEXT: dict[State, frozenset[State]] = {
    State.QUEUED: frozenset({State.CHECKING, State.ANALYSING, *_EARLY_ENDS}),
    State.CHECKING: frozenset({State.AWAITING_ARM, State.RUNNING, *_EARLY_ENDS}),
    State.AWAITING_ARM: frozenset({State.RUNNING, *_EARLY_ENDS}),
    State.RUNNING: frozenset({State.ANALYSING, *_EARLY_ENDS}),
    State.ANALYSING: frozenset({State.AWAITING_ACCEPT, State.SUCCEEDED, *_EARLY_ENDS}),
    State.AWAITING_ACCEPT: frozenset({State.SUCCEEDED, State.CANCELLED}),
}


def may_follow(old: State, new: State) -> bool:
    """True where the machine allows ``old`` → ``new``."""
    return new in _NEXT.get(old, frozenset())
