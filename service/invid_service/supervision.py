"""Tell systemd (``sd_notify``) when the service is ready, alive or stopping; nothing where it does not
listen.

The sign of life comes from the event loop itself, so a service that answers nobody is restarted. Its runner
is a process of its own that stops its drives where the service is gone.
"""

from __future__ import annotations

import asyncio
import os
import socket


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
