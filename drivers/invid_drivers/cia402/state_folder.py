"""The folder in which a user's runs remember what they did to each bus: no link is followed in it, and what
another user could have written is not believed."""

from __future__ import annotations

import contextlib
import errno
import os
import pwd
import queue
import stat
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from invid.errors import BusError
from invid.wording.sentence import sentence

SERVICES, EVERYBODYS = Path("/var/lib/invid"), Path("/var/tmp")
"""The service's own folder, where there is one, and where every other user has one of his own."""
PART = ".part"
PATIENCE_S = 10.0
"""Longest wait for a disk while no axis is energised."""
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


def unwritten(file: str, error: OSError, meaning: str) -> BusError:
    """What to raise where a file cannot be written."""
    return BusError(
        sentence(
            "{file}: cannot be written ({strerror}){meaning}",
            file=file,
            strerror=error.strerror,
            meaning=meaning,
        )
    )


class StateFile:
    """A file of this folder; no cycle waits for what is written into it, by a thread of its own.

    ``path`` ``None``: nothing is kept beyond this process. ``name``: what it is called where it fails.
    """

    def __init__(self, path: Path | None, name: str = "") -> None:
        self.path, self._name = path, f"{name} {path}".strip()
        self._todo: queue.Queue[tuple[Callable[[], None], str]] = queue.Queue()
        self._failed: list[BusError] = []
        self._writer: threading.Thread | None = None
        self._deferred = False

    def append(self, line: bytes, meaning: str) -> None:
        """Add a line."""
        if self.path is not None:
            self._put(partial(append_line, self.path, line), meaning)

    def replace(self, data: bytes, meaning: str) -> None:
        """Put this in the place of what it held."""
        if self.path is not None:
            self._put(partial(replace_state, self.path, data), meaning)

    def _put(self, write: Callable[[], None], meaning: str) -> None:
        """Queue a write and wait for it unless deferred. BusError where it failed, with what that means, or
        takes too long."""
        if self._writer is None:
            self._writer = threading.Thread(target=self._work, name="disk", daemon=True)
            self._writer.start()
        self._todo.put((write, meaning))
        if not self._deferred:
            self.settle()

    def defer(self) -> None:
        """Queue writes without waiting for them, until ``settle``."""
        self._deferred = True

    def settle(self) -> None:
        """Wait until every write is done; BusError where one failed or takes too long."""
        self._deferred = False
        with self._todo.all_tasks_done:
            is_done = self._todo.all_tasks_done.wait_for(lambda: not self._todo.unfinished_tasks, PATIENCE_S)
        if not is_done:
            raise BusError(
                sentence(
                    "the disk has not taken what is to be remembered of this bus for {patience_s:g} s; "
                    "look at it before anything is enabled",
                    patience_s=PATIENCE_S,
                )
            )
        if self._failed:
            raise self._failed.pop()

    def _work(self) -> None:
        while True:
            write, meaning = self._todo.get()
            try:
                write()
            except OSError as error:
                self._failed.append(unwritten(self._name, error, meaning))
            self._todo.task_done()


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
