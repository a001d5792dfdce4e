"""HTTP connections: what is no HTTP gets a problem document, and clients that hang crowd out no stop.

The size of a header is bounded by h11 (64 KiB), which is why this parser is used even where a faster one is
installed. How long a client may take for one is the reverse proxy's matter.
"""

from __future__ import annotations

import contextlib
import json
import resource

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from invid_service.problems import CATALOGUE, MEDIA_TYPE, URN

_FILES = 65536


class Connection(H11Protocol):
    """HTTP protocol of uvicorn, with problem documents for what is no HTTP."""

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
