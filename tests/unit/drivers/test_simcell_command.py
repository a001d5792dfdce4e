"""``invid simcell``: what it says when it cannot run."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from invid.cli.app import run
from invid_drivers.simulated import CASE_STUDY


def written(tmp_path: Path, **changes: Any) -> str:
    data = yaml.safe_load(CASE_STUDY.read_text(encoding="utf-8"))
    data["bus"].update(interface="invid-unix", channel=str(tmp_path / "cell.sock"))
    for key, value in changes.items():
        if value is None:
            del data[key]
        else:
            data[key].update(value)
    path = tmp_path / "cell.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(
    ("changes", "status", "words"),
    [
        ({"simulation": None}, 2, "no section 'simulation'"),
        ({"bus": {"interface": "invid-virtual"}}, 2, "no real time"),
        ({"simulation": {"sede": 3}}, 2, "sede"),
        ({"bus": {"interface": "socketcan", "channel": "nocan7"}}, 5, "cannot be opened"),
        ({"bus": {"channel": "/nowhere/cell.sock"}}, 5, "cannot listen"),
    ],
)
def test_a_config_that_cannot_run_is_one_message_and_a_status(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, Any], status: int, words: str
) -> None:
    assert run(["simcell", written(tmp_path, **changes), "--duration", "1"]) == status
    shown = capsys.readouterr()
    assert shown.out == ""
    assert words in shown.err
    assert "Traceback" not in shown.err
    assert not (tmp_path / "cell.sock").exists()
