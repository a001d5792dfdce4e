"""Fail where a package has more statements than house.toml allows; ``--lower`` writes what it has less.

A statement is one of Python's own, docstrings apart: width of lines and comments do not change it.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

TABLE = "house.toml"


def package_of(path: str) -> str:
    """Folder that a file counts for: of ``invid`` each of its own, else the one at the top."""
    folders = PurePosixPath(path).parts[:-1]
    return "/".join(folders[:2] if folders[:1] == ("invid",) else folders[:1])


def statements_of(source: str) -> int:
    """Number of statements, docstrings apart."""
    nodes = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.stmt)]
    texts = [n for n in nodes if isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant)]
    return len(nodes) - sum(isinstance(t.value.value, str) for t in texts)


def statements_by_package(root: Path) -> Counter[str]:
    """Statements of each package, over all files that git knows."""
    tracked = ["git", "-C", str(root), "ls-files", "--cached", "--others", "--exclude-standard", "*.py"]
    counted: Counter[str] = Counter()
    for path in subprocess.run(tracked, capture_output=True, text=True, check=True).stdout.splitlines():
        if (file := root / path).exists():
            counted[package_of(path)] += statements_of(file.read_text(encoding="utf-8"))
    return counted


def lowered(text: str, less: Mapping[str, int]) -> str:
    """The table with what packages have less; a package that is gone has no line."""
    for name, now in less.items():
        text = re.sub(rf'(?m)^"{name}" = \d+\n', f'"{name}" = {now}\n' if now else "", text)
    return text


def main(root: Path, *, lower: bool) -> int:
    table = root / TABLE
    text = table.read_text(encoding="utf-8")
    now, allowed = statements_by_package(root), tomllib.loads(text)["statements"]
    above = [name for name in sorted(now) if now[name] > allowed.get(name, 0)]
    less = {name: now[name] for name in allowed if now[name] < allowed[name]}
    for name in above:
        print(
            f"{TABLE}: {name} has {now[name]} statements, {allowed.get(name, 0)} are allowed: take away "
            "as many, or raise the number and give the reason in a line of CHANGELOG.md"
        )
    if lower:
        table.write_text(lowered(text, less), encoding="utf-8")
    elif less:
        print(f"{TABLE}: less in {', '.join(less)}; python {sys.argv[0]} --lower writes it down")
    return 1 if above else 0


if __name__ == "__main__":
    sys.exit(main(Path(__file__).resolve().parents[1], lower="--lower" in sys.argv[1:]))
