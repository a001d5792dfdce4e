"""A cell of foreign drives, and commands of `invid` given to it: in processes of their own, in virtual time.

cell = Cell(folder, spec, config)
run = cell.command("measure", events=[{"what": "stop", "at": 12.0}])
run.status, run.document, run.words, run.trace
"""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

PACKAGE = Path(__file__).resolve().parent
INVID = [sys.executable, "-c", "from invid.cli import main; main()"]
"""The command under test; another one by ``FOREIGN_INVID``."""
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
LONGEST_S = 900.0
"""Real time after which a command is killed [s]."""
TRACE = np.dtype(
    [("t", "<f8"), ("axis", "u1"), ("state", "u1"), ("nmt", "u1"), ("held", "u1"),
     ("q", "<f4"), ("v", "<f4"), ("torque", "<f4"), ("asked", "<f4")]
)  # fmt: skip


@dataclass(frozen=True)
class Event:
    """What happened, to whom."""

    t: float
    who: str
    text: str


@dataclass(frozen=True)
class Run:
    """One command: how it ended, what it said, and what was true during it and for a while after it."""

    status: int | None
    """Exit status; minus the signal that killed it; ``None``: it did not end in real time."""
    document: dict[str, Any]
    """What ``--json`` printed; empty where that was nothing."""
    words: str
    """Everything for a person: warnings of the document, and what stderr says beside progress."""
    trace: Any
    """Rows of ``TRACE``."""
    events: tuple[Event, ...]
    seconds: float
    """Real time that it took [s]."""

    @property
    def is_slow(self) -> bool:
        """Whether virtual time went slower than real time: waits of the product in real time then count."""
        return not len(self.trace) or self.seconds > float(self.trace["t"][-1] - self.trace["t"][0])

    def when(self, mark: str) -> float | None:
        """First instant of what happened to the whole cell: "over", "stop", "lets go" and so on."""
        return next((e.t for e in self.events if not e.who and e.text == mark), None)

    def of(self, axis: int) -> Any:
        """Rows of an axis."""
        return self.trace[self.trace["axis"] == axis]


def plugged(folder: Path) -> dict[str, str]:
    """Environment in which python-can knows the interface `foreign`."""
    plug = folder / "plug"
    about = plug / "foreign_wire-1.dist-info"
    if not about.exists():
        about.mkdir(parents=True)
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign-wire\nVersion: 1\n")
        (about / "entry_points.txt").write_text("[can.interface]\nforeign = foreign.wire:ForeignWire\n")
        (plug / "foreign").symlink_to(PACKAGE)
    path = os.pathsep.join(filter(None, (str(plug), os.environ.get("PYTHONPATH"))))
    return {"PYTHONPATH": path, "XDG_STATE_HOME": str(folder / "state")}


class Cell:
    """Drives and plant that outlive commands."""

    def __init__(self, folder: Path, spec: dict[str, Any], config: dict[str, Any]) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "spec.json").write_text(json.dumps(spec))
        bus = {"interface": "foreign", "channel": str(folder), "cycle_s": 0.002, **config.pop("bus", {})}
        whole = {"format": "invid-config", "format_version": 1, "robot": "foreign", "bus": bus, **config}
        self.config = folder / "cell.yaml"
        self.config.write_text(json.dumps(whole, indent=1))
        self.recording = folder / "rec.h5"
        self._lines = self._bytes = self._count = 0

    def command(self, name: str, *more: str, events: list[dict[str, Any]] | None = None) -> Run:
        """`invid NAME CONFIG --json`, and what happens meanwhile."""
        (self.folder / "events.json").write_text(json.dumps(events or []))
        own = os.environ.get("FOREIGN_INVID")
        arguments = [*(own.split() if own else INVID), name, str(self.config), "--json", *more]
        if name == "measure":
            arguments += ["-o", str(self.recording), "--confirmed"]
        self._count += 1
        said = [self.folder / f"{self._count}-{name}.{end}" for end in ("json", "err")]
        began = time.monotonic()
        with said[0].open("w") as out, said[1].open("w") as err:
            process = subprocess.Popen(
                arguments, stdin=subprocess.DEVNULL, stdout=out, stderr=err, start_new_session=True,
                cwd=self.folder, env={**os.environ, **ONE_THREAD, **plugged(self.folder)},
            )  # fmt: skip
            status: int | None
            try:
                status = process.wait(LONGEST_S)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                status = None
        return self._run(status, said[0].read_text(), said[1].read_text(), time.monotonic() - began)

    def _run(self, status: int | None, printed: str, said: str, seconds: float) -> Run:
        try:
            document = json.loads(printed)
        except ValueError:
            document = {}
        lines = [x for x in said.splitlines() if " s left " not in x]
        words = "\n".join([*map(str, document.get("warnings", ())), *lines])
        trace, events = b"", []
        if (self.folder / "trace.bin").exists():
            trace = (self.folder / "trace.bin").read_bytes()[self._bytes :]
            self._bytes += len(trace)
            text = (self.folder / "events.jsonl").read_text().splitlines()
            events = [Event(*json.loads(line)) for line in text[self._lines :]]
            self._lines = len(text)
        rows = np.frombuffer(trace[: len(trace) // TRACE.itemsize * TRACE.itemsize], TRACE)
        return Run(status, document, words, rows, tuple(events), seconds)
