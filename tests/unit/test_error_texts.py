"""No program reads an error's text: what is decided is decided by its type and its typed members."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import invid
import invid_drivers
import invid_service

PACKAGES = [Path(str(p.__file__)).parent for p in (invid, invid_drivers, invid_service)]
FILES = [f for package in PACKAGES for f in sorted(package.rglob("*.py"))]
LOOKS = {"startswith", "endswith", "find", "rfind", "index", "rindex", "count", "partition", "rpartition"}
"""Methods of a text by which a program decides; cutting one to length for a person is none."""


def _is_text(node: ast.AST, errors: set[str], texts: set[str]) -> bool:
    """Whether a node is the text of an error: ``str(error)``, ``error.reason``, a name of it."""
    match node:
        case ast.Name(id=name):
            return name in texts
        case ast.Call(func=ast.Name(id="str" | "repr"), args=[ast.Name(id=name)]):
            return name in errors
        case ast.Attribute(value=ast.Name(id=name), attr="args" | "reason" | "way_out" | "said" | "left"):
            return name in errors
        case ast.Subscript(value=value):
            return _is_text(value, errors, texts)
        case ast.Call(func=ast.Attribute(value=value, attr="lower" | "strip" | "split" | "splitlines")):
            return _is_text(value, errors, texts)
    return False


def _errors(function: ast.AST) -> set[str]:
    """Names of errors: caught ones, and parameters that are annotated as such."""
    names = {n.name for n in ast.walk(function) if isinstance(n, ast.ExceptHandler) and n.name}
    for n in ast.walk(function):
        if isinstance(n, ast.arg) and n.annotation is not None:
            said = ast.unparse(n.annotation)
            names |= {n.arg} if said.split(" ")[0].endswith(("Error", "Exception", "SafetyStop")) else set()
    return names


def decisions(source: str) -> Iterator[int]:
    """Lines at which a program decides by an error's text."""
    tree = ast.parse(source)
    errors = _errors(tree)
    texts: set[str] = set()
    for n in ast.walk(tree):
        if isinstance(n, ast.Assign) and _is_text(n.value, errors, set()):
            texts |= {t.id for t in n.targets if isinstance(t, ast.Name)}
    for n in ast.walk(tree):
        match n:
            case ast.Compare(left=left, comparators=others, ops=ops):
                sides = [left, *others]
                by_type = all(isinstance(o, ast.Is | ast.IsNot) for o in ops)
                if not by_type and any(_is_text(s, errors, texts) for s in sides):
                    yield n.lineno
            case ast.Call(func=ast.Attribute(value=ast.Name(id="re")), args=args):
                if any(_is_text(a, errors, texts) for a in args):
                    yield n.lineno
            case ast.Call(func=ast.Attribute(value=value, attr=method)) if method in LOOKS:
                if _is_text(value, errors, texts):
                    yield n.lineno


@pytest.mark.parametrize(
    "line",
    [
        "found = 'late' in str(error)", "found = re.search('A1', str(error))", "found = error.args[0] == 'x'",
        "found = str(error).endswith('.')", "text = str(error)\n    found = 'late' in text",
        "found = error.reason.partition(';')[0]",
    ],
)  # fmt: skip
def test_the_scan_sees_what_it_is_for(line: str) -> None:
    assert list(decisions(f"try:\n    pass\nexcept OSError as error:\n    {line}\n"))


def test_no_program_decides_by_the_text_of_an_error() -> None:
    found = [f"{file}:{line}" for file in FILES for line in decisions(file.read_text(encoding="utf-8"))]
    assert found == []


def test_an_error_that_names_an_axis_carries_it() -> None:
    """Whoever remembers at which axes a run ended has nothing else to go by."""
    missing = []
    for file in FILES:
        for n in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            match n:
                case ast.Call(
                    func=ast.Name(id="SafetyStop" | "DriveError" | "BusError"),
                    args=[ast.JoinedStr(values=[ast.Constant(value=str(text)), ast.FormattedValue(), *_])],
                    keywords=keywords,
                ) if text == "axis ":
                    if not {k.arg for k in keywords} & {"axis", "axes"}:
                        missing.append(f"{file}:{n.lineno}")
    assert missing == []
