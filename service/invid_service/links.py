"""Make addresses for answers, under the path that a reverse proxy shows the service at."""

from __future__ import annotations

from contextvars import ContextVar

API = "/api/v1"
_root: ContextVar[str] = ContextVar("invid_root_path", default="")


def set_root(path: str) -> None:
    """Set the path in front of every address, for the request in progress."""
    _root.set(path)


def address(*parts: str) -> str:
    """Return ``/api/v1/…`` of these parts, as the caller can ask for it."""
    return "/".join((_root.get() + API, *parts))
