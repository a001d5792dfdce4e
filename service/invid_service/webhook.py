"""Send a message to another system at every run's end, signed and retried.

The form is that of Standard Webhooks (standardwebhooks.com): headers ``webhook-id``, ``webhook-timestamp``
and ``webhook-signature``, the last ``v1,`` and the Base64 of HMAC-SHA256 over ``id.timestamp.body``. The
receiver checks the signature, refuses old timestamps and ids that it has seen: a message may come twice.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import json
import logging
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from invid.errors import ConfigError
from invid_service.settings import Settings

log = logging.getLogger(__name__)

WAITS_S = (1.0, 5.0, 30.0, 120.0, 600.0, 3600.0)
"""Between the tries: a receiver that restarts misses nothing, one that is gone for two hours does."""
ANSWER_S = 10.0
MOST_WAITING = 1000
"""Messages kept in memory; beyond that the receiver has to ask ``GET /identifications``."""
LEAST_SECRET = 24


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Handler that follows no redirect: a signed message goes where the settings say and nowhere else."""

    def redirect_request(self, *_: Any) -> None:
        """Refuse to follow a redirect."""


class Webhook:
    """Sender of messages in the background; ``close`` gives up what was not delivered."""

    def __init__(
        self, url: str, secret: bytes, clock: Callable[[], datetime], waits_s: Sequence[float] = WAITS_S
    ) -> None:
        self._url, self._secret, self._clock, self._waits = url, secret, clock, waits_s
        self._tasks: set[asyncio.Task[None]] = set()
        self._open = urllib.request.build_opener(_NoRedirect).open

    def send(self, identity: str, document: dict[str, Any]) -> None:
        """Queue one message; never waits. To be called in the event loop."""
        if len(self._tasks) >= MOST_WAITING:
            log.error("webhook: %d messages wait already; %s is not sent", MOST_WAITING, identity)
            return
        task = asyncio.ensure_future(self._deliver(identity, json.dumps(document).encode()))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def close(self) -> None:
        """Give up what is still on its way."""
        for task in tuple(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _deliver(self, identity: str, body: bytes) -> None:
        host = urlsplit(self._url).hostname  # an address may hold a token in its path: logs get the host
        for wait in (*self._waits, None):
            problem = await asyncio.to_thread(self._post, identity, body)
            if problem is None:
                return
            if wait is None:
                log.error("webhook: %s was not taken by %s: %s; given up", identity, host, problem)
                return
            log.warning("webhook: %s was not taken by %s: %s; again in %g s", identity, host, problem, wait)
            await asyncio.sleep(wait)

    def _post(self, identity: str, body: bytes) -> str | None:
        """Send once; return what went wrong, if anything did."""
        stamp = str(int(self._clock().timestamp()))
        headers = {
            "Content-Type": "application/json",
            "webhook-id": identity,
            "webhook-timestamp": stamp,
            "webhook-signature": signature(self._secret, identity, stamp, body),
        }
        request = urllib.request.Request(self._url, data=body, headers=headers, method="POST")
        try:
            with self._open(request, timeout=ANSWER_S):
                return None
        except urllib.error.HTTPError as error:
            return f"status {error.code}"
        except (OSError, ValueError) as error:
            return type(error).__name__


def signature(secret: bytes, identity: str, stamp: str, body: bytes) -> str:
    """Return the header ``webhook-signature`` of one message."""
    signed = b".".join((identity.encode(), stamp.encode(), body))
    return "v1," + base64.b64encode(hmac.new(secret, signed, hashlib.sha256).digest()).decode()


def open_webhook(settings: Settings, clock: Callable[[], datetime]) -> Webhook | None:
    """Return the webhook of the settings, ``None`` where none is set; ConfigError where it cannot be
    signed.
    """
    if settings.webhook_url is None:
        return None
    if settings.webhook_secret_file is None:
        raise ConfigError(
            "webhook_url is set, webhook_secret_file is not; messages are signed: name a file with a secret"
        )
    return Webhook(settings.webhook_url, _secret(settings.webhook_secret_file), clock)


def _secret(path: Path) -> bytes:
    try:
        secret = path.read_bytes().strip()
    except OSError as error:
        raise ConfigError(f"webhook secret {path}: cannot be read: {error.strerror}") from None
    if len(secret) < LEAST_SECRET:
        raise ConfigError(f"webhook secret {path}: {len(secret)} bytes; at least {LEAST_SECRET} are needed")
    return secret
