"""The folder in which a user's runs remember what they did to each bus: no link is followed in it, and what
another user could have written is not believed."""

from __future__ import annotations

import contextlib
import errno
import os
import pwd
import stat
from collections.abc import Iterator
from pathlib import Path

SERVICES, EVERYBODYS = Path("/var/lib/invid"), Path("/var/tmp")
"""The service's own folder, where there is one, and where every other user has one of his own."""
PART = ".part"
_SAFE = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC  # a planted pipe must not hold a run up either


def state_folder() -> Path:
    """Folder of the journals and memories of this user. ``XDG_STATE_HOME`` overrides it."""
    own = os.environ.get("XDG_STATE_HOME")
    if own:
        return Path(own) / "invid"
    with contextlib.suppress(OSError):
        if SERVICES.stat().st_uid == os.geteuid():
            return SERVICES
    return EVERYBODYS / f"invid-{os.geteuid()}"


def files_of_others(path: Path) -> tuple[Path, ...]:
    """What other users remember of the same bus; nothing where the folder is not one that they know."""
    if path.parent != state_folder() or os.environ.get("XDG_STATE_HOME"):
        return ()
    folders = [SERVICES, *sorted(EVERYBODYS.glob("invid-*"))]
    return tuple(f / path.name for f in folders if f != path.parent and os.path.lexists(f / path.name))


def owner_of(path: Path) -> str:
    """Name of the user whose file this is."""
    return _name(path.lstat().st_uid)


def require_writable(folder: Path) -> None:
    """OSError where nothing could be remembered in this folder, which is made where it is missing."""
    with _opened(folder, make=True) as place:
        if not os.access(".", os.W_OK, dir_fd=place):
            raise OSError(errno.EACCES, "it cannot be written")


def read_state(path: Path, *, of_another: bool = False) -> bytes | None:
    """Bytes of a file, ``None`` where there is none. OSError where it is a link, or another user could have
    written it; not that with ``of_another``, for whoever believes only what makes him careful."""
    with (
        contextlib.suppress(FileNotFoundError),
        _opened(path.parent, of_another=of_another) as place,
        os.fdopen(_open(path.name, os.O_RDONLY, place), "rb") as file,
    ):
        _require_own(file.fileno(), of_another)
        return file.read()
    return None


def append_line(path: Path, line: bytes) -> None:
    """Add a line for good; OSError where it is not on disk."""
    with _opened(path.parent, make=True) as place:
        with os.fdopen(_open(path.name, os.O_RDWR | os.O_APPEND | os.O_CREAT, place), "r+b", 0) as file:
            _require_own(file.fileno())
            # A line that a power cut left half written must not take this one with it.
            file.seek(max(0, file.seek(0, os.SEEK_END) - 1))
            torn = file.read(1) not in (b"", b"\n")
            file.write(b"\n" * torn + line)
            os.fsync(file.fileno())
        os.fsync(place)


def replace_state(path: Path, data: bytes) -> None:
    """Put a file in the place of the one before, or remove it where nothing is left to say.

    A power cut leaves one of them. OSError where it is not on disk.
    """
    with _opened(path.parent, make=True) as place:
        part = path.name + PART
        for name in (part,) if data else (part, path.name):
            with contextlib.suppress(FileNotFoundError):
                os.unlink(name, dir_fd=place)
        if data:
            with os.fdopen(_open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, place), "wb", 0) as file:
                file.write(data)
                os.fchmod(file.fileno(), 0o644)  # whoever measures next is to know it, whatever this umask
                os.fsync(file.fileno())
            os.replace(part, path.name, src_dir_fd=place, dst_dir_fd=place)
        os.fsync(place)


@contextlib.contextmanager
def _opened(folder: Path, *, make: bool = False, of_another: bool = False) -> Iterator[int]:
    made = False
    if make:
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o755, parents=True)
            made = True
    place = _open(str(folder), os.O_RDONLY | os.O_DIRECTORY)
    try:
        if made:
            os.fchmod(place, 0o755)
        found = os.fstat(place)
        if not of_another:
            _require_owner(found, "its folder")
            if found.st_mode & stat.S_IWOTH and not found.st_mode & stat.S_ISVTX:
                raise OSError(errno.EPERM, f"its folder can be written by everybody: chmod o-w {folder}")
        yield place
    finally:
        os.close(place)


def _open(name: str, flags: int, place: int | None = None) -> int:
    try:
        return os.open(name, flags | _SAFE, 0o644, dir_fd=place)
    except OSError as error:
        if error.errno == errno.ELOOP or (error.errno == errno.ENOTDIR and os.path.islink(name)):
            raise OSError(error.errno, "it is a link, which anybody may have put there: remove it") from None
        raise


def _require_own(file: int, of_another: bool = False) -> None:
    found = os.fstat(file)
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EPERM, "it is no file: remove it")
    if of_another:
        return
    _require_owner(found, "it")
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise OSError(
            errno.EPERM, "others can write it, so it may say anything: read it, then chmod go-w, or remove it"
        )


def _require_owner(found: os.stat_result, what: str) -> None:
    if found.st_uid not in (0, os.geteuid()):
        raise OSError(errno.EPERM, f"{what} belongs to user {_name(found.st_uid)}")


def _name(user: int) -> str:
    with contextlib.suppress(KeyError):
        return pwd.getpwuid(user).pw_name
    return str(user)
