"""The quickstart and the README's demo, word for word, by a reader with a reader's budget."""

import re
from pathlib import Path

import pytest
from pages import ROOT, run_page

from invid.cli.app import run

pytestmark = [pytest.mark.campaign, pytest.mark.xdist_group("quickstart")]
QUICKSTART = ROOT / "docs" / "quickstart.md"
_NUMBER = re.compile(r"\d+(?:\.\d+)?")


@pytest.fixture(scope="module")
def where(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("quickstart")
    for ran in run_page(QUICKSTART, folder):
        assert set(ran.statuses) == {0}, ran.step.commands
    return folder


def test_every_step_of_the_quickstart_leaves_its_file(where: Path) -> None:
    named = re.findall(r"(?:-o|--report) (\S+)", QUICKSTART.read_text(encoding="utf-8"))
    assert len(named) >= 6
    for name in named:
        assert (where / name).stat().st_size > 0


def test_the_python_of_the_quickstart_goes_on_from_there(
    where: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (block,) = re.findall(r"```python\n(.*?)```", QUICKSTART.read_text(encoding="utf-8"), re.S)
    monkeypatch.chdir(where)
    exec(compile(block, str(QUICKSTART), "exec"), {})
    assert capsys.readouterr().out.splitlines()[0] == "explained"
    assert (where / "extended.json").stat().st_size > 0


def test_the_demo_prints_what_the_readme_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = re.findall(r"<!-- demo output.*?-->\n```\n(.*?)```", text, re.S)[0].splitlines()
    monkeypatch.chdir(tmp_path)
    assert run(["demo"]) == 0
    printed = {_NUMBER.sub("#", " ".join(line.split())) for line in capsys.readouterr().out.splitlines()}
    for line in shown:
        words = _NUMBER.sub("#", " ".join(line.split()))
        assert not words or words == "…" or words in printed, line
