"""A plant of twenty simulated cells, each in a state of its own, from two runs that were really measured."""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from service_process import SMALL_CELL, Serving, serving

CELLS = 20
STIFF = SMALL_CELL + "  axes: {A1: {friction: {coulomb_Nm: 1.0}}}\n"


def name(number: int) -> str:
    return f"robot {number:02d}"


@contextmanager
def plant(folder: Path) -> Iterator[Serving]:
    """Robot 01 waits with another tool to be accepted, 02 with a result that is not to be trusted; 03 was
    stopped, 04 failed, 05 is to act on; 06 to 18 are in order, measured longer and longer ago; 19 and 20 were
    never measured.
    """
    configs = []
    for number in range(1, CELLS + 1):
        config = folder / f"r{number:02d}.yaml"
        cell = STIFF.replace("robot: small cell", f"robot: {name(number)}")
        config.write_text(cell.replace("channel: small", f"channel: r{number:02d}"))
        configs.append(str(config))
    with serving(folder, *configs, cell=None) as service:
        first = service.run_to_result()
        service.client.post(f"{first}/actions", json={"type": "accept"})
        service.client.patch("/api/v1/cells/r01/simulation", json={"payload": {"axis": "A1", "mass": 0.4}})
        second = service.run_to_result()
    with contextlib.closing(sqlite3.connect(folder / "data" / "store.sqlite")) as store, store:
        _fill(store, *(location.rsplit("/", 1)[1] for location in (first, second)))
    with serving(folder, *configs, cell=None) as service:
        yield service


def _fill(store: sqlite3.Connection, first: str, second: str) -> None:
    now = datetime.now(UTC)
    error = {"code": "bus", "text": "the bus failed", "fix": "check the CAN adapter"}
    stopped = {"code": "stopped", "text": "stopped on request", "fix": "start again when the cell is clear"}
    _copy(store, second, 2, now - timedelta(minutes=30), mode="test", facts=_without_doubts(store, second))
    _copy(store, first, 3, now - timedelta(hours=2), state="stopped", facts={"error": stopped})
    _copy(store, first, 4, now - timedelta(hours=3), state="failed", facts={"error": error})
    facts = json.loads(_row(store, "runs", "id", first)["facts"])
    act = {**facts, "summary": {**facts["summary"], "grade": "act"}}
    _copy(store, first, 5, now - timedelta(hours=4), facts=act)
    for number in range(6, 19):
        _copy(store, first, number, now - timedelta(days=number - 5))


def _without_doubts(store: sqlite3.Connection, run: str) -> dict[str, Any]:
    """What is told of a run, its doubts left to how it was measured."""
    facts: dict[str, Any] = json.loads(_row(store, "runs", "id", run)["facts"])
    del facts["summary"]["doubts"]
    return facts


def _copy(store: sqlite3.Connection, run: str, number: int, at: datetime, **other: Any) -> None:
    """Copy a run, with its files, to another cell."""
    identity = f"{at:%Y%m%dT%H%M%S}-{number:08x}"
    row = _row(store, "runs", "id", run)
    facts = other.pop("facts", json.loads(row["facts"]))
    own = {"id": identity, "cell": f"r{number:02d}", "robot": name(number), "number": 100 - number}
    ended = None if row["ended"] is None else f"{at:%Y-%m-%d %H:%M:%S.%f}"
    _insert(store, "runs", {**row, **own, "ended": ended, "facts": json.dumps(facts), **other})
    for kind in store.execute("SELECT kind FROM artefacts WHERE run = ?", [run]).fetchall():
        file = _row(store, "artefacts", "run", run, f" AND kind = '{kind[0]}'")
        _insert(store, "artefacts", {**file, "run": identity})
    _insert(store, "models", {**_row(store, "models", "id", run), "id": identity, "cell": own["cell"]})


def _row(store: sqlite3.Connection, table: str, key: str, value: str, more: str = "") -> dict[str, Any]:
    found = store.execute(f"SELECT * FROM {table} WHERE {key} = ?{more}", [value])
    return dict(zip([c[0] for c in found.description], found.fetchone(), strict=True))


def _insert(store: sqlite3.Connection, table: str, row: dict[str, Any]) -> None:
    marks = ", ".join("?" * len(row))
    store.execute(f"INSERT INTO {table} ({', '.join(row)}) VALUES ({marks})", list(row.values()))
