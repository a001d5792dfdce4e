"""What a runner last knew of its axes, beside its recording: for the service that starts next."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from invid_drivers.protocol import AxisStates, LastSeen
from invid_service.jobs.states import State
from invid_service.store.store import RunRecord

_NAME = "last-words.json"
UNKNOWN = "nobody saw its axes at rest: unknown, look"
LOOK = "look at the robot: make sure that every axis stands, and is off or held; then start again"


@dataclass(frozen=True)
class LastWords:
    """States of the axes as they were told last, and how the motion ended; empty: nobody has said."""

    axes: AxisStates = field(default_factory=AxisStates)
    end: str = ""

    def write(self, folder: Path) -> None:
        """Leave them in the folder of the run; a disk that takes no more keeps nobody from stopping."""
        part = folder / f"{_NAME}.part"
        with contextlib.suppress(OSError):
            part.write_text(json.dumps(asdict(self)), encoding="utf-8")
            os.replace(part, folder / _NAME)

    @classmethod
    def read(cls, folder: Path) -> LastWords:
        """Those that were left in a folder; none where there are none."""
        try:
            found = json.loads((folder / _NAME).read_text(encoding="utf-8"))
            return cls(AxisStates(tuple(LastSeen(**a) for a in found["axes"]["axes"])), str(found["end"]))
        except (OSError, ValueError, TypeError, KeyError):
            return cls()


def unknown_axes(
    what: str, states: AxisStates, names: Sequence[str], known: Sequence[str] = ()
) -> dict[str, Any]:
    """Text, way out and axes of the error of a run whose axes nobody has seen at rest."""
    text = ". ".join((f"{what}; {UNKNOWN}", *states.of(names), *known))
    return {"text": text, "fix": LOOK, "axes": states.to_json(names)}


def interruption(run: RunRecord, words: LastWords) -> dict[str, Any]:
    """The error of a run that the end of its service cut off, by what its runner left."""
    what = f"the service ended while this run was {run.state}; it was not run again"
    moved = run.state in (State.RUNNING, State.ANALYSING)
    kept = "; what was measured until then is kept as this run's recording" if moved else ""
    told = {"text": what, "fix": f"look at the robot, then start a new identification{kept}"}
    if run.state is State.RUNNING and words.end:
        told["text"] = f"{what}. Its motion was ended: {words.end}"
    elif run.state is State.RUNNING and not run.simulated:
        unknown = unknown_axes(what, words.axes, run.axes)
        return {"code": "interrupted", **unknown, "fix": f"{LOOK}{kept}"}
    return {"code": "interrupted", **told}
