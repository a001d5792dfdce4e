"""The python-can interface `foreign`: virtual time inside the process under test.

The channel is a folder with `spec.json`. What is behind the wire is kept there from command to command.
"""

import atexit
import json
import os
import pickle
from pathlib import Path
from typing import Any

import can

from .world import World


def _no_real_time(*_: Any) -> None:
    raise PermissionError("no real time on a wire in virtual time")


class ForeignWire(can.BusABC):
    """The master's end of the wire, its clock with it (``clock``: ``now``, ``sleep_until``)."""

    def __init__(self, channel: str, can_filters: Any = None, **_: Any) -> None:
        os.sched_setscheduler = _no_real_time
        folder = Path(channel)
        self.channel_info = f"foreign {channel}"
        self.clock = self
        kept = folder / "state.pickle"
        if kept.exists():
            self.world: World = pickle.loads(kept.read_bytes())
        else:
            self.world = World(json.loads((folder / "spec.json").read_text()), folder)
        self.world.begin(json.loads((folder / "events.json").read_text()))
        atexit.register(self.world.finish)
        super().__init__(channel=channel, can_filters=can_filters)

    def now(self) -> float:
        """Seconds since the cell got its supply."""
        return self.world.now

    def sleep_until(self, instant: float) -> None:
        """Let virtual time pass."""
        self.world.advance(instant + self.world.oversleeps)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """One frame to the drives."""
        self.world.from_master(msg.arbitration_id, bytes(msg.data))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Next frame within virtual seconds."""
        world = self.world
        if not world.has_frame() and timeout != 0:
            world.advance(world.now + (60.0 if timeout is None else max(timeout, 1e-6)), wanted=True)
        if not world.has_frame():
            return None
        _, cob, data = world.inbox.popleft()
        return can.Message(timestamp=world.now, arbitration_id=cob, is_extended_id=False, data=data)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self.recv(timeout), False

    def shutdown(self) -> None:
        """Unplug; the cell goes on."""
        super().shutdown()
        self.world.finish()
