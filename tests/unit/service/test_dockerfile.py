"""The Dockerfile and the script that runs its steps stay in step with each other and with the project.

The script itself downloads everything anew, so it is run by hand (``python scripts/run-dockerfile.py``).
"""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

ROOT = Path(__file__).parents[3]
SBOM = runpy.run_path(str(ROOT / "scripts" / "bill-of-materials.py"))
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "run-dockerfile.py"))
STEPS = list(SCRIPT["steps"]((ROOT / "Dockerfile").read_text(encoding="utf-8")))


def of(word: str) -> list[str]:
    return [s.rest for s in STEPS if s.word == word]


def test_the_script_knows_every_instruction_of_the_dockerfile() -> None:
    assert {s.word for s in STEPS} <= SCRIPT["KNOWN"]


def test_the_image_is_built_in_two_stages_and_does_not_run_as_root() -> None:
    assert len(of("FROM")) == 2
    words = [s.word for s in STEPS]
    assert words.index("USER") < words.index("ENTRYPOINT")
    assert of("USER") == ["invid"]
    assert len(of("HEALTHCHECK")) == 1


def test_everything_that_is_copied_exists() -> None:
    for copy in of("COPY"):
        if not copy.startswith("--from"):
            for source in copy.split()[:-1]:
                assert (ROOT / source).exists(), source


def test_every_source_root_of_the_wheel_is_in_the_image() -> None:
    copied = {source for copy in of("COPY") for source in copy.split()[:-1]}
    assert {"invid", "drivers", "service", "pyproject.toml", "requirements.lock"} <= copied


def test_nothing_is_fetched_once_the_build_stage_is_over() -> None:
    second = STEPS[[i for i, s in enumerate(STEPS) if s.word == "FROM"][1] :]
    for step in second:
        assert not any(w in step.rest for w in ("pip", "apt", "curl", "wget", "http://", "npm")) or (
            step.word == "HEALTHCHECK" and "127.0.0.1" in step.rest
        ), step


def test_the_command_of_the_image_is_one_that_serve_takes() -> None:
    import typer
    from typer.testing import CliRunner

    from invid_service.cli import register

    app = typer.Typer()
    app.callback()(lambda: None)
    register(app)
    shown = CliRunner().invoke(app, ["serve", "--help"], env={"COLUMNS": "200", "NO_COLOR": "1"}).output
    command = json.loads(of("CMD")[0])
    assert command[0] == "serve"
    for option in (part for part in command if part.startswith("--")):
        assert option in shown


def test_the_image_installs_the_pinned_versions_and_no_tool_of_the_developers() -> None:
    (install,) = (command for command in of("RUN") if "pip install" in command)
    assert "-c requirements.lock" in install
    (extras,) = re.findall(r'"\.(\[.+\])"', install)
    assert SBOM["IMAGE"] == f"invid{extras}"
