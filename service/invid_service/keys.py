"""Keys with scopes, kept as hashes in a file that may change while the service runs.

A key reads ``invid_<id>_<secret>``; the secret has 256 random bits, so one SHA-256 is a sufficient hash
(there is nothing to guess from a dictionary). Keys travel in the ``Authorization: Bearer`` or
``X-API-Key`` header, never in an address, where logs would keep them.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import logging
import os
import secrets
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from invid.errors import ConfigError
from invid.model.document import save_text

log = logging.getLogger(__name__)


class Scope(StrEnum):
    """What a key may do; ``admin`` includes the others."""

    READ = "read"
    RUN = "run"
    ACCEPT = "accept"
    ADMIN = "admin"


class Key(BaseModel):
    """One key as the file holds it: everything but the secret."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    id: str
    name: str
    scopes: list[Scope]
    sha256: str
    expires: datetime | None = None

    def expired(self, now: datetime) -> bool:
        """True from the stated instant on; a time without a zone is UTC."""
        end = self.expires
        return end is not None and (end if end.tzinfo else end.replace(tzinfo=UTC)) <= now


class _KeyFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    keys: list[Key]


@dataclass(frozen=True)
class Caller:
    """Who is calling."""

    name: str
    scopes: frozenset[Scope]

    def may(self, scope: Scope) -> bool:
        """True where the scope is given, by itself or through ``admin``."""
        return scope in self.scopes or Scope.ADMIN in self.scopes


LOCAL = Caller("local", frozenset(Scope))
NOBODY = Caller("nobody", frozenset())
"""Without a key: may stop, and nothing else."""


class KeyRefusedError(Exception):
    """A key that opens nothing; the text says why."""


def read_keys(path: Path) -> list[Key]:
    """Return the keys of a file; ConfigError says what is wrong with it."""
    try:
        return _KeyFile.model_validate_json(path.read_text(encoding="utf-8")).keys
    except FileNotFoundError:
        raise ConfigError(
            f"key file {path}: no such file; 'invid keys add NAME:read,run --key-file {path}' makes one"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"key file {path}: cannot be read: {error}") from None
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"key file {path}: {where}: {first['msg']}") from None


class Keys:
    """The keys in force, in memory: checking one touches no disk, so that a stop never waits for one.

    Attributes
    ----------
    configured
        Whether a key file was named. Then everyone is asked for a key, even where the file is empty:
        revoking the last key must not open the service.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self.configured = path is not None
        self._seen = _stamp(path)
        self._keys = {} if path is None else {key.id: key for key in read_keys(path)}

    def __bool__(self) -> bool:
        return bool(self._keys)

    def reload(self) -> bool:
        """Read the file again where it has changed; return whether it had. One that cannot be read
        changes nothing.
        """
        if self._path is None or (stamp := _stamp(self._path)) == self._seen:
            return False
        self._seen = stamp
        try:
            self._keys = {key.id: key for key in read_keys(self._path)}
        except ConfigError as error:
            log.error("%s; the keys read before stay in force", error)
            return False
        log.info("key file %s: %d keys in force", self._path, len(self._keys))
        return True

    def caller(self, token: str, now: datetime) -> Caller:
        """Return whose key this is; KeyRefusedError where it is nobody's or expired."""
        parts = token.split("_", 2)
        key = self._keys.get(parts[1]) if len(parts) == 3 and parts[0] == "invid" else None
        digest = hashlib.sha256(token.encode("utf-8", "replace")).hexdigest()
        if not hmac.compare_digest(digest, key.sha256 if key else "0" * 64) or key is None:
            raise KeyRefusedError("the key is unknown")
        if key.expired(now):
            raise KeyRefusedError(f"the key {key.name!r} expired on {key.expires:%Y-%m-%d}")
        return Caller(key.name, frozenset(key.scopes))


def _stamp(path: Path | None) -> tuple[int, int, int] | None:
    """Return what tells one version of a file from the next; ``None`` where there is no file."""
    try:
        found = None if path is None else path.stat()
    except OSError:
        return None
    return None if found is None else (found.st_mtime_ns, found.st_size, found.st_ino)


def add_key(path: Path, name: str, scopes: Iterable[str], *, expires: datetime | None = None) -> str:
    """Add a key to the file (mode 0600) and return it: it is shown this once and never stored."""
    try:
        wanted = [Scope(scope) for scope in scopes]
    except ValueError as error:
        raise ConfigError(f"key {name!r}: {error}; scopes are {', '.join(Scope)}") from None
    if not name or not wanted:
        raise ConfigError(f"key {name!r}: a name and at least one scope are needed: NAME:read,run")
    keys = read_keys(path) if path.exists() else []
    identity = secrets.token_hex(4)
    token = f"invid_{identity}_{secrets.token_urlsafe(32)}"
    digest = hashlib.sha256(token.encode()).hexdigest()
    _save(path, [*keys, Key(id=identity, name=name, scopes=wanted, sha256=digest, expires=expires)])
    return token


def revoke_key(path: Path, identity: str) -> Key:
    """Take the key of that id, or of that name where only one has it, out of the file; return it."""
    keys = read_keys(path)
    found = [k for k in keys if k.id == identity] or [k for k in keys if k.name == identity]
    if len(found) != 1:
        known = ", ".join(f"{k.id} ({k.name})" for k in keys) or "none"
        why = "is the name of several keys: give the id" if found else "is neither id nor name of a key"
        raise ConfigError(f"key file {path}: {identity!r} {why}; the file has {known}")
    _save(path, [k for k in keys if k is not found[0]])
    return found[0]


def _save(path: Path, keys: Iterable[Key]) -> None:
    document = {"keys": [k.model_dump(mode="json") for k in keys]}
    save_text(path, json.dumps(document, indent=2) + "\n")
    os.chmod(path, 0o600)
