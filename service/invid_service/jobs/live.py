"""Keep a run that is still going on in memory: polls and followers see it without touching the store."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Literal

from invid_drivers.protocol import AxisStates
from invid_service.events import EventLog
from invid_service.jobs.launcher import Worker
from invid_service.jobs.protocol import RunProgress
from invid_service.jobs.states import ENDED, OCCUPYING, UPLOAD, State, may_follow
from invid_service.store.store import RunRecord, StoredEvent

Wish = Literal["stop", "cancel", "shutdown"]


def progress_of(record: RunRecord) -> RunProgress:
    """Return the progress of a stored run, in which nothing goes on any more."""
    done = record.state in (State.SUCCEEDED, State.AWAITING_ACCEPT)
    return RunProgress(progress=1.0 if done else record.facts.get("progress", 0.0), phase=str(record.state))


class WrongStateError(Exception):
    """The state machine does not allow this move."""


class LiveRun:
    """State, progress, events and worker of one run; used on the event loop only."""

    def __init__(self, record: RunRecord, stored: Iterable[StoredEvent] = ()) -> None:
        self.record = record
        self.progress = progress_of(record)
        events = list(stored)
        self.events = EventLog(events)
        self.since = record.ended or (
            datetime.fromtimestamp(events[-1].id / 1e3, UTC) if events else record.created
        )
        """When it came into its state; the ids of events are a clock."""
        self.worker: Worker | None = None
        self.wish: Wish | None = None
        self.axes = AxisStates()
        """What its axes were seen to be last."""
        self.killed = False
        """Its runner did not stop in time: nobody knows what its axes do."""
        self.unsaved = False
        """The store has not taken its state yet: memory alone knows it."""
        self.motion_ended = asyncio.Event()
        self.lock = asyncio.Lock()
        """One writer of states to the store at a time, in the order in which they happened."""

    @property
    def occupies(self) -> bool:
        """True while a runner works for it on its cell; an uploaded recording moves nothing."""
        return self.record.mode != UPLOAD and self.record.state in OCCUPYING

    @property
    def ended(self) -> bool:
        """True in an end state."""
        return self.record.state in ENDED

    def set(self, state: State, now: datetime, facts: Mapping[str, Any] | None = None) -> StoredEvent:
        """Move to ``state``; WrongStateError where the machine does not allow it."""
        if not may_follow(self.record.state, state):
            raise WrongStateError(f"{self.record.state} → {state}")
        self.record = replace(
            self.record,
            state=state,
            started=now if state is State.RUNNING else self.record.started,
            ended=now if state in ENDED else self.record.ended,
            facts={**self.record.facts, **(facts or {})},
        )
        done = state in (State.AWAITING_ACCEPT, State.SUCCEEDED)
        # What belongs to the last state alone does not outlive it.
        self.progress = RunProgress(progress=1.0 if done else self.progress.progress, phase=str(state))
        if state in ENDED:
            self.note(progress=self.progress.progress)
        data = {
            "state": str(state),
            "simulated": self.record.simulated,
            **self.progress.model_dump(),
            **{k: self.record.facts[k] for k in ("error", "decision", "summary") if k in self.record.facts},
        }
        self.since = now
        event = self.events.append("state", data)
        if state in ENDED:
            self.events.close()
        return event

    def note(self, **facts: Any) -> None:
        """Keep facts of the run; stored with its next state."""
        self.record = replace(self.record, facts={**self.record.facts, **facts})

    def advance(self, progress: RunProgress) -> None:
        """Take over progress; it never runs backwards."""
        furthest = max(progress.progress, self.progress.progress)
        self.progress = progress.model_copy(update={"progress": furthest})
        data = {
            "state": str(self.record.state),
            "simulated": self.record.simulated,
            **self.progress.model_dump(),
        }
        self.events.append("progress", data)
