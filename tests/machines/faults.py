"""Seeded random faults (kind, moment, axis, phase of the run) in virtual time, on the simulated drives.

Every run is a whole measurement on the simulated cell with one fault. Afterwards, on the true state of
the plant and the drives, not on what the master believes:

- no axis went further beyond its window than a few cycles at its speed and the drive's quick stop allow;
- after a second more, every drive is disabled, or safely held, by itself where its master cannot reach it;
- the exit status is one that the fault calls for, and a drive that could not be switched off is named;
- the recording, where one was begun, opens, is marked, and has every sample taken before the stop.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from invid.config import CellConfig, parse_config
from invid.errors import InvidError
from invid.planning import make_plan
from invid.recording import Outcome, read_recording
from invid.sweep.recorder import Recorder
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.measurement import run_measurement
from invid_drivers.simulated import open_virtual_bus
from machines.short_case_study import CYCLE_S, short_case_study

RUN_S = 24.0
"""About how long a run without a fault takes in virtual time; faults come at any moment of it."""

CYCLIC_POSITION = 8
"""0x6060 of an axis that its drive holds."""
BRAKE_S = 0.2
"""From the master's decision to a closed brake: cutting a runaway off, and the brake's own time."""

SAFE_STATES = {"SWITCH_ON_DISABLED", "READY_TO_SWITCH_ON", "SWITCHED_ON", "FAULT", "NOT_READY_TO_SWITCH_ON"}
"""States without torque. Quick stop active counts for a gravity-loaded axis, which this cell has not."""

# What each fault may end in. 0: survived (the record is complete); 4: safety; 5: bus or drive.
EXPECTED: dict[str, set[int]] = {
    "drop": {0, 5},
    "delay": {0, 4, 5},
    "duplicate": {0, 5},
    "corrupt": {4, 5},
    "node_reset": {5},
    "node_silent": {5},
    "bus_off node": {5},
    "bus_off master": {5},
    "emcy": {5},
    "drive_fault": {5},
    "ignore_quick_stop": {5},
    "ignore_controlword": {5},
    "encoder_jump": {0, 4, 5},
    "encoder_stuck": {0, 4, 5},
    "sign_flip torque": {0, 4, 5},
    "sign_flip shown": {0, 4, 5},
    "sign_flip encoder": {0, 4, 5},
    "brake_stuck": {0, 4, 5},
    "torque_saturation": {0, 4},
    "push": {0, 4, 5},
    "statusword": {4, 5},
    "mode_display": {5},
    "torque_scale": {0, 4, 5},
    "sdo_silence": {0, 5},
}
PHASES = ("switched_on", "operation_enabled", "quick_stop_active")
PHASE_S = 0.4
"""A third of the flips and frozen encoders begin in one of these states, within so long; the rest at any
moment."""


@dataclass(frozen=True)
class RunOutcome:
    """One run."""

    kind: str
    status: int
    excess: float
    """Largest distance beyond a position window, as a share of what is allowed beyond it; ≤ 1 is good."""
    rows: int
    complaints: tuple[str, ...]


def draw(rng: np.random.Generator, kind: str) -> dict[str, Any]:
    """A fault of a kind at a random moment, on a random axis, of a random size."""
    name, _, what = kind.partition(" ")
    axis = f"A{rng.integers(1, 4)}"
    # never during the first exchange with the drives, where nothing is energised yet: that is tested apart
    fault: dict[str, Any] = {"kind": name, "axis": axis, "at_s": float(rng.uniform(0.45, 0.95 * RUN_S))}
    match kind:
        case "drop":
            fault |= {"rate": float(rng.choice([0.05, 0.3, 1.0])), "duration_s": float(rng.uniform(0.1, 5))}
        case "delay":
            fault |= {"delay_s": float(rng.uniform(0.0005, 0.01)), "duration_s": 1.0}
        case "corrupt":
            fault |= {"rate": 0.5, "duration_s": 1.0}
        case "duplicate":
            fault |= {"rate": 0.5, "duration_s": 2.0}
        case "bus_off master":
            fault["axis"] = None
        case "emcy":
            fault |= {"code": int(rng.choice([0x2310, 0x7121, 0x8611])), "length": int(rng.choice([2, 3, 8]))}
        case "encoder_jump":
            fault["counts"] = int(rng.choice([-1, 1]) * 10 ** rng.uniform(3, 6))
        case "sign_flip torque" | "sign_flip encoder" | "sign_flip shown":
            fault["signal"] = "torque" if what == "shown" else what
        case "torque_scale":
            fault["gain"] = float(rng.choice([-1.0, 0.4, 2.5]))
        case "sdo_silence":
            fault |= {"kind": "drop", "can_ids": [0x580 + int(axis[1])]}
        case "torque_saturation":
            fault["limit_Nm"] = float(rng.uniform(1, 20))
        case "push":
            fault |= {
                "torque_Nm": float(rng.choice([-1, 1]) * rng.uniform(5, 60)),
                "duration_s": float(rng.uniform(0.1, 1.0)),
            }
        case "statusword":
            fault["value"] = int(rng.choice([0x0000, 0x0208, 0x0250, 0x0231]))
        case "mode_display":
            fault["value"] = int(rng.choice([0, 1, 3]))
        case _:
            pass
    if name in ("sign_flip", "encoder_stuck") and rng.random() < 1 / 3:
        del fault["at_s"]
        fault |= {"at_state": str(rng.choice(PHASES)), "after_s": float(rng.uniform(0, PHASE_S))}
    return fault


def all_of(kind: str, fault: dict[str, Any]) -> list[dict[str, Any]]:
    """A fault with what comes with it: what another axis does, what 0x6077 shows."""
    if kind.startswith("ignore"):
        # nothing to see until something stops: another axis reports an error a little later
        other = "A1" if fault["axis"] != "A1" else "A2"
        return [fault, {"kind": "emcy", "axis": other, "at_s": fault["at_s"] + 0.2, "code": 0x2310}]
    if kind == "sign_flip shown":
        when = {k: fault[k] for k in ("axis", "at_s", "at_state", "after_s") if k in fault}
        return [fault, {"kind": "torque_scale", "gain": -1.0, **when}]
    return [fault]


def cell_config(faults: list[dict[str, Any]], seed: int) -> CellConfig:
    """The case study at 250 Hz with one short experiment."""
    data = short_case_study()
    data["simulation"] = {**data["simulation"], "seed": seed, "faults": faults}
    return parse_config(yaml.safe_dump(data))


class Truth:
    """Largest distance of each motor from its start, and largest speed, watched past the encoders."""

    def __init__(self, simulated: Any) -> None:
        plant = simulated.plant
        motors, count, observe = plant.structure.motors, plant.state.size // 2, plant.observe
        start = plant.state[motors].copy()
        self.travel, self.speed = np.zeros((2, motors.size))

        def watched(now_ns: int, noise: Any) -> Any:
            rows = observe(now_ns, noise)
            np.maximum(self.travel, np.abs(plant.state[motors] - start), out=self.travel)
            np.maximum(self.speed, np.abs(plant.state[motors + count]), out=self.speed)
            return rows

        plant.observe = watched


def run_one(kind: str, rng: np.random.Generator, folder: Path) -> RunOutcome:
    """One measurement with one fault."""
    fault = draw(rng, kind)
    config = cell_config(all_of(kind, fault), int(rng.integers(1 << 30)))
    out = folder / "run.h5"
    out.unlink(missing_ok=True)
    bus = open_virtual_bus(config)
    truth = Truth(bus.cell)
    blind = _held_when_stuck(bus.cell)
    cell = Cia402Cell(bus, config)
    given = [0]
    row = Recorder.row

    def counted(self: Recorder, *arguments: Any) -> None:
        given[0] += 1
        row(self, *arguments)

    Recorder.row = counted  # type: ignore[assignment, method-assign]
    status, said = 0, ""
    try:
        run_measurement(config, make_plan(config), cell, out)
    except InvidError as error:
        status, said = error.exit_code, str(error)
    finally:
        Recorder.row = row  # type: ignore[method-assign]
    # one second without a master: whoever was not reached must stop by itself
    bus.clock.sleep_until(bus.clock.now() + 1.0)
    complaints = _judge(kind, config, bus.cell, cell, status, said)
    limit = np.array([a.limits.position for a in config.axes])
    grace = truth.speed * (config.safety.missed_tpdos + 3) * CYCLE_S + truth.speed**2 / (2 * 10.0) + 1e-3
    if kind.startswith("sign_flip"):
        # A quick stop closes its loop through the wrong sign; voltage off and brake are what stops it.
        grace += truth.speed * BRAKE_S
    excess = float(np.max((truth.travel - limit) / grace))
    # A push is not the master's doing, and an encoder that dies while the drive itself holds the axis by it
    # shows nothing until the axis is to move: both are reported in the table, not counted.
    if excess > 1 and kind != "push" and not blind:
        complaints.append(f"travel {truth.travel.round(3)} beyond the window of {limit}")
    rows = _recording(out, given[0], status, complaints)
    return RunOutcome(kind, status, max(excess, 0.0), rows, tuple(complaints))


def _held_when_stuck(simulated: Any) -> list[str]:
    """Axes that were held by their drives (not in torque mode) when their encoders died."""
    blind: list[str] = []
    begin = simulated.injector.begin

    def noted(fault: Any, now_ns: int) -> None:
        if fault.kind == "encoder_stuck" and simulated.drive(fault.axis).mode == CYCLIC_POSITION:
            blind.append(fault.axis)
        begin(fault, now_ns)

    simulated.injector.begin = noted
    return blind


def _judge(
    kind: str, config: CellConfig, simulated: Any, cell: Cia402Cell, status: int, said: str
) -> list[str]:
    complaints = []
    if status not in EXPECTED[kind]:
        complaints.append(f"exit {status} ({said[:80]})")
    for axis, drive in zip(config.axes, simulated.drives, strict=True):
        if drive.state.name in SAFE_STATES:
            continue
        complaints.append(f"{axis.name} ended in {drive.state.name}")
    told = "not enabled" in said or (cell.not_off and cell.not_off[0] in said)
    if kind == "ignore_controlword" and status and not told:
        complaints.append(f"nobody was told that a drive did not obey ({said[:80]})")
    return complaints


def _recording(out: Path, given: int, status: int, complaints: list[str]) -> int:
    if not out.exists():
        if given:
            complaints.append("no recording was left")
        return 0
    try:
        recording = read_recording(out)
    except InvidError as error:
        complaints.append(f"the recording does not open: {error}")
        return 0
    rows = sum(e.samples for e in recording.experiments)
    if rows < given:
        complaints.append(f"{given - rows} samples lost")
    wanted = {0: Outcome.COMPLETED, 4: Outcome.ABORTED}.get(status, Outcome.FAILED)
    # a drive that would not switch off after a complete run leaves a complete recording
    if recording.outcome is not wanted and not (status == 5 and recording.outcome is Outcome.COMPLETED):
        complaints.append(f"marked {recording.outcome}, exit {status}")
    return rows
