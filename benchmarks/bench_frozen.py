"""Frozen behaviour: the documents of several hundred recordings by one revision beside those by another.

    python benchmarks/bench_frozen.py run REVISION|FOLDER [-o RESULTS] [--cases 360] [--motors K]
    python benchmarks/bench_frozen.py compare RESULTS RESULTS
    python benchmarks/bench_frozen.py [--cases 40] [--motors 2]      the working tree against HEAD

Cases: hidden effects, the real records of ../shared/data and the
demo. Their recordings are made once, into a cache outside the repository (--cache); each revision then
identifies and diagnoses the same files with its own code, in a process of its own. A run that was broken off
goes on where it was; a case that fails, hangs (--timeout) or takes its process down is written down as that.

``compare`` prints every difference in exit status, verdict, cause, place, size and χ², and says which
documents are the same, but for what it names as left out. Exit status 0: no difference.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

from benchmarks.frozen.cases import ROOT, Case, cases, make
from benchmarks.frozen.compare import compare

CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "invid-frozen"


def recordings(chosen: list[Case], folder: Path) -> list[Path]:
    """Recordings of the cases; what is not in the cache is made."""
    folder.mkdir(parents=True, exist_ok=True)
    places = [folder / f"{case.name}.h5" for case in chosen]
    for case, place in zip(chosen, places, strict=True):
        if not place.exists():
            try:
                make(case, place)
            except Exception as error:
                print(f"recording {case.name}: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
    return [place for place in places if place.exists()]


def tree_of(revision: str, cache: Path) -> Path:
    """A folder as it is, or a revision checked out into the cache."""
    if Path(revision).is_dir():
        return Path(revision).resolve()
    git = ["git", "-C", str(ROOT)]
    name = [*git, "rev-parse", "--short=12", f"{revision}^{{commit}}"]
    sha = subprocess.run(name, capture_output=True, text=True, check=True).stdout.strip()
    tree = cache / "trees" / sha
    if not tree.exists():
        tree.mkdir(parents=True)
        archive = subprocess.run([*git, "archive", sha], stdout=subprocess.PIPE, check=True).stdout
        subprocess.run(["tar", "-x", "-C", str(tree)], input=archive, check=True)
    return tree


def run(revision: str, results: Path | None, options: argparse.Namespace) -> Path:
    """Documents of all cases by one revision; the folder they are in."""
    cache = Path(options.cache).resolve()
    made = recordings(cases(options.cases, options.motors), cache / "recordings")
    tree = tree_of(revision, cache)
    folder = (results or cache / "results" / tree.name).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    if results is None and Path(revision).is_dir():  # a working tree changes: what it gave is no more its own
        for stale in folder.glob("*/*.json"):
            stale.unlink()
    todo = [str(path) for path in made if not (folder / path.stem / "answer.json").exists()]
    paths = os.pathsep.join(str(tree / p) for p in (".", "drivers", "service"))
    subprocess.run(
        [sys.executable, f"{ROOT}/benchmarks/frozen/worker.py", str(tree), str(folder), str(options.timeout)],
        input="\n".join(todo), text=True, cwd=tree, check=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": paths},
    )  # fmt: skip
    return folder


def main() -> int:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("command", nargs="?", choices=("run", "compare"))
    parser.add_argument("what", nargs="*", help="a revision or folder to run; two results to compare")
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--cases", type=int, default=None, help="how many (360; 40 without a command)")
    parser.add_argument(
        "--motors", type=int, default=None, help="drawn cases with at most so many, no real ones"
    )
    parser.add_argument("--timeout", type=float, default=1800.0, help="seconds that one case may take")
    parser.add_argument("--cache", default=str(CACHE))
    options = parser.parse_args()
    options.cases = options.cases or (360 if options.command else 40)
    if options.command == "run" and len(options.what) == 1:
        print(run(options.what[0], options.output, options))
        return 0
    if options.command == "compare" and len(options.what) == 2:
        return compare(Path(options.what[0]), Path(options.what[1]))
    if options.command is None:
        return compare(run("HEAD", None, options), run(str(ROOT), None, options))
    raise SystemExit("run takes one revision or folder, compare two folders of results")


if __name__ == "__main__":
    sys.exit(main())
