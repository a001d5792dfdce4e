"""Serve one HTTP connection, with a bound on what a client may make the service wait and keep.

uvicorn waits for a request's header as long as the client likes, so that a few hundred clients that send a
byte now and then would take every file descriptor, and a stop could no longer connect. Here a connection that
does not bring a whole header in time is closed. The size of a header is bounded by h11 (64 KiB), which is
why this parser is used even where a faster one is installed.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import resource
from typing import Any, ClassVar

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from invid_service.problems import CATALOGUE, MEDIA_TYPE, URN

_FILES = 65536


class Connection(H11Protocol):
    """HTTP protocol of uvicorn with a deadline for headers, and problem documents for what is no HTTP."""

    header_timeout_s: ClassVar[float] = 20.0

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the deadline of the first header."""
        super().connection_made(transport)
        self._expect()

    def data_received(self, data: bytes) -> None:
        """Take in bytes; further bytes of a header do not put its deadline off."""
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._expected()
        elif self._deadline is None:
            self._expect()

    def on_response_complete(self) -> None:
        """Stop the deadline after an answer; between requests uvicorn's own keep-alive counts."""
        self._expected()
        super().on_response_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the deadline of a closed connection."""
        self._expected()
        super().connection_lost(exc)

    def _expect(self) -> None:
        self._deadline = self.loop.call_later(self.header_timeout_s, self._give_up)

    def _expected(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _give_up(self) -> None:
        if self.conn.their_state is h11.IDLE and not self.transport.is_closing():
            self.transport.close()

    def send_400_response(self, msg: str) -> None:
        """Answer bytes that are no HTTP request with a problem document."""
        status, title = CATALOGUE["bad-request"]
        document = {"type": f"{URN}bad-request", "title": title, "status": status, "detail": msg}
        body = json.dumps(document).encode()
        headers = [
            (b"content-type", MEDIA_TYPE.encode()),
            (b"content-length", str(len(body)).encode()),
            (b"connection", b"close"),
        ]
        with contextlib.suppress(h11.LocalProtocolError):
            for event in (
                h11.Response(status_code=status, headers=headers, reason=b"Bad Request"),
                h11.Data(data=body),
                h11.EndOfMessage(),
            ):
                self.transport.write(self.conn.send(event) or b"")
        self.transport.close()


def allow_many_connections() -> None:
    """Raise the limit of open files as far as the system lets it: clients that hang do not crowd out a
    stop.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _FILES if hard == resource.RLIM_INFINITY else min(hard, _FILES)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
