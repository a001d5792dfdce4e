"""Guard every request: size and stall limits of its body, its time, headers of the answer."""

from __future__ import annotations

import asyncio
import time
from typing import Any

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from invid_service.links import set_root
from invid_service.metrics import Metrics
from invid_service.problems import Problem
from invid_service.settings import Settings

UPLOADS = "/api/v1/recordings"
_HEADERS = [
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-frame-options", b"DENY"),
]


def _under(root: str, scope: Scope) -> Scope:
    """Return the request with the whole path, whether or not the reverse proxy cut ``root`` off it."""
    path = scope["path"]
    if root and path != root and not path.startswith(f"{root}/"):
        path = root + path
    return {**scope, "path": path, "root_path": root}


def _as_json(scope: Scope) -> Scope:
    """Return the request with the type of JSON where a program sent none, or an older name of it.

    A browser names its page's origin: a page elsewhere could otherwise send JSON in no type unasked.
    """
    headers = dict(scope["headers"])
    media = headers.get(b"content-type", b"").split(b";")[0].strip().lower()
    has_body = headers.get(b"content-length", b"0") != b"0" or b"transfer-encoding" in headers
    if not has_body or b"origin" in headers or media not in (b"", b"text/json", b"text/x-json"):
        return scope
    if scope["path"].rstrip("/").endswith(UPLOADS):
        return scope
    others = [h for h in scope["headers"] if h[0] != b"content-type"]
    return {**scope, "headers": [*others, (b"content-type", b"application/json")]}


class Guard:
    """ASGI middleware that bounds requests; streams pass through unbuffered."""

    def __init__(self, app: ASGIApp, settings: Settings, metrics: Metrics) -> None:
        self._app, self._settings, self._metrics = app, settings, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass one request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        scope = _under(self._settings.root_path, scope)
        set_root(self._settings.root_path)
        started, method = time.monotonic(), scope["method"]

        async def answer(message: Message) -> None:
            if message["type"] == "http.response.start":
                self._metrics.answered(method, message["status"], time.monotonic() - started)
                present = {name for name, _ in message["headers"]}
                message["headers"] = [*message["headers"], *(h for h in _HEADERS if h[0] not in present)]
            await send(message)

        scope = _as_json(scope)
        upload = scope["path"].rstrip("/") == self._settings.root_path + UPLOADS
        limit = self._settings.max_upload_bytes if upload else self._settings.max_body_bytes
        refusal = self._refusal(dict(scope["headers"]), limit)
        if refusal is not None:
            response = refusal.response(scope["path"])
            response.headers["Connection"] = "close"
            await response(scope, receive, answer)
            return
        await self._app(scope, self._limited(receive, limit), answer)

    def _refusal(self, headers: dict[bytes, bytes], limit: int) -> Problem | None:
        text = headers.get(b"content-length")
        if text is None:
            return None
        if not text.isdigit():
            return Problem("bad-request", "Content-Length is no number")
        if int(text) > limit:
            return Problem(
                "too-large", f"the body has {int(text)} bytes; at most {limit} are taken", limit=limit
            )
        return None

    def _limited(self, receive: Receive, limit: int) -> Receive:
        got = 0
        finished = False

        async def limited() -> Any:
            nonlocal got, finished
            if finished:  # after the body only the disconnect can come, whenever it likes
                return await receive()
            try:
                message = await asyncio.wait_for(receive(), self._settings.upload_stall_s)
            except TimeoutError:
                raise HTTPException(408, "nothing arrived for too long; send the body faster") from None
            if message["type"] == "http.request":
                got += len(message.get("body", b""))
                finished = not message.get("more_body", False)
                if got > limit:
                    raise HTTPException(413, f"more than {limit} bytes arrived")
            return message

        return limited
