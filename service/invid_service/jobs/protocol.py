"""The tasks of runners; what is said between it and the service is ``invid_drivers.protocol``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from invid.tuning.motor_scale import MotorScale
from invid.wording.sentence import Sentence, as_sentences, with_wording
from invid_drivers.protocol import (
    AxisStates,
    Done,
    EndedEarly,
    Measured,
    Planned,
    Read,
    Running,
    RunProgress,
)

End = Done | EndedEarly
Told = Planned | Running | RunProgress | AxisStates | Measured | Read | End


@dataclass(frozen=True, kw_only=True)
class Job:
    """Everything a runner needs to know."""

    id: str
    kind: Literal["measure", "analyse"]
    mode: Literal["simulate", "test", "full", "screen", "verify", "upload"]
    requested_by: str
    """Who started it; named in the report."""
    folder: Path
    """Where results are written: ``recording.h5``, ``model.json``, …"""
    simulated: bool
    config: dict[str, Any] | None = None
    axes: list[str] | None = None
    amplitude_scale: float = 1.0
    amplitude: Literal["planned", "gentler"] = "planned"
    purpose: str | None = None
    """What the experiments are for, where they are not the cell's own; told in the plan."""
    expected_analysis_s: float | None = None
    """How long the analysis took before on this cell."""
    arm: bool = False
    acceptable: bool = True
    """False where the result says nothing new of the cell: a real cell simulated with its own model."""
    model: dict[str, Any] | None = None
    """The accepted model: for the forecast of travel, for ``mode`` "simulate" on a real cell, and for the
    plan of ``mode`` "screen"."""
    tuning: dict[str, Any] | None = None
    """The tuning whose loops ``mode`` "verify" measures."""
    memory_bytes: int
    stop_grace_s: float
    budget_s: float = 1500.0
    """Time for the analysis, after which the best answer so far is given: less than the half hour after which
    the service takes a run for hung."""


@dataclass(frozen=True, kw_only=True)
class TuningTask:
    """What the process that tunes needs to know."""

    folder: Path
    source: Path
    simulated: bool
    cycle_s: float
    notches: int
    draws: int
    drive: str | None
    motors: Mapping[str, MotorScale]


def plain(document: Mapping[str, Any]) -> Any:
    """Return the document as JSON has it, its sentences kept."""
    return as_sentences(json.loads(json.dumps(with_wording(document), default=float)))


def without_folder(text: str, folder: Path) -> str:
    """Return a text or sentence that does not say where a file lies."""
    if isinstance(text, Sentence):
        values = {name: without_folder(value, folder) for name, value in text.values.items()}
        return Sentence(text.template, values, text.form)
    return text.replace(f"{folder}/", "").replace(f" in {folder}", "") if str(folder) in text else text
