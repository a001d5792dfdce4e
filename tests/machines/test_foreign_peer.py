"""The foreign drive does what CiA 402 says, its plant what Newton says; the judge sees what is done wrong."""

import json
import struct
from pathlib import Path
from typing import Any

import pytest

from tests.machines.foreign.cell import Cell
from tests.machines.foreign.draft import ALWAYS, Draft, Timeline, draw_cell
from tests.machines.foreign.judge import Verdict, judge
from tests.machines.foreign.world import World

KNOWN = Timeline({}, [], [0.0, 0.0], 0)


class Master:
    """Frames by hand: one drive, PDO 1 with controlword and target torque, position mode at rest."""

    def __init__(self, folder: Path, **axis: Any) -> None:
        self.draft: Draft = draw_cell("ordinary", ALWAYS, 1, 0, brakes=False)
        for name, value in {"stated": True, **axis}.items():
            setattr(self.draft.axes[0], name, value)
        self.draft.victims = list(self.draft.axes)
        self.cell = Cell(folder, self.draft.spec(), self.draft.config())
        self.world = World(self.draft.spec(), folder)
        self.axis = self.world.axes[0]

    def wait(self, seconds: float) -> None:
        self.world.advance(self.world.now + seconds)

    def write(self, index: int, value: int, size: int, sub: int = 0) -> int:
        """Abort code of an expedited download; 0: taken."""
        data = value.to_bytes(size, "little", signed=value < 0).ljust(4, b"\0")
        self.world.inbox.clear()
        self.world.from_master(0x601, struct.pack("<BHB", 0x23 | 4 - size << 2, index, sub) + data)
        self.wait(0.005)
        answer = next(d for _, cob, d in self.world.inbox if cob == 0x581)
        return 0 if answer[0] == 0x60 else int(struct.unpack_from("<I", answer, 4)[0])

    def control(self, *words: int) -> str:
        for word in words:
            assert self.write(0x6040, word, 2) == 0
            self.wait(0.05)
        return self.axis.state

    def enable(self) -> None:
        self.world.from_master(0, b"\x01\x01")
        assert self.write(0x6060, 8, 1) == 0
        assert self.control(6, 7, 15) == "enabled"
        self.wait(1.0)

    def end(self, *, status: int = 0, said: str = "", **document: Any) -> Verdict:
        """The command is over: its verdict."""
        self.world.finish()
        run = self.cell._run(status, json.dumps({"outcome": "completed", **document}), said, 0.0)
        return judge(self.draft, run, KNOWN)


def test_states_follow_the_figure_of_the_standard(tmp_path: Path) -> None:
    master = Master(tmp_path)
    assert [master.control(w) for w in (15, 6, 7)] == ["off", "ready", "on"]
    assert master.write(0x6060, 8, 1) == 0
    assert [master.control(w) for w in (15, 2)] == ["enabled", "off"]  # quick stop by 0x605A = 2 ends in off
    assert master.write(0x605A, 6, 2) == 0
    assert [master.control(w) for w in (6, 15, 15, 2, 7)] == [
        "ready",
        "on",
        "enabled",
        "stopping",
        "stopping",
    ]
    assert [master.control(w) for w in (15, 7, 6, 0)] == ["enabled", "on", "ready", "off"]
    master.axis.fault(0x2310)
    assert [master.control(w) for w in (6, 0x80, 6)] == ["fault", "off", "ready"]


def test_a_map_is_changed_while_its_pdo_is_off_only(tmp_path: Path) -> None:
    master = Master(tmp_path)
    assert master.write(0x1A00, 0x60640020, 4, 1) == 0x06010000
    assert master.write(0x1800, 0x80000181, 4, 1) == 0
    assert master.write(0x1A00, 0x60640020, 4, 1) == 0
    assert master.write(0x1A00, 0x12340020, 4, 2) == 0x06040041


@pytest.mark.parametrize(("brake", "seconds"), [(None, 0.3), (0.1, 0.1)])
def test_a_load_falls_as_gravity_has_it_until_its_brake_has_closed(
    tmp_path: Path, brake: float | None, seconds: float
) -> None:
    master = Master(tmp_path, load=4.0, brake=brake, plant={"coulomb": 0.0, "viscous": 0.0})
    master.enable()
    before = master.axis.plant.q
    master.axis.enter("off", "test")
    master.wait(seconds)
    assert before - master.axis.plant.q == pytest.approx(0.5 * 4.0 * seconds**2, rel=0.02)


def test_a_load_that_is_held_and_said_to_be_is_no_violation(tmp_path: Path) -> None:
    master = Master(tmp_path)
    master.enable()
    assert master.write(0x605A, 6, 2) == 0
    master.control(2)
    verdict = master.end(energised=["A1"], warnings=["axis A1 is energised: it is held by its drive"])
    assert verdict.word == "OK", verdict.bad


def test_what_is_done_and_said_wrong_is_seen(tmp_path: Path) -> None:
    dropped = Master(tmp_path / "dropped")
    dropped.enable()
    dropped.control(0)
    bad = " ".join(dropped.end(warnings=["axis A1: its drive holds it"]).bad)
    assert "falls" in bad
    assert "said to be held by its drive, moves" in bad
    left = Master(tmp_path / "left")
    left.enable()
    assert any("left enabled" in b for b in left.end().bad)
    strong = Master(tmp_path / "strong", torque_limit=3.0)
    strong.enable()
    strong.axis.enter("off", "test")
    assert any("limit 3" in b for b in strong.end(said="A1 is not held").bad)
    foreign = Master(tmp_path / "foreign")
    foreign.world.from_master(0, b"\x01\x00")
    assert any("foreign node" in b for b in foreign.end().bad)
    late = Master(tmp_path / "late")
    late.wait(0.1)
    assert any("late" in b for b in late.end(status=4, said="the computer was late for 9 slots").bad)
    refused = Master(tmp_path / "refused")
    refused.draft.healthy = True
    refused.wait(0.1)
    assert refused.end(status=5, outcome="").word == "REFUSED"
