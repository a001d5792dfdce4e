"""Run the Dockerfile's own steps in a clean folder, without a Docker engine.

Reads the file itself, so that there is nothing to keep in step: COPY copies into a root of its own, RUN
runs with its paths put under that root, HEALTHCHECK and CMD are run at the end. What cannot be had
without an engine (another user, another base system) is said and left out.

    python scripts/run-dockerfile.py FOLDER      (downloads what requirements.lock pins)
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
KNOWN = {
    "FROM",
    "WORKDIR",
    "COPY",
    "RUN",
    "USER",
    "VOLUME",
    "ENV",
    "EXPOSE",
    "HEALTHCHECK",
    "STOPSIGNAL",
    "ENTRYPOINT",
    "CMD",
}


@dataclass(frozen=True)
class Step:
    """One instruction."""

    word: str
    rest: str


def steps(text: str) -> Iterator[Step]:
    """Instructions in order, continued lines joined, comments left out."""
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    for line in re.sub(r"\\\n\s*", " ", "\n".join(lines)).splitlines():
        if line.strip():
            word, _, rest = line.strip().partition(" ")
            if word not in KNOWN:
                raise SystemExit(f"Dockerfile: {word} is not known to this script; teach it")
            yield Step(word, rest.strip())


def under(root: Path, text: str) -> str:
    """The command with the container's absolute folders put under ``root``."""
    return re.sub(r"(?<![\w./])/(opt/invid|src|data)\b", lambda m: f"{root}/{m.group(1)}", text)


def run(folder: Path) -> int:
    """All steps, then serve, check health, stop; the exit status."""
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    where, environment = folder, dict(os.environ)
    entry: list[str] = []
    health: list[str] = []
    for step in steps(text):
        print(f"{step.word} {step.rest}", file=sys.stderr, flush=True)
        if step.word == "WORKDIR":
            where = Path(under(folder, step.rest))
            where.mkdir(parents=True, exist_ok=True)
        elif step.word == "COPY" and not step.rest.startswith("--from"):
            *sources, target = shlex.split(step.rest)
            for source in sources:
                there = where / target / (source if target == "./" else "")
                here = ROOT / source
                if here.is_dir():
                    shutil.copytree(
                        here, there, ignore=shutil.ignore_patterns("__pycache__"), dirs_exist_ok=True
                    )
                else:
                    shutil.copy(here, there)
        elif step.word == "RUN" and step.rest.startswith("useradd"):
            (folder / "data").mkdir(exist_ok=True)
            print("  left out: another user needs an engine", file=sys.stderr)
        elif step.word == "RUN":
            command = under(folder, step.rest).replace("python -m venv", f"{sys.executable} -m venv", 1)
            subprocess.run(command, shell=True, cwd=where, check=True, env=environment)
        elif step.word == "ENV":
            for name, value in re.findall(r"(\w+)=(\S+)", step.rest):
                environment[name] = under(folder, value).replace("$PATH", os.environ["PATH"])
        elif step.word == "HEALTHCHECK":
            health = json.loads(step.rest.partition("CMD ")[2])
        elif step.word in ("ENTRYPOINT", "CMD"):
            entry += [under(folder, part) for part in json.loads(step.rest)]
    shutil.rmtree(folder / "src")  # the second stage has no sources
    return serve(entry, health, environment, folder / "data")


def serve(entry: list[str], health: list[str], environment: dict[str, str], data: Path) -> int:
    """Start what the container would start, wait for its health check, stop it as Docker does."""
    program = shutil.which(entry[0], path=environment["PATH"])
    process = subprocess.Popen([str(program), *entry[1:]], env=environment, cwd=data)
    try:
        for _ in range(60):
            time.sleep(1)
            if subprocess.run(health, env=environment, stderr=subprocess.DEVNULL).returncode == 0:
                print("healthy", file=sys.stderr)
                break
        else:
            print("never healthy", file=sys.stderr)
            return 1
        process.terminate()
        # uvicorn ends by the signal it was stopped with, once everything is shut down.
        status = process.wait(20)
        return 0 if status in (0, -signal.SIGTERM) else 1
    finally:
        if process.poll() is None:
            process.kill()


if __name__ == "__main__":
    target = Path(sys.argv[1]).resolve()
    target.mkdir(parents=True, exist_ok=True)
    sys.exit(run(target))
