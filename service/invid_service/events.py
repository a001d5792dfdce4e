"""Log the events of a run and stream them as server-sent events.

Ids grow with the clock in milliseconds, so that they keep growing over a restart of the service and a
reader can resume with ``Last-Event-ID`` whatever happened in between.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from typing import Any

from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event

from invid.wording.sentence import with_wording
from invid_service.store.store import StoredEvent

KEPT = 5000
"""Events kept in memory per run; beyond it the oldest progress goes, states are in the store."""


class EventLog:
    """Events of one run: appended on the event loop, read by any number of followers."""

    def __init__(
        self, stored: Iterable[StoredEvent] = (), *, now_ms: Callable[[], int] | None = None
    ) -> None:
        self._events: deque[StoredEvent] = deque(stored, maxlen=KEPT)
        self._last = self._events[-1].id if self._events else 0
        self._now_ms = now_ms or (lambda: int(time.time() * 1000))
        self._closed = False
        self.news = asyncio.Event()
        """Set at the next event, or the end; then another one takes its place."""

    def append(self, kind: str, data: Mapping[str, Any]) -> StoredEvent:
        """Add an event and wake the followers."""
        self._last = max(self._last + 1, self._now_ms())
        event = StoredEvent(self._last, kind, data)
        self._events.append(event)
        self._wake()
        return event

    def close(self) -> None:
        """End the log: followers end after the last event."""
        self._closed = True
        self._wake()

    def _wake(self) -> None:
        self.news.set()
        self.news = asyncio.Event()

    def behind(self, after: int) -> list[StoredEvent]:
        """Return events with ids above ``after``."""
        return [e for e in self._events if e.id > after]

    async def follow(self, after: int, keep_alive_s: float) -> AsyncIterator[StoredEvent | None]:
        """Yield events with ids above ``after``; ``None`` where nothing happened for ``keep_alive_s``."""
        while True:
            news, closed = self.news, self._closed
            for event in self.behind(after):
                after = event.id
                yield event
            if news.is_set():
                continue
            if closed:
                return
            try:
                await asyncio.wait_for(news.wait(), keep_alive_s)
            except TimeoutError:
                yield None


def sse(event: StoredEvent | None) -> bytes:
    """Return one event as bytes of a stream; without one a comment that keeps the connection alive."""
    if event is None:
        return KEEPALIVE_COMMENT
    data = json.dumps(with_wording(event.data), ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return format_sse_event(data_str=data, event=event.type, id=str(event.id))
