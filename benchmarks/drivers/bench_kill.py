"""kill -9 of the parent, the cycle process, the simulated cell, at random moments of a real-time run; the
parent stopped; Ctrl-C while the disk stalls.

    python benchmarks/drivers/bench_kill.py [--runs 20] [--seed 0] [--results runs.jsonl] [--markdown]

Afterwards: every drive of a cell that still runs is off, and no axis outside its window; nobody is left
running; the command ends with the right status; the recording opens and has the samples up to the kill. Where
nothing is killed, the quick stop is on the bus in the time stated.
"""

from __future__ import annotations

import argparse
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
import yaml

from benchmarks.shared.campaign import aligned, resumed
from benchmarks.shared.processes import children, start, wait_for
from invid.errors import InvidError
from invid.recording import Outcome, read_recording
from invid_drivers.simulated.unix_bus import UnixBus

CONFIG = Path(__file__).parents[2] / "configs" / "case-study-unix.yaml"
VICTIMS = ("parent", "cycle process", "simulated cell", "parent stopped", "disk stalled")
CYCLE_S, PERIOD_S, PERIODS = 0.004, 2.048, 8
ROWS = round(PERIODS * PERIOD_S / CYCLE_S)
RUN_S = 38.0
"""About how long a run takes after it has enabled the drives, some 20 s of trials and 17 s of record; the
kill comes at any moment of it."""
OFF = {"switch_on_disabled", "ready_to_switch_on", "switched_on", "fault", "not_ready_to_switch_on"}
LOST_S = {"parent": 1.6, "cycle process": 0.3, "simulated cell": 0.3}
"""What of the record may be lost: the writer flushes once a second; rows leave the cycle process every
50 ms. The rest is for a busy machine."""
WINDOW, TOP_SPEED, DRIVE_MARGIN, QUICK_STOP = 0.5, 3.0, 1.25, 10.0
FURTHEST = DRIVE_MARGIN * WINDOW + (DRIVE_MARGIN * TOP_SPEED) ** 2 / (2 * QUICK_STOP) + 0.02
"""A drive without its master stops by its own limits, a quarter above the config's, with its quick stop of
10 rad/s²; 0.02 rad for one cycle of it and the springs."""
QUICK_STOP_S = {"parent stopped": 1.0 + 0.1 + 0.3, "disk stalled": 0.1 + 0.3}
"""From a parent that answers no more, or a Ctrl-C, to the quick stop on the bus: the documented keep-alive,
the fade, and what a busy machine takes."""
STALL = """
import os, time
from invid.recording import RecordingWriter

def stalled(method):
    def waits(*arguments, **named):
        while os.path.exists("stall"):
            time.sleep(0.01)
        return method(*arguments, **named)
    return waits

for name, method in list(vars(RecordingWriter).items()):
    if callable(method):
        setattr(RecordingWriter, name, stalled(method))
"""
"""A disk that takes nothing as long as a file named stall is there."""
START_S = 400.0
"""Longest start of a command on a machine that is very busy with other things."""


@dataclass(frozen=True)
class Kill:
    """One run."""

    victim: str
    moment_s: float
    phase: str
    status: int | None
    rows: int
    lost_s: float
    complaints: tuple[str, ...]


def cell_config(folder: Path) -> Path:
    """The case study at 250 Hz, one experiment."""
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    data["bus"] |= {"channel": str(folder / "bus.sock"), "cycle_s": CYCLE_S}
    data["experiments"] = [
        {"kind": "multisine", "band_Hz": [1, 12], "period_s": PERIOD_S, "periods": PERIODS,
         "settle_periods": 0, "experiments": 1}
    ]  # fmt: skip
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def alive(pid: int) -> bool:
    """Whether a process still runs (a zombie does not)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def run_one(victim: str, rng: np.random.Generator, folder: Path) -> Kill:
    """One measurement, one kill."""
    path = cell_config(folder)
    out = folder / "run.h5"
    complaints: list[str] = []
    cell = start(folder, "simcell", str(path), "--json", errors="cell.txt")
    measure = None
    try:
        wait_for(cell, folder / "cell.txt", "ready", START_S)
        (folder / "sitecustomize.py").write_text(STALL, encoding="utf-8")
        stall = {"PYTHONPATH": str(folder)} if victim == "disk stalled" else {}
        measure = start(folder, "measure", str(path), "-o", str(out), "--json", errors="measure.txt", **stall)
        wait_for(measure, folder / "measure.txt", "enabling", START_S)
        # a run whose disk stalls must not be over before
        moment = float(rng.uniform(0.0, 0.7 * RUN_S if victim in QUICK_STOP_S else RUN_S))
        if victim == "disk stalled":
            (folder / "stall").touch()
        time.sleep(moment)
        cycle = children(measure.pid)
        targets = {"parent": [measure.pid], "cycle process": cycle, "simulated cell": [cell.pid]}
        target = targets.get(victim, [])
        phase = (folder / "measure.txt").read_text().strip().rsplit("left", 1)[-1].strip()
        killed = time.monotonic()
        ended = measure.poll() is not None
        for pid in target:
            os.kill(pid, signal.SIGKILL)
        if victim in QUICK_STOP_S and not ended:
            _hold_up(victim, measure, folder, complaints)
        try:
            status: int | None = measure.wait(timeout=60)
        except subprocess.TimeoutExpired:
            status = None
            complaints.append("the command did not end")
        wanted = {"parent": -9, "cycle process": 5, "simulated cell": 5}.get(victim, 4)
        if status != wanted and not ended and (target or victim in QUICK_STOP_S):
            complaints.append(f"exit {status}")
        # heartbeat watch of three halves of a second, quick stop, and the orphan's own way out
        end = time.monotonic() + 15.0
        while any(alive(p) for p in cycle) and time.monotonic() < end:
            time.sleep(0.05)
        if any(alive(p) for p in cycle):
            complaints.append("the cycle process was left running")
        if victim != "simulated cell":
            time.sleep(max(0.0, killed + 4.0 - time.monotonic()))
            cell.send_signal(signal.SIGINT)
            _judge_cell(json.loads(cell.communicate(timeout=60)[0]), complaints)
        rows, lost = _judge_record(out, victim, killed, ended, complaints)
    finally:
        for process in (cell, measure):
            if process is not None and process.poll() is None:
                process.kill()
                process.communicate()
    return Kill(victim, moment, phase, status, rows, lost, tuple(complaints))


def _hold_up(victim: str, measure: subprocess.Popen[str], folder: Path, complaints: list[str]) -> None:
    """Stop the parent, or ask to stop while the disk takes nothing; when is the quick stop on the bus?"""
    bus = UnixBus(str(folder / "bus.sock"))
    try:
        measure.send_signal(signal.SIGSTOP if victim == "parent stopped" else signal.SIGINT)
        began = time.monotonic()
        took = None
        while took is None and time.monotonic() < began + 10.0:
            message = bus.recv(0.1)
            # controlword first: bit 1 set, bit 2 clear
            if message is not None and 0x200 < message.arbitration_id < 0x280 and message.data[0] & 6 == 2:
                took = time.monotonic() - began
    finally:
        bus.shutdown()
    if took is None or took > QUICK_STOP_S[victim]:
        when = "never" if took is None else f"after {took:.2f} s"
        complaints.append(f"the quick stop came {when}")
    time.sleep(2.0)
    if victim == "parent stopped":
        measure.send_signal(signal.SIGCONT)
    (folder / "stall").unlink(missing_ok=True)


def _judge_cell(document: dict[str, Any], complaints: list[str]) -> None:
    for drive in document["drives"]:
        if drive["state"] not in OFF:
            complaints.append(f"{drive['axis']} ended in {drive['state']}")
        if abs(drive["position"]) > FURTHEST:
            complaints.append(f"{drive['axis']} ended at {drive['position']:.2f}")


def _judge_record(
    out: Path, victim: str, killed: float, ended: bool, complaints: list[str]
) -> tuple[int, float]:
    if victim == "parent" and not out.exists():
        out = out.with_name(f"{out.name}.rows")  # nobody was left to make a recording of them
    if not out.exists():
        return 0, 0.0
    try:
        recording = read_recording(out)
    except InvidError as error:
        # the writer flushes once a second: killed in the first one, the file says that it holds nothing
        if victim != "parent" or "no experiment with data" not in str(error):
            complaints.append(f"the recording does not open: {error}")
        return 0, 0.0
    rows = sum(e.samples for e in recording.experiments)
    wanted = Outcome.ABORTED if victim in QUICK_STOP_S else Outcome.FAILED
    complete = rows >= ROWS
    if not ended and not complete and recording.outcome is not wanted:
        complaints.append(f"marked {recording.outcome}")
    # SYNC instants are of the machine's monotonic clock, as the moment of the kill
    lost = 0.0 if complete or not rows else killed - float(recording.experiments[-1].time[-1])
    if lost > LOST_S.get(victim, np.inf):
        complaints.append(f"the last {lost:.2f} s are lost")
    return rows, max(lost, 0.0)


def table(kills: list[Kill], *, markdown: bool) -> str:
    """Victims × outcomes."""
    head = ("killed", "runs", "exit", "with a recording", "most of it lost [s]", "violations")
    rows = [head]
    for victim in VICTIMS:
        group = [k for k in kills if k.victim == victim]
        if group:
            status = ", ".join(sorted({str(k.status) for k in group}))
            kept = [k for k in group if k.rows]
            lost = max((k.lost_s for k in kept), default=0.0)
            bad = sum(bool(k.complaints) for k in group)
            rows.append((victim, str(len(group)), status, str(len(kept)), f"{lost:.2f}", str(bad)))
    return aligned(rows, markdown=markdown)


def main() -> int:
    """Run the campaign and print the table; the exit status is 1 where a requirement was broken."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20, help="of each victim")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--results", type=Path)
    parser.add_argument("--victim", choices=VICTIMS, help="this one alone")
    parser.add_argument("--markdown", action="store_true")
    arguments, _ = parser.parse_known_args()
    began = time.monotonic()
    victims = (arguments.victim,) if arguments.victim else VICTIMS

    def one(n: int, folder: Path) -> Kill:
        return run_one(victims[n % len(victims)], np.random.default_rng([arguments.seed, n]), folder)

    runs = arguments.runs * len(victims)
    kills = resumed(runs, one, Kill, seed=arguments.seed, results=arguments.results)
    print(table(kills, markdown=arguments.markdown))
    bad = [(n, k) for n, k in enumerate(kills) if k.complaints]
    for n, k in bad:
        print(f"run {n} ({k.victim} at {k.moment_s:.1f} s, {k.phase}): {'; '.join(k.complaints)}")
    print(f"{len(kills)} runs, {len(bad)} violations, {time.monotonic() - began:.0f} s")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
