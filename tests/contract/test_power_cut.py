"""Power cuts at any step of writing and restoring, and settings changed by hand before the next start.

A child process measures on the simulated cell and dies, without a word, just before or after one of its
writes into a drive or onto the disk. The drives keep what they were given. Then somebody changes a setting
with the drive's own tool, or a drive refuses a write for a while, and `check` is started, which may be cut as
well. After the last `check` every setting that was changed by hand must have its new value, and every other
one the value from before the first command.
"""

import contextlib
import json
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from machines.short_case_study import short_case_study

from invid.config import CellConfig, parse_config
from invid.errors import InvidError
from invid.planning import make_plan
from invid.sweep import Progress
from invid_drivers.cia402.axis import Drive
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.journal import Journal
from invid_drivers.measurement import run_measurement
from invid_drivers.simulated import VirtualTimeBus, open_virtual_bus
from invid_drivers.simulated.cell import SimulatedCell
from invid_drivers.simulated.object_dictionary import Entry

# One worker: what numba compiles for the plant is compiled once.
pytestmark = pytest.mark.xdist_group("faults")

Address = tuple[int, int, int]
"""Row of the drive, index, subindex."""
RUNNING = {0x6040, 0x6060, 0x6071, 0x607A, 0x60B2, 0x60FF, 0x1003}
"""Objects that are commands or a history, not settings."""
BY_HAND = {
    (0x6072, 0): (50, 100, 150), (0x607F, 0): (50_000, 90_000), (0x607D, 1): (-9_000, -7_000),
    (0x607D, 2): (7_000, 9_000), (0x6065, 0): (3_000, 5_000), (0x605A, 0): (1, 5), (0x1017, 0): (170, 230),
    (0x6007, 0): (1, 2),
}  # fmt: skip
"""Settings that a technician tightens, to values that nobody else writes."""


@dataclass
class History:
    """One drive's story."""

    cut: int
    """Step at which the measurement died."""
    of: int
    steps: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)


class Bench:
    """One cell, and the commands of a person beside it."""

    def __init__(self, config: CellConfig, folder: Path) -> None:
        self.config, self.folder = config, folder
        self._port: VirtualTimeBus | None = open_virtual_bus(config)
        self.cell: SimulatedCell = self._port.wire.cell

    def _connect(self) -> Cia402Cell:
        assert self._port is not None
        return Cia402Cell(self._port, self.config, journal=Journal(self.folder / "bus.journal"))

    def measure(self) -> None:
        """A measurement that is stopped on request as soon as the axes are held."""
        stop = threading.Event()

        def progress(report: Progress) -> None:
            if report.phase.startswith("trying"):
                stop.set()

        plan, out = make_plan(self.config), self.folder / "run.h5"
        with contextlib.suppress(InvidError):
            run_measurement(self.config, plan, self._connect(), out, progress=progress, stop=stop)

    def check(self) -> None:
        """``invid check``."""
        cell = self._connect()
        with contextlib.suppress(InvidError):
            try:
                cell.check()
            finally:
                cell.close()

    def close(self) -> None:
        """The port that no command has taken."""
        if self._port is not None:
            self._port.shutdown()


def cell_config() -> CellConfig:
    """The case study at 250 Hz with one short experiment."""
    data = short_case_study()
    data["simulation"]["defaults"] |= {"brake": False, "enable_s": 0.2}
    return parse_config(yaml.safe_dump(data))


def settings(cell: SimulatedCell) -> dict[Address, int]:
    """Every setting of every drive."""
    return {
        (row, e.index, e.sub): e.value
        for row, drive in enumerate(cell.drives)
        for e in drive.node.od
        if e.access == "rw" and isinstance(e.value, int) and e.index not in RUNNING
    }


def put(cell: SimulatedCell, values: dict[Address, int]) -> None:
    """Drives that keep what they were given."""
    for (row, index, sub), value in values.items():
        entry = cell.drives[row].node.od.entry(index, sub)
        entry.value = entry.default = value


class Steps:
    """Counts writes into drives and onto the disk; dies at one of them."""

    def __init__(self, at: int, die: Callable[[], None]) -> None:
        self.count, self._at, self._die = 0, at, die

    def wrap(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Before it and after it are two steps."""

        def stepped(*args: Any, **kwargs: Any) -> Any:
            self._step()
            result = function(*args, **kwargs)
            self._step()
            return result

        return stepped

    def _step(self) -> None:
        self.count += 1
        if self.count == self._at:
            self._die()


def in_child(
    config: CellConfig,
    folder: Path,
    values: dict[Address, int],
    refusing: set[Address],
    at: int,
    command: Callable[[Bench], Any],
) -> tuple[dict[Address, int], int, bool]:
    """Settings of the drives, steps taken and whether it died, after a command in a process of its own."""
    report = folder / "child.json"
    report.unlink(missing_ok=True)
    child = os.fork()
    if child == 0:
        status = 1
        try:
            bench = Bench(config, folder)
            put(bench.cell, values)
            for row, index, sub in refusing:
                bench.cell.drives[row].node.od.entry(index, sub).access = "ro"
            # the report must not count as a step
            dump = os.open(report, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)

            def tell(died: bool) -> None:
                after = [[*a, v] for a, v in settings(bench.cell).items()]
                os.write(dump, json.dumps([after, steps.count, died]).encode())

            def die() -> None:
                tell(True)
                os._exit(0)

            steps = Steps(at, die)
            Entry.write = steps.wrap(Entry.write)  # type: ignore[method-assign]
            os.fsync = steps.wrap(os.fsync)
            os.replace = steps.wrap(os.replace)
            os.unlink = steps.wrap(os.unlink)
            command(bench)
            tell(False)
            status = 0
        finally:
            os._exit(status)
    _, status = os.waitpid(child, 0)
    if status:
        raise RuntimeError("the command failed with something else than an error of the product")
    after, count, died = json.loads(report.read_text(encoding="utf-8"))
    found = {(row, index, sub): value for row, index, sub, value in after}
    return {**values, **found}, count, died


def run_one(rng: np.random.Generator, folder: Path) -> History:
    """One power cut, what people did meanwhile, and the starts after it."""
    for old in folder.glob("*"):
        old.unlink()
    names = ("A1", "A2", "A3")
    config = cell_config()
    bench = Bench(config, folder)
    before = settings(bench.cell)
    bench.close()
    values, total, _ = in_child(config, folder, before, set(), 0, Bench.measure)
    _compare("a run without a cut", before, values, History(0, total))
    history = History(int(rng.integers(1, total + 1)), total)
    values, _, _ = in_child(config, folder, before, set(), history.cut, Bench.measure)
    expected = dict(before)
    for _ in range(int(rng.integers(1, 4))):
        refusing: set[Address] = set()
        match rng.choice(["by hand", "refused", "cut"], p=[0.6, 0.2, 0.2]):
            case "by hand":
                row = int(rng.integers(len(names)))
                index, sub = list(BY_HAND)[int(rng.integers(len(BY_HAND)))]
                value = int(rng.choice(BY_HAND[index, sub]))
                values[row, index, sub] = expected[row, index, sub] = value
                history.steps.append(f"{names[row]} 0x{index:04X}:{sub} set to {value} by hand")
                values, _, _ = in_child(config, folder, values, refusing, 0, Bench.check)
            case "refused":
                row = int(rng.integers(len(names)))
                changed = [a for a in values if values[a] != before[a] and a[0] == row and a[1] >= 0x6000]
                refusing = {changed[int(rng.integers(len(changed)))]} if changed else set()
                history.steps.append(f"refused: {[f'0x{i:04X}:{s}' for _, i, s in refusing]}")
                kept = {a: values[a] for a in refusing}
                values, _, _ = in_child(config, folder, values, refusing, 0, Bench.check)
                values |= kept
            case _:
                at = int(rng.integers(1, 40))
                history.steps.append(f"check cut at step {at}")
                values, _, _ = in_child(config, folder, values, refusing, at, Bench.check)
    values, _, _ = in_child(config, folder, values, set(), 0, Bench.check)
    _compare("at the end", expected, values, history)
    if (folder / "bus.journal").exists() and (folder / "bus.journal").read_text().strip():
        values, _, _ = in_child(config, folder, values, set(), 0, Bench.check)
        if values != expected:
            history.complaints.append("one more check changed something again")
    return history


def _compare(when: str, expected: dict[Address, int], found: dict[Address, int], history: History) -> None:
    for (row, index, sub), value in expected.items():
        if found[row, index, sub] != value:
            history.complaints.append(
                f"{when}: drive {row + 1} 0x{index:04X}:{sub} is {found[row, index, sub]}, not {value}"
            )


def test_after_a_power_cut_no_newer_setting_is_undone_and_no_entry_is_lost(tmp_path: Path) -> None:
    for number in range(4):
        history = run_one(np.random.default_rng([2026, number]), tmp_path)
        assert history.complaints == [], history


def test_a_product_that_restores_nothing_is_convicted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Drive, "restore", lambda self, *a, **k: [])
    history = run_one(np.random.default_rng([2026, 0]), tmp_path)
    assert any("at the end" in c for c in history.complaints)
