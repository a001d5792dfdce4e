"""What is remembered of a bus cannot be turned aside, or made up, by another user of the computer."""

import json
import os
from pathlib import Path

import pytest
import yaml

from invid.config import CellConfig, parse_config
from invid.errors import BusError
from invid_drivers.cia402 import state_folder
from invid_drivers.cia402.journal import Entry, Journal, journal_path
from invid_drivers.cia402.standing.hold_memory import HoldMemory, Seen
from invid_drivers.connect import connect

CONFIG = Path(__file__).parents[2] / "configs" / "case-study-unix.yaml"
PLANTED = b'{"node_id": 1, "serial": 0, "index": 24698, "sub": 0, "before": "ffff", "wrote": "e803"}\n'
SOMEBODY = 65534


@pytest.fixture
def bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CellConfig:
    """A bus on which nobody answers, on a computer whose users each have a folder below ``tmp_path``."""
    monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    monkeypatch.setattr(state_folder, "SERVICES", tmp_path / "service")
    monkeypatch.setattr(state_folder, "EVERYBODYS", tmp_path)
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    data["bus"]["channel"] = str(tmp_path / "nobody.sock")
    return parse_config(yaml.safe_dump(data))


def give_away(monkeypatch: pytest.MonkeyPatch, *paths: Path) -> None:
    """Make these another user's; who is not root becomes another user himself."""
    if os.geteuid() == 0:
        for path in paths:
            os.chown(path, SOMEBODY, SOMEBODY, follow_symlinks=False)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: SOMEBODY)


def path_of(bus: CellConfig) -> Path:
    path = journal_path(bus.bus.interface, bus.bus.channel)
    path.parent.mkdir(mode=0o755)
    return path


def test_a_link_planted_for_a_temporary_file_leads_nowhere(tmp_path: Path) -> None:
    target = tmp_path / "target"
    target.write_text("precious", encoding="utf-8")
    for part in ("bus.part", "bus.journal.part", "bus.holds.part", "bus.holds.json.part"):
        (tmp_path / part).symlink_to(target)
    journal = Journal(tmp_path / "bus.journal")
    for node in (1, 2):
        journal.add(Entry(node, 0, 0x6072, 0, "0000"))
    journal.keep(1, ())
    HoldMemory(tmp_path / "bus.holds.json").keep("a drive", Seen(1, loaded=True))
    assert target.read_text(encoding="utf-8") == "precious"
    assert HoldMemory(tmp_path / "bus.holds.json").of("a drive", 1).loaded


@pytest.mark.parametrize("name", ["bus.journal", "bus.holds.json"])
def test_a_link_in_the_place_of_what_is_remembered_is_not_followed(tmp_path: Path, name: str) -> None:
    (tmp_path / "elsewhere").write_bytes(PLANTED)
    (tmp_path / name).symlink_to(tmp_path / "elsewhere")
    if name == "bus.journal":
        with pytest.raises(BusError, match=r"it is a link.*remove it"):
            Journal(tmp_path / name)
    else:
        assert "it is a link" in HoldMemory(tmp_path / name).of("", 1).suspect
    assert (tmp_path / "elsewhere").read_bytes() == PLANTED


def test_a_journal_line_of_another_user_is_not_written_into_a_drive(
    bus: CellConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = path_of(bus)
    path.write_bytes(PLANTED)
    path.chmod(0o644)
    give_away(monkeypatch, path)
    with pytest.raises(BusError, match=r"belongs to user.*XDG_STATE_HOME"):
        Journal(path)


def test_a_journal_that_others_can_write_is_not_believed(tmp_path: Path) -> None:
    path = tmp_path / "bus.journal"
    path.write_bytes(PLANTED)
    path.chmod(0o666)
    with pytest.raises(BusError, match=r"others can write it.*chmod go-w"):
        Journal(path)
    path.chmod(0o644)
    assert len(Journal(path).entries) == 1


def test_a_folder_of_another_user_or_of_everybody_is_refused_before_the_bus_is_opened(
    bus: CellConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = path_of(bus).parent
    folder.chmod(0o777)
    with pytest.raises(BusError, match="can be written by everybody: chmod o-w"):
        connect(bus)
    folder.chmod(0o1777)
    with pytest.raises(BusError, match="cannot be opened"):  # sticky: its files are their owners'
        connect(bus)
    folder.chmod(0o755)
    if os.geteuid() == 0:
        give_away(monkeypatch, folder)
        with pytest.raises(BusError, match=r"its folder belongs to user.*XDG_STATE_HOME"):
            connect(bus)


def test_where_nothing_can_be_remembered_the_way_out_is_said_before_the_bus_is_opened(
    bus: CellConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    with pytest.raises(BusError, match=r"XDG_STATE_HOME.*in a container one on a volume"):
        connect(bus)


def test_what_another_users_run_left_in_the_drives_is_his_to_restore(bus: CellConfig, tmp_path: Path) -> None:
    theirs = tmp_path / "invid-4711" / path_of(bus).name
    theirs.parent.mkdir()
    theirs.write_bytes(PLANTED)
    with pytest.raises(BusError, match=r"invid-4711.*`invid check` as that user"):
        connect(bus)
    theirs.unlink()
    with pytest.raises(BusError, match="cannot be opened"):
        connect(bus)


def test_another_users_memory_warns_and_promises_nothing(bus: CellConfig, tmp_path: Path) -> None:
    path = path_of(bus).with_suffix(".holds.json")
    theirs = HoldMemory(tmp_path / "invid-4711" / path.name)
    theirs.keep("a drive", Seen(1, loaded=True, holds=True, resumes=True, suspect="the encoder is stuck"))
    mine = HoldMemory(path)
    seen = mine.of("a drive", 1)
    assert seen.loaded
    assert "the encoder is stuck (seen by user" in seen.suspect
    assert seen.holds is None
    assert seen.resumes is None
    mine.clear(1)
    assert HoldMemory(path).of("a drive", 1).suspect == ""
    assert json.loads(theirs.path.read_text())["a drive"]["suspect"]  # type: ignore[union-attr]
