"""Fault campaign on drives as real ones are: limits off in torque mode, no brake, one axis loaded.

    python benchmarks/drivers/bench_real_drives.py [--runs 500] [--seed 0] [--markdown] [--results runs.jsonl]
                                           [--kind KIND] [--seconds S]

Every run draws a cell and one thing that is wrong with it or goes wrong, and gives the commands that a
technician would: `measure`, then two seconds in which no master is there, `check`, and a second `measure`
that is stopped on request as soon as the axes are held. `plant_judge.py` judges on the plant.
``--results`` keeps every run in a file and goes on where an interrupted campaign stopped.
"""

from __future__ import annotations

import inspect
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.drivers.bench_faults import CONFIG, CYCLE_S, all_of, draw
from benchmarks.drivers.bench_faults import EXPECTED as OLD
from benchmarks.drivers.bench_faults import RUN_S as OLD_RUN_S
from benchmarks.drivers.plant_judge import SAFE, Judge, writes
from benchmarks.shared.campaign import judged_runs
from invid.config import CellConfig, parse_config
from invid.errors import DriveError, InvidError
from invid.planning import make_plan
from invid.recording import read_recording
from invid.sweep import Progress
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.journal import Journal
from invid_drivers.cia402.standing.hold_memory import HoldMemory
from invid_drivers.cia402.standing.holding import to_support
from invid_drivers.measurement import run_measurement
from invid_drivers.simulated import VirtualTimeBus, open_virtual_bus
from invid_drivers.simulated.cell import SimulatedCell
from invid_drivers.simulated.faults import FaultConfig

UNATTENDED_S = 2.0
"""Between the first command and the next: nobody is there, the heartbeat is gone."""
RAMP_S, REST_POLL_S, AT_REST, REST_POLLS = 1.0, 0.01, 0.02, 10
"""A ramp that still runs when the command has ended may take so long [s] to this speed [rad/s]."""
RUN_S = 26.0
"""About how long a run takes, its load weighed and its stop test done; faults come at any moment of it."""
ENABLED_S = 1.2
"""The bus is listened to for so long before anything is sent; faults come after that."""
FOREIGN_NODE = 20
RESET_NODE = 0x81
LATE_CUT_S = 0.2
"""A quick stop through a wrong sign is ended by voltage off; see ``EXEMPTIONS``."""
STALL_S = 0.3
"""A stalled disk takes so long for each flush [s]: longer than anything that is forgiven to a cycle."""

EXEMPTIONS = {
    "corrupt": "torque is not judged: a frame altered on its way, which CAN's CRC does not let through",
    "push": "travel is not judged: a person moves the arm, not the master",
    "encoder_stuck": "not where the drive itself held the axis when its encoder died (as the old campaign)",
    "sign_flip torque": "0.2 s more at top speed: only voltage off ends a loop closed through a wrong sign",
    "sign_flip encoder": "as sign_flip torque",
    "sign_flip shown": "as sign_flip torque",
    "opposed load": "as sign_flip torque",
}
"""All of them. Torque by the drive's own loop is judged by its own limit where that cannot be written."""

NEEDS_BRAKE = {
    "node_reset", "drive_fault", "encoder_stuck", "encoder_jump", "sign_flip torque", "sign_flip encoder",
    "sign_flip shown", "opposed load",
    "ignore_quick_stop", "ignore_controlword", "brake_stuck", "torque_saturation", "slow mode",
    "corrupt", "scale torque unstated",
}  # fmt: skip
"""Faults that take the torque (its limit in a scale that nobody states) or the sight of a drive away: without
a brake nobody can hold such an axis where it is loaded, nor slow it down where it is not, so it has one (as
every axis in the old campaign)."""
DEAD_MASTER = {"node_silent", "bus_off node", "bus_off master", "drop", "ignore_controlword", "delay"}
"""The drive may not hear its master, or obeys nobody: its heartbeat watch acts."""

REFUSED = {2, 4, 5}
# What each kind may end in: 0 done, 2 refused, 4 safety, 5 bus or drive.
EXPECTED: dict[str, set[int]] = {
    "none": {0},
    "stop request": {4},
    "tight torque": {0, 2, 4, 5},
    "tight window": {0, 2, 4, 5},
    "tight speed": {0, 2, 4, 5},
    "read-only limit": {0, 2, 4, 5},
    "scale position": REFUSED,
    "scale encoder": REFUSED,
    "scale torque": REFUSED,
    "scale torque unstated": REFUSED,
    "slow ramp": {2, 4, 5},
    "ramp unit": {2, 4, 5},
    "undeclared load": {0, 2, 4, 5},
    "unstated load": {0, 2, 4, 5},
    "late brake": {0, 2, 4, 5},
    "no quick stop option": {0, 2, 4, 5},
    "no ramp": {0, 2, 4, 5},
    "no heartbeat watch": {0, 2, 4, 5},
    "no following window": {0, 2, 4, 5},
    "no torque limit": {0, 2, 4, 5},
    "no position limit": {0, 2, 4, 5},
    "slow mode": {0, 2, 4, 5},
    "slow SDO": {0, 2, 4, 5},
    "ignore_target": {0, 4, 5},
    "torque_display": {0, 4, 5},
    "no servo": REFUSED | {0},  # 0x1000 of 0 says nothing, and is noted
    "other sync before": REFUSED,
    "other sync": {0, 4, 5},
    "other nmt": {0, 4, 5},
    "other sdo before": {0, 2, 4, 5},
    "other heartbeat before": {0, 2, 4, 5},
    "foreign heartbeat": {0, 2, 4, 5},
    "torque only": {0, 2, 4, 5},
    "slow enabling": {0, 2, 4},
    "late mode": {0, 2, 4},
    "opposed load": {4, 5},
    "wrong 0x6077": {4, 5},
    "stalled disk": {0},
    **OLD,
    "corrupt": OLD["corrupt"] | {0},  # while the axes are only held, no drive follows what is corrupted
}


@dataclass
class Case:
    """One drawn cell: changes of config and simulation, and when somebody asks to stop."""

    kind: str
    axes: dict[str, dict[str, Any]]
    """Keys of each axis in the config."""
    drives: dict[str, dict[str, Any]]
    """Keys of each axis in the simulation."""
    simulation: dict[str, Any] = field(default_factory=dict)
    faults: list[dict[str, Any]] = field(default_factory=list)
    stop_s: float | None = None


@dataclass(frozen=True)
class RunOutcome:
    """One run."""

    kind: str
    status: int
    """Of the first measurement."""
    then: tuple[int, ...]
    """Of the commands after it."""
    excess: float
    complaints: tuple[str, ...]
    said: str = ""


def make_case(kind: str, rng: np.random.Generator) -> Case:
    """A cell with one loaded axis and one thing wrong."""
    loaded = f"A{rng.integers(1, 4)}"
    limit = {"A1": 25.0, "A2": 50.0, "A3": 100.0}[loaded]
    load = float(rng.choice([-1, 1]) * rng.uniform(0.08, 0.2)) * limit
    drives: dict[str, dict[str, Any]] = {f"A{i}": {} for i in (1, 2, 3)}
    axes: dict[str, dict[str, Any]] = {f"A{i}": {} for i in (1, 2, 3)}
    element = str(rng.choice(["motor", "last mass"]))
    drives[loaded]["load"] = {"torque_Nm": load, "element": element}
    for name, keys in axes.items():
        keys["gravity_loaded"] = name == loaded
    case = Case(kind, axes, drives)
    axis = f"A{rng.integers(1, 4)}"
    at_s = ENABLED_S + float(rng.uniform(0.45, 0.95 * RUN_S))
    if kind in NEEDS_BRAKE:
        _give_brake(case, loaded, 0.02)
    if kind in OLD:
        fault = draw(rng, kind)
        if "at_s" in fault:
            fault["at_s"] = ENABLED_S + fault["at_s"] * RUN_S / OLD_RUN_S
        if kind in NEEDS_BRAKE:
            _give_brake(case, fault["axis"], 0.02)
        case.faults = all_of(kind, fault)
        return case
    wrong = case.drives[axis]
    objects: dict[str, Any] = wrong.setdefault("objects", {})
    values: dict[str, Any] = objects.setdefault("values", {})
    emcy = {"kind": "emcy", "axis": axis, "at_s": at_s, "code": 0x2310}
    rated = {"A1": 50.0, "A2": 100.0, "A3": 200.0}[axis]
    counts = 524288
    per_rad = counts / (2.0 * np.pi)
    match kind:
        case "none":
            pass
        case "stop request":
            case.stop_s = at_s
        case "tight torque":
            values["0x6072"] = int(rng.integers(100, 400))
        case "tight window":
            edge = round(float(rng.uniform(0.1, 0.4)) * per_rad)
            values["0x607D:1"], values["0x607D:2"] = -edge, edge
        case "tight speed":
            values["0x607F"] = round(float(rng.uniform(0.5, 2.0)) * per_rad)
        case "read-only limit":
            values["0x6072"] = int(rng.choice([200, 500, 800]))
            objects["read_only"] = ["0x6072"]
        case "scale position":
            factor = float(rng.choice([1 / 16, 1 / 4, 4, 16]))
            axes[axis]["position_rad_per_count"] = factor / per_rad
        case "scale encoder":
            values["0x608F:1"] = round(counts * float(rng.choice([1 / 16, 1 / 4, 4, 16])))
        case "scale torque" | "scale torque unstated":
            values["0x6076"] = round(rated * 1000 * float(rng.choice([0.1, 10.0])))
            if kind == "scale torque unstated":
                axes[axis]["rated_torque_Nm"] = None
        case "slow ramp":
            wrong["quick_stop_deceleration_rad_per_s2"] = float(rng.uniform(0.3, 2.0))
            case.faults = [emcy]
        case "ramp unit":
            wrong["ramp_unit"] = "rpm_per_s"
            case.faults = [emcy]
        case "undeclared load":
            axes[loaded]["gravity_loaded"] = False
            case.stop_s = at_s if rng.random() < 0.5 else None
        case "unstated load":
            for keys in axes.values():
                keys["gravity_loaded"] = "unknown"
            case.stop_s = at_s if rng.random() < 0.5 else None
        case "late brake":
            _give_brake(case, loaded, float(rng.uniform(0.1, 0.6)))
            case.stop_s = at_s if rng.random() < 0.5 else None
        case "no quick stop option":
            # of the loaded axis, half of the time as a drive that keeps its own option
            target = drives[loaded].setdefault("objects", {})
            if rng.random() < 0.5:
                target["lacks"] = ["0x605A"]
            else:
                target["read_only"] = ["0x605A"]
        case "no ramp":
            objects["lacks"] = ["0x6085"]
            case.faults = [emcy]
        case "no heartbeat watch":
            objects["lacks"] = ["0x1016"]
            axes[axis]["allow_missing_heartbeat"] = bool(rng.random() < 0.5)
        case "no following window":
            objects["lacks"] = ["0x6065", "0x6066"]
        case "no torque limit":
            objects["lacks"] = ["0x6072"]
        case "no position limit":
            objects["lacks"] = ["0x607D", "0x607F"]
        case "slow mode":
            wrong["mode_change_s"] = float(rng.uniform(0.05, 0.8))
            wrong["sync_timeout_s"] = float(rng.choice([0.0, 0.05]))
        case "slow SDO":
            wrong["sdo_response_s"] = float(rng.uniform(0.01, 0.25))
        case "ignore_target":
            case.faults = [{"kind": "ignore_target", "axis": axis, "at_s": at_s}]
        case "torque_display":
            value = int(rng.integers(-100, 100))
            when = float(rng.choice([0.0, at_s]))
            case.faults = [{"kind": "torque_display", "axis": axis, "at_s": when, "value": value}]
        case "no servo":
            values["0x1000"] = int(rng.choice([0x000F0191, 0x00040192, 0x00000000]))
        case "torque only":
            target = drives[loaded if rng.random() < 0.5 else axis].setdefault("objects", {})
            target.setdefault("values", {})["0x6502"] = 1 << 9
        case "opposed load":
            signal = str(rng.choice(["torque", "encoder"]))
            case.faults = [{"kind": "sign_flip", "axis": loaded, "signal": signal, "at_s": 0.0}]
            axes[loaded]["gravity_loaded"] = True if rng.random() < 0.5 else "unknown"
            drives[axis]["enable_s"] = float(rng.uniform(0.2, 2.0))
        case "wrong 0x6077":
            gain = float(rng.choice([0.1, 0.4, 0.6, 1.5, 2.5]))
            case.faults = [{"kind": "torque_scale", "axis": axis, "gain": gain, "at_s": 0.0}]
        case "stalled disk":
            pass
        case "slow enabling":
            wrong["enable_s"] = float(rng.uniform(1.0, 2.0))
        case "late mode":
            wrong["mode_shown_enabled"] = bool(rng.random() < 0.7)
            wrong["mode_from_switched_on"] = bool(rng.random() < 0.7)
        case "foreign heartbeat":
            case.simulation["foreign_heartbeat_s"] = 0.1
        case _:
            _, traffic, *before = kind.split(" ")
            command = int(rng.choice([0x80, 0x02, 0x81, 0x01]))
            if command == RESET_NODE:  # the drive of the load reboots: see NEEDS_BRAKE
                _give_brake(case, loaded, 0.02)
            case.faults = [
                {
                    "kind": "other_master",
                    "axis": axis,
                    "traffic": traffic,
                    "at_s": 0.0 if before else at_s,
                    "period_s": None if traffic == "nmt" else float(rng.choice([0.002, 0.01, 0.1])),
                    "value": command,
                }
            ]
    return case


def _give_brake(case: Case, axis: str, delay_s: float) -> None:
    case.axes[axis]["brake"] = "drive"
    case.drives[axis] |= {"brake": True, "brake_delay_s": delay_s}


def cell_config(case: Case, seed: int) -> CellConfig:
    """The case study at 250 Hz with one short experiment, as drawn."""
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    data["bus"]["cycle_s"] = CYCLE_S
    data["experiments"] = [
        {"kind": "multisine", "band_Hz": [1, 12], "period_s": 2.048, "periods": 2, "settle_periods": 0,
         "experiments": 1}
    ]  # fmt: skip
    simulation = data["simulation"]
    for axis in data["axes"]:
        simulation["axes"][axis["name"]]["rated_torque_Nm"] = axis["rated_torque_Nm"]
        simulation["axes"][axis["name"]] |= case.drives[axis["name"]]
        axis |= case.axes[axis["name"]]
    for axis in data["axes"]:
        if axis["rated_torque_Nm"] is None:
            del axis["rated_torque_Nm"]
    simulation["defaults"] |= {"limits_in_torque_mode": False, "brake": False, "enable_s": 0.2}
    simulation |= {"seed": seed, "foreign_nodes": [FOREIGN_NODE], **case.simulation}
    return parse_config(yaml.safe_dump(data))


class Stop(threading.Event):
    """Somebody asks to stop at an instant of virtual time."""

    def __init__(self, now: Callable[[], float], at_s: float | None) -> None:
        super().__init__()
        self._now, self._at_s = now, at_s

    def is_set(self) -> bool:
        """Whether it is time."""
        return super().is_set() or (self._at_s is not None and self._now() >= self._at_s)


class Bench:
    """One cell, and the commands of a person beside it."""

    def __init__(self, config: CellConfig, folder: Path) -> None:
        self.config = config
        self.folder = folder
        self._port: VirtualTimeBus | None = open_virtual_bus(config)
        self._wire = self._port.wire
        self.cell = self._wire.cell
        self.clock = self._port.clock
        self.judge = Judge(config, self.cell)
        self.master: Cia402Cell | None = None

    def _connect(self) -> Cia402Cell:
        port = self._port or VirtualTimeBus(self.config.bus.channel, wire=self._wire)
        self._port = None
        self.master = Cia402Cell(port, self.config, journal=Journal(self.folder / "bus.journal"))
        return self.master

    def measure(self, out: Path, *, stop_s: float | None = None, hold_only: bool = False) -> tuple[int, str]:
        """Exit status and message of ``invid measure``."""
        stop = Stop(self.clock.now, None if stop_s is None else self.clock.now() + stop_s)

        memory = HoldMemory.beside(self.folder / "bus.journal")
        supported = bool(to_support(self.config, memory))

        def progress(report: Progress) -> None:
            if hold_only and report.phase.startswith("trying") and not stop.is_set():
                if supported:  # the technician was asked to support the load before its hold was tried
                    self.judge.stopped()
                stop.set()

        def run() -> None:
            plan = make_plan(self.config)
            run_measurement(self.config, plan, self._connect(), out, progress=progress, stop=stop)

        done = self._status(run)
        if hold_only and supported and not stop.is_set():
            self.judge.stopped()  # it ended while its hold was tried, with the load supported
        return done

    def check(self) -> tuple[int, str]:
        """Exit status and message of ``invid check``."""

        def run() -> None:
            make_plan(self.config)
            cell = self._connect()
            try:
                cell.check()
                if cell.not_ready:
                    raise DriveError("; ".join(r.text for r in cell.not_ready))
            finally:
                cell.close()

        return self._status(run)

    def close(self) -> None:
        """The port that no command has taken."""
        if self._port is not None:
            self._port.shutdown()
            self._port = None

    @staticmethod
    def _status(command: Callable[[], None]) -> tuple[int, str]:
        try:
            command()
        except InvidError as error:
            return error.exit_code, str(error)
        return 0, ""

    def plan(self, faults: list[dict[str, Any]]) -> None:
        """Faults, their times counted from now."""
        now = self.clock.now()
        for fault in faults:
            when = {"at_s": fault["at_s"] + now} if "at_s" in fault else {}
            self.cell.plan_fault(FaultConfig.model_validate({**fault, **when}))

    def wait_for_rest(self) -> None:
        """Where a ramp still runs when a command has ended, its end; one that falls does not get there."""
        still = 0  # a turning point is no rest
        for _ in range(round(RAMP_S / REST_POLL_S)):
            still = still + 1 if np.abs(self.judge.watch.velocities).max() < AT_REST else 0
            if still >= REST_POLLS:
                return
            self.wait(REST_POLL_S)

    def wait(self, seconds: float) -> None:
        """Nobody does anything."""
        self.clock.sleep_until(self.clock.now() + seconds)


def run_one(kind: str, rng: np.random.Generator, folder: Path) -> RunOutcome:
    """One cell and the four things done with it."""
    case = make_case(kind, rng)
    config = cell_config(case, int(rng.integers(1 << 30)))
    out = folder / "run.h5"
    for old in folder.glob("*"):
        old.unlink()
    bench = Bench(config, folder)
    judge = bench.judge
    with writes(bench.cell) as written, stalls(bench.cell, real=kind == "stalled disk") as waited:
        bench.plan(case.faults)
        status, said = bench.measure(out, stop_s=case.stop_s)
        complaints = [] if status in EXPECTED[kind] else [f"exit {status} ({said[:160]})"]
        complaints += _recording(out, status)
        bench.wait_for_rest()
        judge.stopped()
        bench.wait(UNATTENDED_S)
        complaints += _motion(judge, kind)
        excess = _excess(judge, kind)
        complaints += [f"unattended: {c}" for c in (*judge.loads(), *judge.states())]
        checked, _ = bench.check()
        complaints += judge.readiness(checked)
        bench.wait(0.1)
        complaints += [f"check: {c}" for c in judge.loads()]
        again, _ = bench.measure(folder / "again.h5", hold_only=True)
        bench.wait(1.0)
        complaints += [f"second measure: {c}" for c in (*judge.loads(), *judge.states())]
        complaints += judge.settings(written) + waited
    complaints += judge.foreign(other_master=kind == "other nmt")
    return RunOutcome(
        kind, status, (checked, again), float(max(excess, 0.0)), tuple(dict.fromkeys(complaints)), said[:200]
    )


@contextmanager
def stalls(cell: SimulatedCell, *, real: bool) -> Iterator[list[str]]:
    """Complaints of every disk that the cycle waited for under power; ``real``: a disk that takes its time.

    The recording is written by another process where a bus is not virtual, so it may wait.
    """
    complaints: list[str] = []
    fsync = os.fsync

    def slow(file: int) -> None:
        here = inspect.currentframe()
        callers = [f.filename for f in inspect.getouterframes(here)[1:4]]
        ours = not any("recording" in Path(name).parts for name in callers)
        if ours and threading.current_thread() is threading.main_thread():
            powered = [d.state.name for d in cell.drives if d.state not in SAFE]
            complaints.extend(["the cycle waited for the disk under power"] * bool(powered))
        elif real:
            time.sleep(STALL_S)
        fsync(file)

    os.fsync = slow
    try:
        yield complaints
    finally:
        os.fsync = fsync


def _motion(judge: Judge, kind: str) -> list[str]:
    complaints = [] if kind == "corrupt" else judge.torque()
    if kind != "push":
        complaints += judge.travel(dead_master=kind in DEAD_MASTER, late_cut=_late_cut(kind))
    return complaints


def _excess(judge: Judge, kind: str) -> float:
    return float(np.max(judge.excess(dead_master=kind in DEAD_MASTER, late_cut=_late_cut(kind))))


def _late_cut(kind: str) -> float:
    return LATE_CUT_S if kind.startswith("sign_flip") or kind == "opposed load" else 0.0


def _recording(out: Path, status: int) -> list[str]:
    if not out.exists():
        return ["no recording was left"] if status == 0 else []
    try:
        read_recording(out)
    except InvidError as error:
        return [f"the recording does not open: {error}"]
    return []


if __name__ == "__main__":
    sys.exit(judged_runs(__doc__, EXPECTED, run_one, RunOutcome))
