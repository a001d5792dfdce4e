"""Who watches over the service, and what outlives it: systemd (``sd_notify``), and process 1 of a container.

The sign of life comes from the event loop itself, so a service that answers nobody is restarted. Its runner
is a process of its own that stops its drives where the service is gone, however long a load is held for that:
nobody may end it with the service; as process 1 ``python -m invid_service.supervision COMMAND …`` sees to it.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence

_PR_SET_CHILD_SUBREAPER = 36


def tell(text: str) -> bool:
    """Send one message (``READY=1``); False where nobody listens."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return False
    if address.startswith("@"):
        address = "\0" + address[1:]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
            sender.sendto(text.encode(), address)
    except OSError:
        return False
    return True


def watchdog_s() -> float | None:
    """Return the seconds between two signs of life: a third of what systemd allows; ``None`` where it does
    not watch.
    """
    try:
        allowed, own = int(os.environ["WATCHDOG_USEC"]), int(os.environ.get("WATCHDOG_PID", os.getpid()))
    except (KeyError, ValueError):
        return None
    return allowed / 3e6 if allowed > 0 and own == os.getpid() else None


async def stay_alive() -> None:
    """Send signs of life until cancelled."""
    pause = watchdog_s()
    while pause is not None:
        tell("WATCHDOG=1")
        await asyncio.sleep(pause)


def outlive(command: Sequence[str]) -> int:
    """Run a command, and end with its status only when whatever it left behind has ended too.

    SIGTERM and SIGINT go to the command, as they come.
    """
    with contextlib.suppress(AttributeError, OSError):  # process 1 is that by itself
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    child = subprocess.Popen(command)

    def pass_on(number: int, _: object) -> None:
        if child.returncode is None:
            os.kill(child.pid, number)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, pass_on)
    status = 0
    with contextlib.suppress(ChildProcessError):  # none is left
        while True:
            ended, how = os.wait()
            if ended == child.pid:
                child.returncode = status = os.waitstatus_to_exitcode(how)
    return status if status >= 0 else 128 - status


if __name__ == "__main__":
    sys.exit(outlive(sys.argv[1:]))
