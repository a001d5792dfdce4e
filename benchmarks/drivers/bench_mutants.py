"""Mutants of what keeps an axis from doing harm: which of them does no contract test notice?

    pip install cosmic-ray                  # development only, in no lock
    python benchmarks/drivers/bench_mutants.py [--sample 30] [--seed 0] [--results rows.jsonl]
    python benchmarks/drivers/bench_mutants.py FILE.py FILE.py[:test_a.py,test_b.py] …    # other modules

Cosmic Ray's operators make the mutants; of each module ``--sample`` are drawn. What mutates annotations
alone is no mutant. Each is tried in a fork of its own, which has what is heavy and not of the link loaded
already, by the module's contract tests until the first that fails; longer than ``LONGEST_S`` is a failure
too. Commands that tests start are mutated as well: they find the mutant by ``PYTHONPATH``.
``--results`` keeps each and goes on where it was interrupted.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import importlib
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
CIA402 = "drivers/invid_drivers/cia402"
MODULES = {
    "supervisor": (f"{CIA402}/supervisor.py", ("way_out", "mode_change", "holding", "foreign_kinds")),
    "supervised_axis": (f"{CIA402}/supervised_axis.py", ("way_out", "holding", "foreign_kinds")),
    "axis_state": (f"{CIA402}/axis_state.py", ("way_out", "holding", "foreign_kinds")),
    "procedures": (f"{CIA402}/procedures.py", ("holding", "way_out", "foreign_kinds")),
    "axis_estimator": ("invid/sweep/axis_estimator.py", ("axis_estimator", "foreign_kinds")),
    "unmoved": ("invid/sweep/stuck_encoder.py", ("stuck_encoder", "foreign_kinds")),
    "bounds": ("invid/sweep/bounds.py", ("sweep", "link_promises", "holding", "way_out")),
    "gate": (f"{CIA402}/gate.py", ("gate", "link_promises", "others", "holding")),
    "held_axes": (f"{CIA402}/standing/held_axes.py", ("holding", "link_promises", "way_out")),
}
"""File, and the tests that are asked, in this order."""
LONGEST_S = 900.0
KILLED, SURVIVED, LATE = "killed", "survived", "killed by time"


HOOK = '''
import importlib.abc, importlib.util, os, sys

class Mutated(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """One module from another source."""
    name, path, source = (os.environ[f"INVID_MUTANT_{k}"] for k in ("NAME", "PATH", "SOURCE"))

    def find_spec(self, name, path=None, target=None):
        return importlib.util.spec_from_loader(name, self, origin=self.path) if name == self.name else None

    def exec_module(self, module):
        exec(compile(open(self.source, encoding="utf-8").read(), self.path, "exec"), module.__dict__)

if "INVID_MUTANT_NAME" in os.environ:
    sys.meta_path.insert(0, Mutated())
'''
"""`sitecustomize.py` of a mutant's processes."""


def mutants(path: Path, rng: np.random.Generator) -> tuple[int, Iterator[tuple[str, int, str]]]:
    """How many places there are, and mutants in random order: operator, line and source of each."""
    from cosmic_ray import plugins
    from cosmic_ray.ast import ast_nodes, get_ast_from_path
    from cosmic_ray.mutating import mutate_code

    source = path.read_text(encoding="utf-8")
    nodes = list(ast_nodes(get_ast_from_path(path)))
    places = []
    for name in sorted(plugins.operator_names()):
        operator_class = plugins.get_operator(name)
        if not operator_class.arguments():
            found = [p for node in nodes for p in operator_class().mutation_positions(node)]
            places += [(name, k, line) for k, ((line, _), _) in enumerate(found)]

    def drawn() -> Iterator[tuple[str, int, str]]:
        seen = {None, _meaning(source)}
        for n in rng.permutation(len(places)):
            name, k, line = places[n]
            mutated = mutate_code(source.encode(), plugins.get_operator(name)(), k)
            text = mutated.decode() if isinstance(mutated, bytes) else str(mutated)
            meaning = _meaning(text)
            if meaning not in seen:
                seen.add(meaning)
                yield name.removeprefix("core/"), line, text

    return len(places), drawn()


def _meaning(source: str) -> str | None:
    """The code without annotations and docstrings; None where it is none."""
    try:
        tree = ast.parse(source)
    except SyntaxError:
        return None
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            node.returns = None
        elif isinstance(node, ast.arg):
            node.annotation = None
        elif isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(0)
    return ast.dump(tree)


def tried(name: str, source: str, path: Path, options: list[str]) -> str:
    """What the tests say of a mutant."""
    folder = tempfile.TemporaryDirectory()
    hook, mutant = Path(folder.name) / "hook", Path(folder.name) / "mutant.py"
    hook.mkdir()
    (hook / "sitecustomize.py").write_text(HOOK, encoding="utf-8")
    mutant.write_text(source, encoding="utf-8")
    child = os.fork()
    if child == 0:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
        os.setpgid(0, 0)
        status = 1
        with contextlib.suppress(BaseException):
            import pytest

            os.environ |= {"INVID_MUTANT_NAME": name, "INVID_MUTANT_PATH": str(path),
                           "INVID_MUTANT_SOURCE": str(mutant), "PYTHONPATH": str(hook)}  # fmt: skip
            exec(HOOK, {"__name__": "hook"})
            status = int(
                pytest.main(["-x", "-q", "-p", "no:cacheprovider", f"--basetemp={folder.name}/t", *options])
            )
        os._exit(status)
    with folder:
        return _waited(child)


def _waited(child: int) -> str:
    end = time.monotonic() + LONGEST_S
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return SURVIVED if os.waitstatus_to_exitcode(status) == 0 else KILLED
        time.sleep(0.05)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return LATE


def asked(module: str) -> tuple[str, tuple[str, tuple[str, ...]]]:
    """A row of the table by its name, or one of its own for a file."""
    if module in MODULES:
        return module, MODULES[module]
    file, _, tests = module.partition(":")
    if not (ROOT / file).exists():
        raise SystemExit(f"{file}: neither a file of the tree nor one of {', '.join(MODULES)}")
    names = tuple(t.removeprefix("test_").removesuffix(".py") for t in tests.split(",") if t)
    return Path(file).stem, (file, names or ("foreign_kinds",))


def main() -> int:
    """Draw, try, print a line a module and the survivors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sample", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("module", nargs="*", help="of the table, or a file of the tree[:its contract tests]")
    parser.add_argument("--results", type=Path)
    parser.add_argument("--marks", default="not campaign", help="which of the tests, as pytest's -m")
    options = parser.parse_args()
    os.chdir(ROOT)
    sys.path[:0] = [str(ROOT / "tests" / "contract"), str(ROOT / "tests")]
    for heavy in ("pytest", "scipy.signal", "pydantic", "h5py", "canopen", "numba", "invid.config"):
        importlib.import_module(heavy)
    kept = options.results
    rows = (
        [json.loads(x) for x in kept.read_text().splitlines()] if kept is not None and kept.exists() else []
    )
    chosen = dict(asked(m) for m in options.module) or MODULES
    for module, (file, names) in chosen.items():
        path = ROOT / file
        name = file.removeprefix("drivers/").removesuffix(".py").replace("/", ".")
        count, found = mutants(path, np.random.default_rng(options.seed))
        done = sum(r["module"] == module for r in rows)
        for operator, line, source in islice(found, done, options.sample):
            began = time.monotonic()
            tests = [str(p) for n in names for p in ROOT.glob(f"tests/*/**/test_{n}.py")]
            said = tried(name, source, path, ["-m", options.marks, *tests])
            was, now = path.read_text().splitlines(), source.splitlines()
            change = next(
                (f"{a.strip()} -> {b.strip()}" for a, b in zip(was, now, strict=False) if a != b), ""
            )
            rows.append({"module": module, "of": count, "line": line, "operator": operator, "said": said,
                         "change": change, "seconds": round(time.monotonic() - began, 1)})  # fmt: skip
            if kept is not None:
                with kept.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(rows[-1]) + "\n")
    print("| module | places | tried | killed |\n| --- | --- | --- | --- |")
    for module in chosen:
        own = [r for r in rows if r["module"] == module]
        if own:
            killed = sum(r["said"] != SURVIVED for r in own)
            print(f"| {module} | {own[0]['of']} | {len(own)} | {killed} ({killed / len(own):.0%}) |")
    for r in rows:
        if r["said"] == SURVIVED:
            print(f"{r['module']}:{r['line']} {r['operator']}: {r['change']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
