"""The service under load and under the axe.

    python benchmarks/bench_service.py [--poll-seconds 20] [--kills 30] [--changes 200]

- Polling at 200 requests/s from 20 clients during a run: latency from each request's due time (a late
  server cannot hide behind its clients), what the run lost by it.
- kill -9 of the service at random moments of a run: every run ends ``interrupted`` or was stored whole, no
  runner is left, the store is consistent, the next run starts.
- The change test on unchanged simulated cells (each run draws its own noise): runs of the small cell
  identified, every later one compared with the first and with its predecessor.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import sqlite3
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "system"))
from service_process import Serving, serving

CLIENTS = 20
RATE = 200.0


def poll(seconds: float) -> bool:
    """200 requests/s on the state of a run in progress."""
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder)) as service:
        location = service.start()
        service.wait(location, "running")
        late: list[float] = []
        failures: list[str] = []
        lock = threading.Lock()
        start = time.perf_counter() + 0.2

        def client(k: int) -> None:
            own: list[float] = []
            with httpx.Client(base_url=service.url, trust_env=False, timeout=10) as http:
                n = 0
                while (due := start + (k + n * CLIENTS) / RATE) < start + seconds:
                    time.sleep(max(0.0, due - time.perf_counter()))
                    answer = http.get(location)
                    own.append(time.perf_counter() - due)
                    if answer.status_code != 200:
                        failures.append(answer.text)
                    n += 1
            with lock:
                late.extend(own)

        threads = [threading.Thread(target=client, args=(k,)) for k in range(CLIENTS)]
        for t in threads:
            t.start()
        for t in threads:
            t.join()
        state = service.client.get(location).json()["state"]
        service.client.post("/api/v1/cells/small/stop")
    p50, p99, worst = (1e3 * float(np.quantile(late, q)) for q in (0.5, 0.99, 1.0))
    print(
        f"polling: {len(late)} requests from {CLIENTS} clients at {RATE:.0f}/s, run was {state} at the end: "
        f"p50 {p50:.1f} ms, p99 {p99:.1f} ms, worst {worst:.1f} ms, {len(failures)} failed"
    )
    return p99 < 50 and not failures


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


def kill(times: int, seed: int = 1) -> bool:
    """kill -9 at random moments."""
    rng = random.Random(seed)
    wrong: list[str] = []
    seen: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        previous: str | None = None
        for n in range(times + 1):
            with serving(folder) as service:
                if service.runners():
                    wrong.append(f"kill {n}: a runner lives on")
                if previous is not None:
                    body: dict[str, Any] = service.client.get(previous).json()
                    if body["state"] not in ("interrupted", "awaiting_accept"):
                        wrong.append(f"kill {n}: the run is {body['state']}")
                if n == times:
                    break
                previous = service.start()
                moment = rng.uniform(0.0, 12.0)
                time.sleep(moment)
                state = service.client.get(previous).json()["state"]
                seen[state] = seen.get(state, 0) + 1
                service.kill()
            wrong += [f"kill {n}: {w}" for w in consistent(folder)]
    print(f"kill -9: {times} times, in states {seen}: {len(wrong)} wrong {wrong[:5]}")
    return not wrong


def identified(service: Serving) -> str:
    """One run of the small cell, accepted; its model's id."""
    location = service.run_to_result()
    service.client.post(f"{location}/actions", json={"type": "accept"})
    return location.rsplit("/", 1)[1]


def changes(comparisons: int) -> bool:
    """False alarms on an unchanged cell, and a changed one found."""
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder)) as service:
        runs = 2
        while runs * (runs - 1) // 2 < comparisons:
            runs += 1
        models = [identified(service) for _ in range(runs)]
        path = "/api/v1/cells/small/changes"
        alarms = tried = 0
        for i, old in enumerate(models):
            for new in models[i + 1 :]:
                if tried < comparisons:
                    body = service.client.get(path, params={"from": old, "to": new}).json()
                    alarms += any(p["status"] == "changed" for p in body["parameters"])
                    tried += 1
        service.client.patch(
            "/api/v1/cells/small/simulation", json={"payload": {"axis": "A1", "mass": 0.2}}
        ).raise_for_status()
        heavier = identified(service)
        body = service.client.get(path, params={"from": models[-1], "to": heavier}).json()
        named = [p["parameter"] for p in body["parameters"] if p["status"] == "changed"]
    print(
        f"changes: {alarms} false alarms in {tried} comparisons of {runs} runs of an unchanged cell "
        f"(λ = {body['repeatability']['factor']:.2f}); final mass +0.2 of 2.0 kg·m²: named {named}"
    )
    return alarms <= max(1, round(0.02 * tried)) and named == ["A1.mass.2"]


def main() -> int:
    """Run the campaigns; the exit status is the number that missed their promise."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poll-seconds", type=float, default=20.0)
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--changes", type=int, default=200)
    given = parser.parse_args()
    kept = []
    if given.poll_seconds > 0:
        kept.append(poll(given.poll_seconds))
    if given.kills > 0:
        kept.append(kill(given.kills))
    if given.changes > 0:
        kept.append(changes(given.changes))
    return kept.count(False)


if __name__ == "__main__":
    sys.exit(main())
