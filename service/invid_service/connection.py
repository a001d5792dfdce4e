"""HTTP connections: what is no HTTP gets a problem document, and clients that hang crowd out no stop.

The size of a header is bounded by h11 (64 KiB), which is why this parser is used even where a faster one is
installed. There are never more connections than files may be open: a new one takes the place of the one that
has been silent longest, first of those that have asked for nothing.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import resource
import time

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from invid_service.problems import MEDIA_TYPE, document_of

_FILES = 65536
_RESERVED = 128
"""Files for all but connections: store, runners' pipes, results that are read."""
_LEAST = 16
_SILENT_S = 20.0
"""A connection whose first request has not arrived by then is closed."""


class Connection(H11Protocol):
    """HTTP protocol of uvicorn, with problem documents for what is no HTTP, and room for whoever comes."""

    heard = 0.0
    """When the client sent something last."""

    @property
    def is_served(self) -> bool:
        """Whether a request has arrived whole and its answer has not gone out."""
        return self.cycle is not None and not self.cycle.response_complete and not self.cycle.more_body

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a client; where there are too many, let go of the one that has been silent longest."""
        super().connection_made(transport)
        self.heard = time.monotonic()
        self.loop.call_later(_SILENT_S, self._end_if_silent)
        most = max(resource.getrlimit(resource.RLIMIT_NOFILE)[0] - _RESERVED, _LEAST)
        if len(self.connections) > most:
            others = [c for c in self.connections if isinstance(c, Connection) and c is not self]
            min(others, key=lambda c: (c.is_served, c.heard)).transport.abort()

    def data_received(self, data: bytes) -> None:
        """Take bytes of a request."""
        self.heard = time.monotonic()
        super().data_received(data)

    def _end_if_silent(self) -> None:
        if self.cycle is None and not self.transport.is_closing():
            self.transport.close()

    def send_400_response(self, msg: str) -> None:
        """Answer bytes that are no HTTP request with a problem document."""
        document = document_of("bad-request", msg)
        body = json.dumps(document).encode()
        headers = [
            (b"content-type", MEDIA_TYPE.encode()),
            (b"content-length", str(len(body)).encode()),
            (b"connection", b"close"),
        ]
        with contextlib.suppress(h11.LocalProtocolError):
            for event in (
                h11.Response(status_code=document["status"], headers=headers, reason=b"Bad Request"),
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
