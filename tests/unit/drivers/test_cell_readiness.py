"""A cell whose axes an earlier run left energised is not ready, in command and service alike."""

from dataclasses import replace
from pathlib import Path

import pytest

from invid.cli.app import run
from invid.config import CellConfig, load_config
from invid.errors import InvidError
from invid.wording.sentence import Sentence
from invid_drivers.cia402.journal import journal_path
from invid_drivers.cia402.standing.hold_memory import HoldMemory, Seen
from invid_drivers.cia402.standing.holding import energised_reason
from invid_drivers.cia402.states import DriveState
from invid_drivers.readiness import ask, not_ready
from invid_service.cells.readiness import Situation, readiness

CONFIG = Path(__file__).parents[3] / "configs" / "case-study-unix.yaml"
CASE_STUDY = CONFIG.with_name("case-study.yaml")


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CellConfig:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    config = load_config(CONFIG)
    bus = config.bus.model_copy(update={"channel": str(tmp_path / "nobody.sock")})
    return config.model_copy(update={"bus": bus})


def situation(config: CellConfig, mode: str = "full") -> Situation:
    return Situation(
        config=config,
        occupied_by=None,
        free_bytes=10**12,
        needed_bytes=0,
        store_answers=True,
        shutting_down=False,
        has_model=True,
        mode=mode,  # type: ignore[arg-type]
        drives=not_ready(config),
    )


def test_an_axis_that_was_left_held_is_said_and_taken_over_by_the_service_as_by_the_command(
    cell: CellConfig,
) -> None:
    memory = HoldMemory.beside(journal_path(cell.bus.interface, cell.bus.channel))
    memory.keep("drive of A2", Seen(2, loaded=True, holds=True, resumes=True, left_held=True))
    found = readiness(situation(cell))  # nobody answers on the bus: what is remembered counts
    assert found.can_start
    note, unasked = found.notes
    assert unasked.code == "drives_not_asked"
    assert not found.is_asked
    assert note.code == "axis_energised"
    assert "axis A2 (node 2) is energised" in note.text
    assert "takes it over without letting go" in note.text
    assert "support its load" in note.fix
    assert isinstance(note.text, Sentence)
    assert (note.text.values["axis"], note.text.values["node"]) == ("A2", "2")
    assert readiness(situation(cell, "simulate")).notes == []
    memory.keep("drive of A2", Seen(2, loaded=True, holds=True, resumes=True))
    assert [n.code for n in readiness(situation(cell)).notes] == ["drives_not_asked"]


def test_a_held_axis_whose_drive_does_not_go_back_to_operation_keeps_the_cell_from_starting(
    cell: CellConfig,
) -> None:
    memory = HoldMemory.beside(journal_path(cell.bus.interface, cell.bus.channel))
    memory.keep("drive of A2", Seen(2, loaded=True, holds=True, resumes=False, left_held=True))
    found = readiness(situation(cell))
    assert not found.can_start
    (reason,) = found.reasons
    assert reason.code == "axis_energised"
    assert "does not go back to operation" in reason.text
    assert found.notes == []


def test_who_is_refused_for_another_reason_hears_of_what_is_under_power(cell: CellConfig) -> None:
    memory = HoldMemory.beside(journal_path(cell.bus.interface, cell.bus.channel))
    memory.keep("drive of A2", Seen(2, loaded=True, holds=True, resumes=True, left_held=True))
    with pytest.raises(InvidError, match=r"axis A2 \(node 2\) is energised: .*To have it off, support"):
        ask(cell).require()


@pytest.mark.parametrize("state", [DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE])
def test_only_what_this_program_left_held_is_taken_over(cell: CellConfig, state: DriveState) -> None:
    found = energised_reason("A1", 1, state, None)
    ready = readiness(replace(situation(cell), drives=(found,)))
    assert ready.can_start == (state is DriveState.QUICK_STOP_ACTIVE)


def test_an_axis_at_which_a_run_ended_names_the_command_that_clears_it(cell: CellConfig) -> None:
    memory = HoldMemory.beside(journal_path(cell.bus.interface, cell.bus.channel))
    memory.keep("drive of A3", Seen(3, loaded=True, suspect="axis A3: the encoder is stuck"))
    (reason,) = readiness(situation(cell)).reasons
    assert reason.code == "axis_suspect"
    assert "encoder is stuck" in reason.text
    assert "invid check --cleared A3" in reason.fix


def test_with_a_memory_that_cannot_be_read_every_axis_waits_for_a_person(tmp_path: Path) -> None:
    path = tmp_path / "holds.json"
    for text in ("", "[]", '{"x": 1}', '{"x": {"nobody": 1}}', "\x00"):
        path.write_text(text, encoding="utf-8")
        memory = HoldMemory(path)
        for node in (1, 2):
            seen = memory.of("drive", node)
            assert "cannot be read" in seen.suspect
            assert seen.holds is None
        memory.clear(1)
        again = HoldMemory(path)
        assert again.of("drive", 1).suspect == ""
        assert "cannot be read" in again.of("drive", 2).suspect


@pytest.mark.parametrize(("limit", "said"), [(200.0, True), (500.0, True), (150.0, False)])
def test_a_torque_limit_that_no_drive_gives_is_said_beside_ready(
    limit: float, said: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A1 is rated 50 N·m and gives three times that (0x6072)."""
    text = CASE_STUDY.read_text(encoding="utf-8").replace("torque_Nm: 25", f"torque_Nm: {limit:g}")
    (tmp_path / "cell.yaml").write_text(text, encoding="utf-8")
    assert run(["check", str(tmp_path / "cell.yaml")]) == 0
    printed = capsys.readouterr().out
    assert ("; the torque limit of A1 is beyond what its drive gives" in printed.splitlines()[0]) == said
    assert (f"limited to 150 N·m, not to the config's {limit:g}" in printed) == said
    assert ("correct the config's limit, or its unit" in printed) == said
