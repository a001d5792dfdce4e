"""Frozen behaviour: the documents of several hundred recordings by one revision beside those by another.

    python benchmarks/bench_frozen.py run REVISION|FOLDER [-o RESULTS] [--cases 360] [--motors K] [--jobs 1]
    python benchmarks/bench_frozen.py compare RESULTS RESULTS
    python benchmarks/bench_frozen.py [--cases 40] [--motors 2]      the working tree against HEAD

Cases: hidden effects, the real records of ../shared/data and the
demo. Their recordings are made once, into a cache outside the repository (--cache); each revision then
identifies and diagnoses the same files with its own code, in a process of its own. A run that was broken off
goes on where it was; a case that fails, hangs (--timeout) or takes its process down is written down as that.

``compare`` prints every difference in exit status, verdict, cause, place, size and χ², and says which
documents are the same byte by byte, but for what ``normalised`` leaves out. Exit status 0: no difference.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import select
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.frozen.cases import ROOT, Case, cases, make
from benchmarks.frozen.compare import compare

CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "invid-frozen"


class Worker:
    """A process that runs cases with the code of one tree; started again where it died."""

    def __init__(self, tree: Path) -> None:
        self.tree = tree
        self.process: subprocess.Popen[str] | None = None

    def ask(self, job: dict[str, Any], seconds: float) -> dict[str, Any]:
        """The answer to one job, or what became of it."""
        if self.process is None or self.process.poll() is not None:
            self._start()
        assert self.process is not None
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(job) + "\n")
        self.process.stdin.flush()
        answer = self._line(seconds)
        return answer if answer is not None else self._lost(f"no answer within {seconds:g} s")

    def _start(self) -> None:
        path = os.pathsep.join(str(self.tree / p) for p in (".", "drivers", "service"))
        threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).parent / "frozen" / "worker.py"), str(self.tree)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=self.tree,
            env={**os.environ, **threads, "PYTHONPATH": path},
        )  # fmt: skip
        if not (self._line(300.0) or {}).get("ready"):
            raise SystemExit(f"{self.tree}: its invid does not start")

    def _line(self, seconds: float) -> dict[str, Any] | None:
        assert self.process is not None
        assert self.process.stdout is not None
        if not select.select([self.process.stdout], [], [], seconds)[0]:
            return None
        line = self.process.stdout.readline()
        return json.loads(line) if line else self._lost("the process ended")

    def _lost(self, why: str) -> dict[str, Any]:
        self.close()
        return {"status": {}, "said": why, "cpu_s": 0.0}

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None


def recordings(chosen: list[Case], cache: Path, jobs: int) -> list[Case]:
    """Makes what is not in the cache; the cases that have a recording."""
    folder = cache / "recordings"
    folder.mkdir(parents=True, exist_ok=True)
    missing = [c for c in chosen if not (folder / f"{c.name}.h5").exists()]
    with get_context("spawn").Pool(jobs, maxtasksperchild=50) as pool:
        for case, failure in pool.imap_unordered(_make, [(c, folder / f"{c.name}.h5") for c in missing]):
            print(f"recording {case.name}: {failure or 'made'}", file=sys.stderr, flush=True)
    return [c for c in chosen if (folder / f"{c.name}.h5").exists()]


def _make(job: tuple[Case, Path]) -> tuple[Case, str]:
    try:
        make(*job)
    except Exception as error:
        return job[0], f"{type(error).__name__}: {error}"
    return job[0], ""


def tree_of(revision: str, cache: Path) -> Path:
    """A folder as it is, or a revision checked out into the cache."""
    if Path(revision).is_dir():
        return Path(revision).resolve()

    def git(*arguments: str) -> str:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{revision}: neither a folder nor a revision: {done.stderr.strip()}")
        return done.stdout.strip()

    sha = git("rev-parse", "--short=12", f"{revision}^{{commit}}")
    tree = cache / "trees" / sha
    if not tree.exists():
        tree.mkdir(parents=True)
        archive = subprocess.Popen(["git", "archive", sha], cwd=ROOT, stdout=subprocess.PIPE)
        subprocess.run(["tar", "-x", "-C", str(tree)], stdin=archive.stdout, check=True)
        archive.wait()
    return tree


def run(revision: str, results: Path | None, options: argparse.Namespace) -> Path:
    """Documents of all cases by one revision; the folder they are in."""
    cache = Path(options.cache).resolve()
    chosen = recordings(cases(options.cases, options.motors), cache, options.jobs)
    tree = tree_of(revision, cache)
    folder = (results or cache / "results" / tree.name).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    if (
        results is None and Path(revision).is_dir()
    ):  # a working tree changes: its last results are no more its own
        for stale in folder.glob("*/answer.json"):
            stale.unlink()
    todo = [c for c in chosen if not (folder / c.name / "answer.json").exists()]
    workers: queue.SimpleQueue[Worker] = queue.SimpleQueue()
    every = [Worker(tree) for _ in range(options.jobs)]
    for worker in every:
        workers.put(worker)
    done, lock = [len(chosen) - len(todo)], threading.Lock()

    def one(case: Case) -> None:
        place = folder / case.name
        place.mkdir(exist_ok=True)
        for document in place.glob("*.json"):
            document.unlink()
        worker = workers.get()
        job = {
            "recording": str(cache / "recordings" / f"{case.name}.h5"),
            "folder": str(place),
            "arguments": case.arguments,
        }
        try:
            answer = worker.ask(job, options.timeout)
        finally:
            workers.put(worker)
        (place / "answer.json").write_text(json.dumps(answer), encoding="utf-8")
        with lock:
            done[0] += 1
            print(
                f"{done[0]}/{len(chosen)} {case.name}: {answer['status']} {answer['cpu_s']:.1f} s",
                file=sys.stderr, flush=True,
            )  # fmt: skip

    try:
        with ThreadPoolExecutor(options.jobs) as pool:
            list(pool.map(one, todo))
    finally:
        for worker in every:
            worker.close()
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
    parser.add_argument("--jobs", type=int, default=1)
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
