"""An event that signal handlers may set: nothing in it waits for a lock."""

from __future__ import annotations

import contextlib
import os
import select
import threading


class StopFlag(threading.Event):
    """A flag as ``threading.Event``, but set for good.

    ``Event.set`` holds a lock. A handler that is interrupted there by a second signal, as the kernel sends
    several when a parent of several threads dies, waits for itself for ever, and the cycle with it. Here a
    flag and one byte in a pipe say the same.
    """

    def __init__(self) -> None:
        super().__init__()
        self._asked = False
        self._out, self._in = os.pipe()
        os.set_blocking(self._in, False)

    def set(self) -> None:
        """Set the flag, from any thread and from handlers within handlers."""
        self._asked = True
        with contextlib.suppress(OSError):  # full: whoever waits is awake already
            os.write(self._in, b"\0")

    def is_set(self) -> bool:
        """Whether the flag was set."""
        return self._asked

    def clear(self) -> None:
        """Refuse: a stop is never taken back."""
        raise NotImplementedError("a stop is never taken back")

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the flag is set or the timeout is over; return whether it is set."""
        if not self._asked:
            select.select([self._out], [], [], timeout)
        return self._asked

    def __del__(self) -> None:
        """Close the pipe."""
        for end in (self._out, self._in):
            with contextlib.suppress(OSError):
                os.close(end)
