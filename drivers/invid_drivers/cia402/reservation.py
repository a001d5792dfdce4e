"""One master a bus: whoever has it keeps every other process of this computer from it, of any user."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import pwd
import socket
import struct
import sys
import tempfile
import time
from pathlib import Path

from invid.errors import BusError
from invid.wording.sentence import sentence

PATIENCE_S = 5.0
"""For an orphaned cycle process that stops its drives: fade, quick stop and restoring take two seconds."""


class Reservation:
    """A bus has one master: a second one would take drives out of operation under the first, and its journal.

    Held as a name of the kernel's (an abstract AF_UNIX address, one for a network namespace as its CAN
    interfaces are): no folder, no permissions, and it ends with the process, however that dies. Elsewhere
    than on Linux it is a locked file in the folder for temporary files. A cycle process whose parent was
    killed is still stopping its drives: the next one waits for it.

    Raises
    ------
    BusError
        Another process has the bus and keeps it, or nobody can tell.
    """

    def __init__(
        self, interface: str, channel: str, patience_s: float = PATIENCE_S, *, named: bool | None = None
    ) -> None:
        self._held: socket.socket | int | None = None
        key = f"{interface.lower()} {os.path.realpath(channel) if '/' in channel else channel}"
        digest = hashlib.sha256(key.encode()).hexdigest()[:32]
        take = self._take_name if (sys.platform == "linux" if named is None else named) else self._take_file
        end = time.monotonic() + patience_s
        while True:
            try:
                take(digest)
                return
            except OSError as error:
                if error.errno not in (errno.EADDRINUSE, errno.EWOULDBLOCK):
                    raise BusError(
                        sentence(
                            "bus {interface} {channel}: cannot be reserved ({why}), so another "
                            "process may be "
                            "using it; nothing is sent",
                            interface=interface,
                            channel=channel,
                            why=error.strerror or error,
                        )
                    ) from None
                if time.monotonic() >= end:
                    raise BusError(
                        sentence(
                            "bus {interface} {channel}: another invid process is using this bus{holder}; "
                            "wait until its measurement has ended, or stop it",
                            interface=interface,
                            channel=channel,
                            holder=_holder(digest),
                        )
                    ) from None
                time.sleep(0.05)

    def _take_name(self, digest: str) -> None:
        held = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            held.bind(_address(digest))
            held.listen(8)
        except BaseException:
            held.close()
            raise
        self._held = held

    def _take_file(self, digest: str) -> None:
        path = Path(tempfile.gettempdir()) / f"invid-bus-{digest}.lock"
        held = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BaseException:
            os.close(held)
            raise
        self._held = held

    @classmethod
    def await_free(cls, interface: str, channel: str, longest_s: float) -> bool:
        """Whether nobody has the bus, or gives it free within this time."""
        try:
            cls(interface, channel, longest_s).release()
        except BusError:
            return False
        return True

    def release(self) -> None:
        """Give the bus free; safe to call twice."""
        held, self._held = self._held, None
        if isinstance(held, int):
            os.close(held)
        elif held is not None:
            held.close()


def _address(digest: str) -> str:
    return f"\0invid-bus-{digest}"


def _holder(digest: str) -> str:
    """Process and user that have the bus, where the kernel tells."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
            asking.setblocking(False)
            asking.connect(_address(digest))
            credentials = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
        process, user, _ = struct.unpack("iII", credentials)
        return f" (process {process} of {pwd.getpwuid(user).pw_name})"
    except (OSError, AttributeError, KeyError):
        return ""
