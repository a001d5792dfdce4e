"""Bus, nodes and what happens to them, in virtual time; what truly happened goes into a trace."""

import heapq
import json
import math
import os
import pickle
import signal
import struct
from collections import deque
from pathlib import Path
from typing import Any

from .axis import STATES, Axis
from .habits import HABITS
from .node import Node
from .plant import STEP_S, Plant

ROW = struct.Struct("<dBBBBffff")
"""Instant, axis, state, NMT, 1 braked | 2 propped, position, speed; largest torque since the last row, and
the largest that was asked for in torque mode."""
EVERY = 4
"""Steps from row to row."""
FRAME_S = 1.2e-4
"""One frame on the wire at 1 Mbit/s, the adapter with it."""
OTHER_EVERY_S = 0.007
"""SYNC of another master."""
LONGEST_S = 240.0
"""No command may take longer [s]."""
AFTER_S = 8.0
"""So long a cell is looked at after its command has ended [s]."""


class World:
    """All that is behind the adapter."""

    def __init__(self, spec: dict[str, Any], folder: Path) -> None:
        self.spec, self.folder = spec, folder
        self.now, self.steps, self.began = 0.0, 0, 0.0
        self.queue: list[tuple[float, int, str, int, bytes]] = []
        self.order = 0
        self.inbox: deque[tuple[float, int, bytes]] = deque()
        self.bus_free = 0.0
        self.lines: list[str] = []
        self.begin([])
        self.nodes: list[Node] = []
        self.axes: list[Axis] = []
        self.own = {n["node"] for n in spec["nodes"] if n.get("own", True)}
        self.suspended = 0.0
        self.rows = bytearray()
        for n in spec["nodes"]:
            node = Node(self, n["node"], len(n["axes"]), n)
            for k, a in enumerate(n["axes"]):
                habits = [HABITS[name](**keys) for name, keys in a.get("habits", ())]
                axis = Axis(node, k, Plant(**a.get("plant", {})), habits)
                for habit in habits:
                    habit.start(axis)
                axis.boot()
                node.axes.append(axis)
                self.axes.append(axis)
            self.nodes.append(node)
        self.peaks = [[0.0, 0.0] for _ in self.axes]

    def begin(self, events: list[dict[str, Any]]) -> None:
        """Another command begins, and what happens during it."""
        self.began, self.ended, self.marks, self.events = self.now, False, {}, list(events)
        self.adapter_dead = self.adapter_late = self.oversleeps = 0.0
        self.other_master = math.inf
        self.mark("begins")

    # --- words -------------------------------------------------------------------------------------
    def note(self, who: object, text: str) -> None:
        """Keep what happened."""
        self.lines.append(json.dumps([round(self.now, 6), str(who), text]))

    def mark(self, name: str) -> None:
        """Keep when something happened first."""
        self.note("", name)
        self.marks.setdefault(name, self.now)

    def flush(self) -> None:
        """Write trace and words."""
        with (self.folder / "trace.bin").open("ab") as f:
            f.write(self.rows)
        with (self.folder / "events.jsonl").open("a") as f:
            f.writelines(line + "\n" for line in self.lines)
        self.rows, self.lines = bytearray(), []

    # --- frames ------------------------------------------------------------------------------------
    def from_node(self, node: Node, cob: int, data: bytes, after: float) -> None:
        """A node sends."""
        turn = self.nodes.index(node)
        self._queue("node", node.node, cob, data, self.now + after + FRAME_S * (1 + turn))

    def from_master(self, cob: int, data: bytes) -> None:
        """The master sends."""
        to = data[1] if cob == 0 and len(data) == 2 else cob & 0x7F
        if cob == 0 and to:
            self.note("", f"NMT command {data[0]:#x} to {to}")
        is_asked = cob & 0x780 == 0x600 and data[0] >> 5 in (2, 4)
        if (cob == 0 and to == 0) or (0x200 <= cob < 0x700 and to not in self.own and not is_asked):
            self.note("", f"FOREIGN {cob:03X} {data.hex()}")
        if not self.adapter_dead:
            self.bus_free = max(self.bus_free, self.now) + FRAME_S
            self._queue("master", 0, cob, data, self.bus_free)

    def _queue(self, who: str, node: int, cob: int, data: bytes, at: float) -> None:
        self.order += 1
        heapq.heappush(self.queue, (at, self.order, who, cob, node.to_bytes(1, "little") + data))

    def _deliver(self, who: str, cob: int, framed: bytes) -> None:
        sender, data = framed[0], framed[1:]
        if who == "node":
            self.inbox.append((self.now + self.adapter_late, cob, data))
        for node in self.nodes:
            if who == "master" or node.node != sender:
                node.hear(cob, data)

    # --- time --------------------------------------------------------------------------------------
    def has_frame(self) -> bool:
        """Whether the master has something to read now."""
        return bool(self.inbox) and self.inbox[0][0] <= self.now + 1e-12

    def advance(self, until: float, *, wanted: bool = False) -> None:
        """Let time pass; with ``wanted`` only until a frame has come."""
        while not (wanted and self.has_frame()):
            step = (self.steps + 1) * STEP_S
            due = self.queue[0][0] if self.queue else step
            nearest = min(step, due)
            if wanted and self.inbox:
                nearest = min(nearest, max(self.now, self.inbox[0][0]))
            if nearest > until + 1e-12:
                self.now = max(self.now, until)
                return
            self.now = max(self.now, nearest)
            if self.queue and self.queue[0][0] <= self.now + 1e-12:
                _, _, who, cob, data = heapq.heappop(self.queue)
                self._deliver(who, cob, data)
            elif nearest == step:
                self._step(step)
                if self.suspended:
                    seconds, self.suspended = self.suspended, 0.0
                    self.advance(self.now + seconds)

    def _step(self, now: float) -> None:
        self.steps += 1
        if now >= self.other_master:
            self.other_master = now + OTHER_EVERY_S
            self._queue("node", 0, 0x80, b"", now)
        for node in self.nodes:
            node.tick(now)
        for k, axis in enumerate(self.axes):
            axis.tick(now)
            peak = self.peaks[k]
            peak[0] = max(peak[0], abs(axis.plant.torque))
            peak[1] = max(peak[1], abs(axis.asked))
        if self.steps % EVERY == 0:
            for k, axis in enumerate(self.axes):
                p = axis.plant
                flags = p.is_braked | (p.prop is not None) << 1
                state = STATES.index(axis.state)
                self.rows += ROW.pack(now, k, state, axis.node.nmt, flags, p.q, p.v, *self.peaks[k])
                self.peaks[k] = [0.0, 0.0]
            if self.steps % 500 == 0:
                self.flush()
        if self.events:
            self._happen(now)
        if now - self.began > LONGEST_S and not self.ended:
            self.mark("no end")
            self.die()

    def _happen(self, now: float) -> None:
        for event in list(self.events):
            if "after" in event:
                since = self.marks.get(event["after"])
                at = None if since is None else since + event["delay"]
            else:
                at = event["at"]
            if at is not None and now >= at:
                self.events.remove(event)
                self.mark(event["what"])
                self._do(event)

    def _do(self, event: dict[str, Any]) -> None:
        what = event["what"]
        if what == "stop":
            os.killpg(0, signal.SIGINT)
        elif what == "master dies":
            self.die()
        elif what == "suspended":
            self.suspended = event["seconds"]
        elif what == "adapter sends nothing":
            self.adapter_dead = 1.0
        elif what == "adapter late":
            self.adapter_late = event["seconds"]
        elif what == "computer late":
            self.oversleeps = event["seconds"]
        elif what == "changes":
            self.axes[event["axis"]].take_up(HABITS[event["habit"]](**event["keys"]))
        elif what == "other master":
            self.other_master = self.now
        else:
            raise ValueError(what)

    def die(self) -> None:
        """Everything of the command is killed; what the drives do then is still seen."""
        self.events = []
        self.queue = [q for q in self.queue if q[2] == "node"]
        heapq.heapify(self.queue)
        self.finish()
        os.killpg(0, signal.SIGKILL)

    def finish(self) -> None:
        """The command has ended: look at the cell for a while, and keep it for the next one."""
        if self.ended:
            return
        self.ended = True
        self.mark("over")
        self.events = []
        self.advance(self.now + AFTER_S)
        self.inbox.clear()
        self.flush()
        (self.folder / "state.pickle").write_bytes(pickle.dumps(self))
