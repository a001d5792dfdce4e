"""Decide who may call what: by the key a request presents and the place it comes from.

Without a key file the service is open to this machine alone, and only while it is bound to loopback. With
one, everyone is asked for a key, loopback too: behind a reverse proxy every request comes from loopback.
"""

from __future__ import annotations

from datetime import UTC, datetime

from fastapi import Request

from invid.errors import ConfigError
from invid_service.keys import LOCAL, Caller, KeyRefusedError, Keys
from invid_service.problems import Problem
from invid_service.settings import Settings, is_loopback

OWN_PAGE = "x-requested-with"
FORWARDED = ("forwarded", "x-forwarded-for", "x-forwarded-host", "x-real-ip", "via")
"""Headers that a reverse proxy adds: with one of them a request from loopback may come from anywhere."""


def check_bind(settings: Settings, keys: Keys) -> None:
    """Refuse settings that let others reach the service without a key."""
    way_out = "make one with 'invid keys add NAME:read,run,accept --key-file F' and start with --key-file F"
    if not settings.loopback and not keys:
        raise ConfigError(
            f"host {settings.host!r} can be reached from outside and no key is configured; {way_out}, "
            "or bind to 127.0.0.1"
        )
    if settings.trusted_proxies and not keys.configured:
        raise ConfigError(
            f"a reverse proxy ({', '.join(settings.trusted_proxies)}) lets others reach this service and no "
            f"key is configured; {way_out}"
        )


def _token(request: Request) -> str | None:
    scheme, _, value = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and value.strip():
        return value.strip()
    if scheme:
        return scheme + value  # another scheme is no key of ours, and must not pass as "no key"
    return request.headers.get("x-api-key")


def identify_caller(request: Request) -> Caller:
    """Return the caller of a request; Problem where a key is needed or wrong.

    Where no keys are configured nobody is asked, but only this machine may call: not a page of another site
    in the technician's browser (Host and Origin tell), and nobody through a reverse proxy.
    """
    settings: Settings = request.app.state.service.settings
    keys: Keys = request.app.state.service.keys
    refuse_other_sites(request)
    token = _token(request)
    if not keys.configured and settings.loopback:
        if token is not None:
            raise _refused("no keys are configured, so none can be honoured; leave it out")
        _refuse_from_elsewhere(request)
        return LOCAL
    if token is None:
        raise Problem(
            "key-missing", "send a key as 'Authorization: Bearer …'", {"WWW-Authenticate": "Bearer"}
        )
    try:
        return keys.caller(token, datetime.now(UTC))
    except KeyRefusedError as error:
        raise _refused(str(error)) from None


def _refused(why: str) -> Problem:
    return Problem("key-invalid", why, {"WWW-Authenticate": "Bearer"})


def _refuse_from_elsewhere(request: Request) -> None:
    name = _host_name(request)
    if name and not is_loopback(name):
        raise Problem(
            "foreign-origin",
            f"host {name!r} is not this machine, and the service is bound to loopback without keys; "
            "configure keys to let others in",
        )
    if any(header in request.headers for header in FORWARDED):
        raise Problem(
            "foreign-origin",
            "a reverse proxy forwards here, and the service has no keys: who reaches the proxy could move "
            "the robot. Start it with --key-file",
        )


def _host_name(request: Request) -> str:
    host = request.headers.get("host", "")
    return host if host.endswith("]") else host.rsplit(":", 1)[0]


def refuse_other_sites(request: Request) -> None:
    """Raise Problem where another site's page calls: its origin is not the host that was asked for.

    A proxy may have changed the host: our own page is known by a header too that a browser adds to no other
    site's request without asking the service first.
    """
    origin = request.headers.get("origin")
    if not origin or request.method in ("GET", "HEAD", "OPTIONS"):
        return
    host = request.headers.get("host", "")
    if origin in (f"http://{host}", f"https://{host}") or request.headers.get(OWN_PAGE) == "invid":
        return
    raise Problem(
        "foreign-origin",
        f"a page of {origin!r} may not call this service, which was asked for as {host!r}; a reverse "
        f"proxy has to pass the header Host on, or the page has to send {OWN_PAGE}: invid",
    )
