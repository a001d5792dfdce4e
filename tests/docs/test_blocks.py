"""Every command and code block of the documentation is run, or at least parsed by what would run it.

Run elsewhere: ``sh`` blocks of the pages in RUN_ELSEWHERE, Python blocks of those in PYTHON_RUN_ELSEWHERE.
Run here: all other Python blocks, on results made for them. Parsed only: every ``invid …`` line of all pages,
by the product's own argument parser (running them would take robots or clusters); what else stands in shell
blocks, by ``bash -n``; YAML. Not checked: structured text, nginx and printed output.
"""

import re
import shlex
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest
import typer
import yaml
from pages import ROOT

import invid
from invid.cli.app import create_app
from invid.effects.registry import load_effects

RUN_ELSEWHERE = {
    "docs/how-to/rest.md": "tests/system/test_service_cookbook.py",
    "docs/tutorial/flexible-drive.md": "tests/docs/test_tutorial.py",
    "docs/tutorial/real-machines.md": "tests/docs/test_real_machines.py",
}
PYTHON_RUN_ELSEWHERE = {
    "docs/how-to/rest-languages.md": "tests/system/test_service_cookbook.py",
    "docs/reference/recording.md": "tests/docs/test_reference.py",
}
SHELL = re.compile(r"^(python3?|make|nice|bash|curl|ip|pip|cp|cat|git|openssl|docker|dask|useradd|install)\b")
_FENCED = re.compile(r"^```(\{?[\w-]*\}?)\n(.*?)^```$", re.M | re.S)
_INDENTED = re.compile(r"(?:^|\n\n)((?: {4,}[^\n]*\n?)+)")


@dataclass(frozen=True)
class Block:
    """A code block: the page, the language of its fence ("" for an indented one), its text."""

    page: str
    language: str
    text: str


def blocks() -> list[Block]:
    """All blocks of README, CONTRIBUTING and docs."""
    found = []
    for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))):
        text, page = path.read_text(encoding="utf-8"), path.relative_to(ROOT).as_posix()
        found += [Block(page, language, code) for language, code in _FENCED.findall(text)]
        found += [Block(page, "", code) for code in _INDENTED.findall(_FENCED.sub("", text))]
    return found


def commands() -> list[tuple[str, str]]:
    """Page and text of each line of a block that begins with ``invid`` and a command."""
    found = []
    for block in blocks():
        if block.language in ("sh", "text", "bash", ""):
            joined = block.text.replace("\\\n", " ")
            lines = (line.strip() for line in joined.splitlines())
            found += [(block.page, line) for line in lines if re.match(r"(\S*/)?invid [a-z]+( |$)", line)]
    return found


@cache
def parser() -> typer.main.TyperGroup:
    """The product's own parser with every command."""
    return typer.main.get_command(create_app())  # type: ignore[return-value]


@pytest.mark.parametrize(("page", "line"), commands(), ids=lambda v: v.replace("/", "."))
def test_every_command_of_the_docs_is_one_that_the_parser_takes(page: str, line: str) -> None:
    words = shlex.split(line.rstrip("&"), comments=True)[1:]
    words = words[: next((i for i, w in enumerate(words) if w in ("&&", "|", ">", ";")), len(words))]
    command, context = parser().commands[words[0]], None
    if hasattr(command, "commands"):
        command, words = command.commands[words[1]], words[1:]
    context = command.make_context(words[0], list(words[1:]))
    assert context.params or not command.params


def test_the_parser_refuses_an_option_that_is_none() -> None:
    with pytest.raises(Exception, match=r"(?i)no such option"):
        parser().commands["measure"].make_context("measure", ["cell.yaml", "--no-such-option"])


@pytest.mark.parametrize(
    "page", sorted({**RUN_ELSEWHERE, **PYTHON_RUN_ELSEWHERE}.items()), ids=lambda p: p[0]
)
def test_what_is_said_to_run_elsewhere_is_there(page: tuple[str, str]) -> None:
    assert Path(page[0]).name in (ROOT / page[1]).read_text(encoding="utf-8")


def test_shell_blocks_outside_those_that_are_run_are_at_least_shell() -> None:
    """Each ``sh`` block, and each indented or text block that begins with a known program."""
    rest = [b for b in blocks() if b.language in ("sh", "bash", "text", "") and b.page not in RUN_ELSEWHERE]
    shell = [b for b in rest if b.language in ("sh", "bash") or SHELL.match(b.text.lstrip())]
    assert len(shell) >= 8
    for block in shell:
        done = subprocess.run(["bash", "-n"], input=block.text, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{block.page}: {done.stderr}\n{block.text}"


@pytest.mark.parametrize(
    "block", [b for b in blocks() if b.language in ("yaml", "yml")], ids=lambda b: b.page
)
def test_yaml_blocks_are_yaml(block: Block) -> None:
    assert yaml.safe_load(block.text.replace("…", "0"))


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the Python blocks read: rec.h5, robot.mat, results/CELL/WEEK/model.json."""
    import sys

    sys.path.insert(0, str(ROOT / "tests"))
    from hidden.generator import make

    folder = tmp_path_factory.mktemp("blocks")
    recording, _ = make("viscous_friction", seed=0, target_db=25.0, motors=1)
    invid.write_recording(recording, folder / "rec.h5")
    model = invid.identify(recording)
    invid.export(model, "statespace", folder / "robot.mat")
    for cell in "AB":
        for week in range(4):
            path = folder / "results" / cell / f"week {week}" / "model.json"
            path.parent.mkdir(parents=True)
            model.save(path)
    return folder


PYTHON = [b for b in blocks() if b.language == "python" and b.page not in PYTHON_RUN_ELSEWHERE]


@pytest.mark.parametrize("block", PYTHON, ids=lambda b: f"{b.page}:{len(b.text)}")
def test_python_blocks_run(block: Block, results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(results)
    if block.page.endswith("add-an-effect.md"):
        path = results / "quadratic_drag.py"
        path.write_text(block.text, encoding="utf-8")
        assert [e.cause for e in load_effects(path)] == ["quadratic_drag"]
        return
    exec(compile(block.text, block.page, "exec"), {"__name__": "docs"})
