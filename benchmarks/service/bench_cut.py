"""kill -9 at random instants of a measurement: what was measured is there, readable and marked.

    python benchmarks/service/bench_cut.py [--cuts 20] [--seed 0] [--work-out 1]

Victims in turn: the runner of ``invid serve``; the service; both at once, as a power cut ends them;
``invid measure`` on the command line. The instant is any from the first rows on the disk to some seconds into
the analysis. Afterwards the recording opens, holds every row that was on the disk, and its
``outcome`` says how it ended; the service offers it, has every run in its store, and works it out
or says why not.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import os
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import h5py

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "system"))
from service_process import ENDED, SMALL_CELL, Serving, serving

from benchmarks.shared.processes import INVID
from invid.errors import InvidError
from invid.recording import Outcome, Recording, read_recording
from invid.recording.spool import has_rows, is_spool

CELL = SMALL_CELL.replace("periods: 3", "periods: 12").replace("periods: 2,", "periods: 8,")
"""Forty seconds of record: some five of a quiet machine in virtual time."""
VICTIMS = ("runner", "service", "both", "command")
WINDOW_S = 5.0
"""After the first rows."""


@dataclass(frozen=True)
class Cut:
    """One kill and what was left."""

    victim: str
    moment_s: float
    state: str
    rows: int
    outcome: str
    analysis: str
    complaints: tuple[str, ...]


def consistent(folder: Path) -> list[str]:
    """What is wrong with a store that nobody has open."""
    wrong = []
    database = sqlite3.connect(folder / "data" / "store.sqlite")
    if database.execute("PRAGMA integrity_check").fetchone() != ("ok",):
        wrong.append("the database is damaged")
    if database.execute("PRAGMA foreign_key_check").fetchall():
        wrong.append("rows point nowhere")
    for path, sha256 in database.execute("SELECT path, sha256 FROM artefacts WHERE deleted IS NULL"):
        file = folder / "data" / "files" / path
        if not file.exists() or hashlib.sha256(file.read_bytes()).hexdigest() != sha256:
            wrong.append(f"{path} is missing or differs from its checksum")
    database.close()
    return wrong


def kill(process: int) -> None:
    """SIGKILL; one that has gone is no error."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)


def until_rows(rows: Path, alive: Callable[[], bool], seconds: float = 600.0) -> None:
    """Wait until rows are on the disk."""
    end = time.monotonic() + seconds
    while not (is_spool(rows) and has_rows(rows)):
        if time.monotonic() > end or not alive():
            raise SystemExit(f"no rows came to {rows}")
        time.sleep(0.01)


def on_disk(rows: Path) -> int:
    """Rows that were on the disk by now; 0 where the recording has been closed."""
    try:
        return count(read_recording(rows))
    except InvidError:
        return 0


def count(recording: Recording) -> int:
    """Rows of all experiments."""
    return sum(e.samples for e in recording.experiments)


def cut_service(folder: Path, victim: str, moment_s: float, work_out: bool) -> Cut:
    """Kill in mid-run, start again, look."""
    complaints: list[str] = []
    with serving(folder, cell=CELL) as service:
        location = service.start()
        run = location.rsplit("/", 1)[1]
        rows = folder / "data" / "work" / run / "recording.h5.rows"
        until_rows(rows, lambda: service.process.poll() is None)
        time.sleep(moment_s)
        state = service.client.get(location).json()["state"]
        before = on_disk(rows)
        (runner,) = service.runners() or (0,)
        if victim == "both":
            os.kill(service.process.pid, signal.SIGSTOP)
        if victim in ("runner", "both") and runner:
            kill(runner)
        if victim in ("service", "both"):
            service.kill()
        else:
            end = time.monotonic() + 60.0
            while service.client.get(location).json()["state"] not in {*ENDED, "awaiting_accept"}:
                if time.monotonic() > end:
                    complaints.append("the service did not notice that its runner had gone")
                    break
                time.sleep(0.05)
    complaints += consistent(folder)
    with serving(folder, cell=CELL) as service:
        found = look(
            service, Cut(victim, moment_s, state, before, "", "", tuple(complaints)), location, folder
        )
        return worked_out(service, found, location) if work_out and found.rows else found


def look(service: Serving, cut: Cut, location: str, folder: Path) -> Cut:
    """What a service that was started again has of the run."""
    complaints = list(cut.complaints)
    body = service.client.get(location).json()
    if body.get("state") not in ("interrupted", "failed", "awaiting_accept"):
        complaints.append(f"the run is {body.get('state', body)}")
    answer = service.client.get(f"{location}/recording")
    if answer.status_code != 200:
        complaints.append(f"no recording: {answer.text}")
        return replace(cut, rows=0, complaints=tuple(complaints))
    file = folder / "fetched.h5"
    file.write_bytes(answer.content)
    rows, outcome = judge(file, cut.rows, complaints)
    return replace(cut, rows=rows, outcome=outcome, complaints=tuple(complaints))


def worked_out(service: Serving, cut: Cut, location: str) -> Cut:
    """What the analysis makes of what is left."""
    complaints = list(cut.complaints)
    answer = service.client.post(f"{location}/analysis")
    end = time.monotonic() + 600.0
    while (body := service.client.get(answer.headers["Location"]).json())["state"] not in ENDED:
        if time.monotonic() > end:
            break
        time.sleep(0.2)
    error = body["error"] or {}
    said = body["summary"]["verdict"] if body["state"] == "succeeded" else error.get("text", "")
    if body["state"] not in ("succeeded", "failed") or not said:
        complaints.append(f"the analysis is {body['state']}: {said}")
    if error.get("code") in ("internal-error", "runner-died"):
        complaints.append(f"the analysis broke: {said}")
    return replace(cut, analysis=said, complaints=tuple(complaints))


def judge(file: Path, before: int, complaints: list[str]) -> tuple[int, str]:
    """Rows and outcome of what is left; ``before`` rows had been on the disk."""
    try:
        recording = read_recording(file)
    except InvidError as error:
        complaints.append(f"the recording does not open: {error}")
        return 0, ""
    rows = count(recording)
    if rows < before:
        complaints.append(f"{before - rows} rows that were on the disk are gone")
    return rows, str(recording.outcome)


def cut_command(folder: Path, moment_s: float, work_out: bool) -> Cut:
    """``invid measure`` killed, its rows looked at by ``invid identify``."""
    complaints: list[str] = []
    (folder / "cell.yaml").write_text(CELL)
    out = folder / "r.h5"
    rows = folder / "r.h5.rows"
    command = [*INVID, "measure", "cell.yaml", "-o", "r.h5"]
    with (folder / "measure.txt").open("w") as said:
        process = subprocess.Popen(command, cwd=folder, stdout=said, stderr=said)
    until_rows(rows, lambda: process.poll() is None)
    time.sleep(moment_s)
    before = on_disk(rows)
    ended = process.poll() is not None
    kill(process.pid)
    process.wait()
    left = out if out.exists() else rows
    kept, outcome = judge(left, before, complaints)
    wanted = Outcome.COMPLETED if out.exists() and h5py.is_hdf5(out) else Outcome.FAILED
    if outcome != wanted:
        complaints.append(f"it is marked {outcome}")
    state = "ended" if ended else "measuring"
    found = Cut("command", moment_s, state, kept, outcome, "", tuple(complaints))
    return identified(left, found) if work_out else found


def identified(left: Path, cut: Cut) -> Cut:
    """What ``invid identify`` makes of what is left."""
    command = [*INVID, "identify", left.name, "-o", "m.json"]
    done = subprocess.run(command, cwd=left.parent, capture_output=True, text=True, check=False)
    complaints = cut.complaints
    if done.returncode not in (0, 2, 3) or "Traceback" in done.stderr:
        last = (done.stderr.strip().splitlines() or [""])[-1]
        complaints = (*complaints, f"identify ended with {done.returncode}: {last}")
    return replace(cut, analysis=f"exit {done.returncode}", complaints=complaints)


def cut(victim: str, moment_s: float, folder: Path, *, work_out: bool = True) -> Cut:
    """One kill; ``work_out``: what is left is analysed, too."""
    if victim == "command":
        return cut_command(folder, moment_s, work_out)
    return cut_service(folder, victim, moment_s, work_out)


def main() -> None:
    """Entry."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cuts", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work-out", type=int, default=1, help="analyse every so many recordings")
    given = parser.parse_args()
    rng = random.Random(given.seed)
    cuts = []
    for n in range(given.cuts):
        victim, moment_s = VICTIMS[n % len(VICTIMS)], rng.uniform(0.0, WINDOW_S)
        with tempfile.TemporaryDirectory() as folder:
            found = cut(victim, moment_s, Path(folder), work_out=n // len(VICTIMS) % given.work_out == 0)
        cuts.append(found)
        print(
            f"{n + 1}: {victim} {moment_s:.2f} s after the first rows ({found.state}): {found.rows} rows, "
            f"{found.outcome}, {found.analysis[:90]} {list(found.complaints)}",
            flush=True,
        )
    wrong = [c for c in cuts if c.complaints]
    readable = sum(bool(c.rows) for c in cuts)
    print(f"kill -9: {len(cuts)} times, {readable} readable recordings, {len(wrong)} with complaints")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
