"""Before hardware moves somebody says that the stop is within reach; of a simulated cell nobody is asked."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from invid.config import CellConfig, load_config
from invid_drivers.cia402.standing.hold_memory import HoldMemory, Seen
from invid_drivers.cia402.standing.holding import to_support
from invid_drivers.cli.measure import confirm

ROOT = Path(__file__).parents[3]
INVID = [sys.executable, "-c", "from invid.cli import main; main()"]


def hardware(folder: Path) -> Path:
    """The case study on a bus that is not there, with no simulation behind it."""
    data = yaml.safe_load((ROOT / "configs" / "case-study-unix.yaml").read_text(encoding="utf-8"))
    del data["simulation"]
    data["bus"]["channel"] = str(folder / "nobody.sock")
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def measure(folder: Path, *options: str, typed: str | None = None) -> tuple[int, str]:
    """Exit status and stderr of a measurement; ``typed`` on a terminal, none without it."""
    command = [*INVID, "measure", str(hardware(folder)), "-o", str(folder / "run.h5"), *options]
    ours = theirs = None
    if typed is not None:
        ours, theirs = pty.openpty()
        os.write(ours, typed.encode())
    done = subprocess.run(
        command,
        stdin=subprocess.DEVNULL if theirs is None else theirs,
        capture_output=True,
        text=True,
        env={**os.environ, "XDG_STATE_HOME": str(folder / "state")},
        timeout=120,
    )
    for end in (ours, theirs):
        if end is not None:
            os.close(end)
    return done.returncode, done.stderr


@pytest.mark.campaign
def test_with_the_option_the_bus_is_opened_without_a_question(tmp_path: Path) -> None:
    code, said = measure(tmp_path, "--confirmed")
    assert code == 5
    assert "nobody listens" in said
    assert "emergency stop" not in said


@pytest.mark.parametrize(
    ("typed", "code", "words"),
    [
        pytest.param("yes\n", 5, "nobody listens", marks=pytest.mark.campaign),
        ("no\n", 2, "nothing moved"),
    ],
)
def test_on_a_terminal_the_answer_decides(tmp_path: Path, typed: str, code: int, words: str) -> None:
    found, said = measure(tmp_path, typed=typed)
    assert "Type yes" in said
    assert (found, words in said) == (code, True)


def test_a_cell_with_a_simulation_is_not_asked_about(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> str:
        raise AssertionError("was asked")

    monkeypatch.setattr("sys.stdin.isatty", never)
    cell = load_config(ROOT / "configs" / "case-study.yaml")
    confirm(cell, confirmed=False)
    bare = CellConfig.model_validate(cell.model_dump(exclude={"simulation"}, exclude_none=True))
    with pytest.raises(AssertionError, match="was asked"):
        confirm(bare, confirmed=False)


def test_whose_load_to_support_before_a_stop_test_is_said_until_the_test_was_passed(tmp_path: Path) -> None:
    path = hardware(tmp_path)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    del data["axes"][1]["gravity_loaded"]
    data["axes"][2]["gravity_loaded"] = True
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    cell = load_config(path)
    memory = HoldMemory(tmp_path / "holds.json")
    assert to_support(cell, memory) == ("A2", "A3")
    memory.keep("drive of A3", Seen(3, loaded=True, holds=True, resumes=True))
    assert to_support(cell, HoldMemory(tmp_path / "holds.json")) == ("A2",)
    memory.keep("another drive at node 3", Seen(3))
    assert to_support(cell, memory) == ("A2", "A3")
