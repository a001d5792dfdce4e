"""The judge of the campaign must be able to say no: whoever does harm is convicted by each of its rules."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from node_master import Master

from benchmarks.drivers.bench_real_drives import Case, cell_config, run_one
from benchmarks.drivers.plant_judge import Judge, writes
from invid_drivers.cia402.bus import Cia402Cell

# One worker: what numba compiles for the plant is compiled once.
pytestmark = pytest.mark.xdist_group("faults")
AXES = ("A1", "A2", "A3")
LOADED = {"load": {"torque_Nm": 5.0, "element": "motor"}, "enable_s": 0.0}


def case(axes: dict[str, dict[str, Any]] | None = None, **drive: Any) -> Case:
    """Three axes, A1 as given."""
    drives: dict[str, dict[str, Any]] = {name: {"enable_s": 0.0} for name in AXES}
    drives["A1"] |= drive
    return Case("none", {name: dict((axes or {}).get(name, {})) for name in AXES}, drives)


class Harm:
    """A hand-made master that does what no master should, and the judge that watches."""

    def __init__(self, drawn: Case, mode: int = 10) -> None:
        self.config = cell_config(drawn, 1)
        self.master = Master(self.config)
        self.cell = self.master.bus.cell
        self.judge = Judge(self.config, self.cell)
        self.master.prepare(mode)

    def shake(self, permille: int, cycles: int, word: int = 0x0F) -> None:
        for _ in range(cycles):
            self.master.cycle([permille, 0, 0], word, 0.004)


def test_a_loaded_axis_that_is_let_go_is_seen_and_one_that_is_held_is_not() -> None:
    harm = Harm(case(**LOADED), mode=8)
    harm.master.enable()
    for _ in range(50):
        harm.master.cycle([0, 0, 0], 0x0F, 0.004)
    harm.judge.stopped()
    for _ in range(100):
        harm.master.cycle([0, 0, 0], 0x0F, 0.004)
    assert harm.judge.loads() == []
    for _ in range(100):
        harm.master.cycle([0, 0, 0], 0x00, 0.004)
    assert any("A1: loaded, moved" in c for c in harm.judge.loads())
    harm.master.close()


def test_a_drive_that_is_left_energised_is_seen_but_a_loaded_one_may_hold_itself() -> None:
    harm = Harm(case(**LOADED), mode=8)
    harm.master.write(1, 0x605A, 0, "h", 6)
    harm.master.enable()
    assert [c.split()[0] for c in harm.judge.states()] == ["A1", "A2", "A3"]
    for _ in range(100):
        harm.master.cycle([0, 0, 0], 0x02, 0.004)
    assert harm.cell.drives[0].state.name == "QUICK_STOP_ACTIVE"
    assert harm.judge.states() == []
    harm.master.close()


@pytest.mark.parametrize(
    ("index", "sub", "code", "value", "wider"),
    [
        (0x6072, 0, "H", 500, True), (0x6072, 0, "H", 200, False),
        (0x607D, 1, "i", -2000, True), (0x607D, 1, "i", -500, False), (0x607D, 2, "i", 2000, True),
        (0x607F, 0, "I", 0xFFFFFFFF, True), (0x6065, 0, "I", 999, False), (0x6066, 0, "H", 200, True),
        (0x1016, 1, "I", 0x7F0200, True), (0x1016, 1, "I", 0x7F0010, False), (0x1016, 1, "I", 0, True),
        (0x605A, 0, "h", 6, False),
    ],
)  # fmt: skip
def test_a_write_that_permits_more_than_was_found_is_seen(
    index: int, sub: int, code: str, value: int, wider: bool
) -> None:
    values = {
        "0x6072": 300, "0x607D:1": -1000, "0x607D:2": 1000, "0x607F": 9999, "0x6065": 1000, "0x6066": 100,
        "0x1016:1": 0x7F0064,
    }  # fmt: skip
    harm = Harm(case(objects={"values": values}))
    with writes(harm.cell) as written:
        assert harm.master.write(1, index, sub, code, value) == 0
    assert bool(harm.judge.settings(written)) is wider
    harm.master.close()


def test_a_product_without_its_way_out_is_convicted_whatever_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Cia402Cell, "stop", lambda self: None)
    monkeypatch.setattr(Cia402Cell, "close", lambda self: [])
    monkeypatch.setattr("invid_drivers.cia402.axis.Drive.protect", lambda self, *a, **k: None)
    outcome = run_one("emcy", np.random.default_rng(1), tmp_path)
    assert any("ended in OPERATION_ENABLED" in c for c in outcome.complaints)
