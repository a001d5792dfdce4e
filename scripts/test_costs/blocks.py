"""Which blocks of the product run, at a few nanoseconds a block.

coverage.py halves the speed of the cycle's loops on Python 3.11, and tests in real time then fail. Here an
import hook writes ``__ran__[line] = 1`` at the beginning of every block (function, branch, loop, handler)
of the product; the array is a file that all processes share, so that subprocesses count, killed ones too.
"""

from __future__ import annotations

import ast
import builtins
import importlib.machinery
import importlib.util
import marshal
import mmap
import os
import sys
from collections.abc import Iterator, Sequence
from hashlib import sha256
from importlib.abc import MetaPathFinder
from pathlib import Path
from types import CodeType, ModuleType

ROOT = Path(__file__).resolve().parents[2]
PRODUCT = ("invid", "drivers/invid_drivers", "service/invid_service")
COMPILED = {"compiled", "inlined"}
"""Decorators of functions that numba compiles: they have no blocks."""


def product_lines() -> dict[str, int]:
    """Return the place of each file's first line in the shared array, and "" for the size of it."""
    places, total = {}, 0
    for folder in PRODUCT:
        for path in sorted((ROOT / folder).rglob("*.py")):
            places[str(path)] = total
            total += len(path.read_bytes().splitlines()) + 1
    return {**places, "": total}


class Marked(ast.NodeTransformer):
    """Puts the mark at the beginning of every block."""

    def __init__(self, first: int) -> None:
        self.first = first

    def _mark(self, block: list[ast.stmt]) -> list[ast.stmt]:
        if not block:
            return block
        (mark,) = ast.parse(f"__ran__[{self.first + block[0].lineno}] = 1").body
        for node in ast.walk(mark):
            ast.copy_location(node, block[0])
        return [mark, *block]

    def generic_visit(self, node: ast.AST) -> ast.AST:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            names = {d.id for d in node.decorator_list if isinstance(d, ast.Name)}
            if names & COMPILED:
                return node
            told = 1 if ast.get_docstring(node) is not None else 0
            super().generic_visit(node)
            node.body = node.body[:told] + self._mark(node.body[told:])
            return node
        super().generic_visit(node)
        if not isinstance(node, ast.Module | ast.ClassDef):
            for field in ("body", "orelse", "finalbody"):
                block = getattr(node, field, None)
                if isinstance(block, list):
                    setattr(node, field, self._mark(block))
        return node


class Loader(importlib.machinery.SourceFileLoader):
    """Loads a module of the product with its marks."""

    ran: mmap.mmap
    lines: dict[str, int]
    kept: Path

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        source = self.get_data(path)
        kept = self.kept / sha256(path.encode() + source).hexdigest()
        if kept.exists():
            return marshal.loads(kept.read_bytes())
        tree = Marked(self.lines[path]).visit(ast.parse(source, path))
        code = compile(tree, path, "exec", dont_inherit=True)
        part = kept.with_suffix(f".{os.getpid()}")
        part.write_bytes(marshal.dumps(code))
        part.replace(kept)
        return code


class Finder(MetaPathFinder):
    """Hands modules of the product to ``Loader``."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if name.partition(".")[0] not in ("invid", "invid_drivers", "invid_service"):
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is None or spec.origin not in Loader.lines:
            return spec
        return importlib.util.spec_from_file_location(
            name,
            spec.origin,
            loader=Loader(name, spec.origin),
            submodule_search_locations=spec.submodule_search_locations,
        )


def install(array: Path) -> mmap.mmap:
    """Load the product with marks from now on; returns the shared array."""
    lines = product_lines()
    if not array.exists():
        array.write_bytes(bytes(lines[""]))
    with array.open("r+b") as file:
        Loader.ran = mmap.mmap(file.fileno(), lines[""])
    vars(builtins)["__ran__"] = Loader.ran  # seen by a module that is run as a program, too
    Loader.lines, Loader.kept = lines, array.parent / "marked"
    Loader.kept.mkdir(exist_ok=True)
    sys.meta_path.insert(0, Finder())
    return Loader.ran


def blocks_of_product() -> Iterator[tuple[str, int]]:
    """Yield file and line of every block."""
    for path, first in product_lines().items():
        if path:
            tree = Marked(0).visit(ast.parse(Path(path).read_text(encoding="utf-8")))
            for node in ast.walk(tree):
                if isinstance(node, ast.Subscript) and getattr(node.value, "id", "") == "__ran__":
                    yield path, first + node.lineno
