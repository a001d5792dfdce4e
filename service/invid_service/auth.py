"""Keys with scopes, kept as hashes; who may call what.

A key reads ``invid_<id>_<secret>``; the secret has 256 random bits, so one SHA-256 is a sufficient hash
(there is nothing to guess from a dictionary). Keys travel in the ``Authorization: Bearer`` or
``X-API-Key`` header, never in an address, where logs would keep them.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated

from fastapi import Depends, Request
from pydantic import BaseModel, ConfigDict, ValidationError

from invid.errors import ConfigError
from invid.model.document import save_text
from invid_service.problems import Problem
from invid_service.settings import Settings, is_loopback


class Scope(StrEnum):
    """What a key may do; ``admin`` includes the others."""

    READ = "read"
    RUN = "run"
    ACCEPT = "accept"
    ADMIN = "admin"


class _Key(BaseModel):
    model_config = ConfigDict(extra="forbid")
    id: str
    name: str
    scopes: list[Scope]
    sha256: str
    expires: datetime | None = None


class _KeyFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    keys: list[_Key]


@dataclass(frozen=True)
class Caller:
    """Who is calling."""

    name: str
    scopes: frozenset[Scope]

    def may(self, scope: Scope) -> bool:
        """True where the scope is given, by itself or through ``admin``."""
        return scope in self.scopes or Scope.ADMIN in self.scopes


LOCAL = Caller("local", frozenset(Scope))


class Keys:
    """The keys of one file, in memory: checking one touches no disk."""

    def __init__(self, keys: Iterable[_Key] = ()) -> None:
        self._keys = {key.id: key for key in keys}

    def __bool__(self) -> bool:
        return bool(self._keys)

    @classmethod
    def load(cls, path: Path) -> Keys:
        """Keys from the file; ConfigError says what is wrong with it."""
        try:
            return cls(_KeyFile.model_validate_json(path.read_text(encoding="utf-8")).keys)
        except FileNotFoundError:
            raise ConfigError(
                f"key file {path}: no such file; 'invid serve --key-file {path} --add-key NAME:read,run' "
                f"makes one"
            ) from None
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"key file {path}: cannot be read: {error}") from None
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]
            where = ".".join(str(part) for part in first["loc"])
            raise ConfigError(f"key file {path}: {where}: {first['msg']}") from None

    def caller(self, token: str, now: datetime) -> Caller:
        """Whose key this is; Problem where it is nobody's or expired."""
        parts = token.split("_", 2)
        key = self._keys.get(parts[1]) if len(parts) == 3 and parts[0] == "invid" else None
        digest = hashlib.sha256(token.encode("utf-8", "replace")).hexdigest()
        if not hmac.compare_digest(digest, key.sha256 if key else "0" * 64) or key is None:
            raise Problem("key-invalid", "the key is unknown", {"WWW-Authenticate": "Bearer"})
        expires = key.expires
        if expires is not None and (expires if expires.tzinfo else expires.replace(tzinfo=UTC)) <= now:
            raise Problem(
                "key-invalid",
                f"the key {key.name!r} expired on {expires:%Y-%m-%d}",
                {"WWW-Authenticate": "Bearer"},
            )
        return Caller(key.name, frozenset(key.scopes))


def add_key(path: Path, name: str, scopes: Iterable[str], *, expires: datetime | None = None) -> str:
    """Add a key to the file (mode 0600) and return it: it is shown this once and never stored."""
    try:
        wanted = [Scope(scope) for scope in scopes]
    except ValueError as error:
        raise ConfigError(f"key {name!r}: {error}; scopes are {', '.join(Scope)}") from None
    if not name or not wanted:
        raise ConfigError(f"key {name!r}: a name and at least one scope are needed: NAME:read,run")
    if path.exists():
        Keys.load(path)
    document = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"keys": []}
    identity = secrets.token_hex(4)
    token = f"invid_{identity}_{secrets.token_urlsafe(32)}"
    document["keys"].append(
        {
            "id": identity,
            "name": name,
            "scopes": [str(s) for s in wanted],
            "sha256": hashlib.sha256(token.encode()).hexdigest(),
            "expires": None if expires is None else expires.isoformat(),
        }
    )
    save_text(path, json.dumps(document, indent=2) + "\n")
    os.chmod(path, 0o600)
    return token


def check_bind(settings: Settings, keys: Keys) -> None:
    """Refuse to be reached from outside without a key."""
    if not settings.loopback and not keys:
        raise ConfigError(
            f"host {settings.host!r} can be reached from outside and no key is configured; "
            f"make one with 'invid serve --key-file keys.json --add-key NAME:read,run,accept' and start with "
            f"--key-file keys.json, or bind to 127.0.0.1"
        )


def _token(request: Request) -> str | None:
    scheme, _, value = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and value.strip():
        return value.strip()
    if scheme:
        return scheme + value  # another scheme is no key of ours, and must not pass as "no key"
    return request.headers.get("x-api-key")


def identify_caller(request: Request) -> Caller:
    """Who calls; Problem where a key is needed or wrong.

    On loopback no key is needed, but a key that is presented is honoured with its scopes, and a wrong
    one is refused. What keeps a web page in the technician's browser from moving the robot through
    loopback is the check of Host and Origin.
    """
    settings: Settings = request.app.state.service.settings
    keys: Keys = request.app.state.service.keys
    _refuse_other_sites(request, settings)
    token = _token(request)
    if token is not None:
        return keys.caller(token, datetime.now(UTC))
    if settings.loopback:
        return LOCAL
    raise Problem("key-missing", "send a key as 'Authorization: Bearer …'", {"WWW-Authenticate": "Bearer"})


def _refuse_other_sites(request: Request, settings: Settings) -> None:
    host = request.headers.get("host", "")
    name = host.rsplit(":", 1)[0] if not host.endswith("]") else host
    if settings.loopback and host and not is_loopback(name) and name != "testserver":
        raise Problem(
            "foreign-origin", f"host {name!r} is not this machine; the service is bound to loopback"
        )
    origin = request.headers.get("origin")
    if origin and request.method not in ("GET", "HEAD", "OPTIONS"):
        own = {f"{request.url.scheme}://{host}", f"http://{host}", f"https://{host}"}
        if origin not in own:
            raise Problem("foreign-origin", f"a page of {origin!r} may not call this service")


class Require:
    """Dependency: the caller, who must have ``scope`` (``None``: any valid key)."""

    def __init__(self, scope: Scope | None) -> None:
        self.scope = scope

    async def __call__(self, request: Request) -> Caller:
        caller = identify_caller(request)
        if self.scope is not None and not caller.may(self.scope):
            raise Problem(
                "scope-missing",
                f"the key {caller.name!r} lacks the scope {self.scope}",
                scope=str(self.scope),
            )
        return caller


Reader = Annotated[Caller, Depends(Require(Scope.READ))]
Runner = Annotated[Caller, Depends(Require(Scope.RUN))]
Accepter = Annotated[Caller, Depends(Require(Scope.ACCEPT))]
Admin = Annotated[Caller, Depends(Require(Scope.ADMIN))]
Anyone = Annotated[Caller, Depends(Require(None))]
