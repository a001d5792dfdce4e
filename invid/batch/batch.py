"""Every recording below a folder identified and diagnosed, resumable."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import closing
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from invid.batch.analysis import Options, Outcome
from invid.batch.helper import Helper, own_helper
from invid.batch.results import INDEX, Results, checksum_of, find_recordings, row
from invid.errors import InputError

INDEX_EVERY_S = 2.0


@dataclass(frozen=True)
class BatchReport:
    """What a batch did: all rows, how many of them an earlier one had done, seconds it took."""

    outcomes: tuple[Outcome, ...]
    kept: int
    index: str
    seconds: float

    @property
    def done(self) -> int:
        """Recordings with a diagnosis."""
        return sum(o.status == "done" for o in self.outcomes)

    def to_json(self) -> dict[str, Any]:
        """The document of ``invid batch --json``."""
        return {
            "index": self.index,
            "recordings": len(self.outcomes),
            "done": self.done,
            "failed": len(self.outcomes) - self.done,
            "kept": self.kept,
            "seconds": round(self.seconds, 3),
            "rows": [row(o) for o in self.outcomes],
            "warnings": [said(o) for o in self.outcomes if o.status == "failed"],
        }


def said(outcome: Outcome) -> str:
    """A line for a person."""
    return f"{outcome.recording}: {outcome.verdict or outcome.error.removeprefix(outcome.recording + ': ')}"


def run_batch(
    folder: Path,
    results: Path,
    options: Options,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    told: Callable[[str], None] = lambda _text: None,
) -> BatchReport:
    """Analyse what ``results`` does not have yet.

    Parameters
    ----------
    scheduler
        Address of a Dask scheduler (``tcp://host:8786``); default: processes of this machine.
    workers
        Recordings at once; default: the cores of this machine, or two a thread of the cluster.
    told
        Is given a line for each recording.

    Raises
    ------
    InputError
        No recordings; a folder that cannot be written or is in use; no cluster at the address.
    """
    began = time.monotonic()
    found = find_recordings(folder, results)
    with Results(results, options) as store:
        checksums = {name: checksum_of(path) for name, path in found.items()}
        outcomes = {n: o for n in found if (o := store.kept(n, checksums[n])) is not None}
        kept = len(outcomes)
        if kept:
            told(f"{kept} of {len(found)} recordings were done before")
        open_ones = {name: path for name, path in found.items() if name not in outcomes}
        written = time.monotonic()
        with closing(_analyse(open_ones, options, scheduler, workers)) as coming:
            try:
                for outcome in coming:
                    name = outcome.recording
                    store.store(outcome, checksums[name])
                    outcomes[name] = outcome
                    told(f"[{len(outcomes)}/{len(found)}] {said(outcome)}")
                    if time.monotonic() - written > INDEX_EVERY_S:
                        store.write_index(outcomes.values())
                        written = time.monotonic()
            finally:
                store.write_index(outcomes.values())
    rows = tuple(outcomes[name] for name in sorted(outcomes))
    return BatchReport(rows, kept, str(results / INDEX), time.monotonic() - began)


def _analyse(
    recordings: Mapping[str, Path], options: Options, scheduler: str | None, workers: int | None
) -> Generator[Outcome, None, None]:
    if not recordings:
        return
    if scheduler is None:
        yield from analyse_here(recordings, options, workers or cores())
        return
    try:
        cluster = import_module("invid.batch.cluster")
    except ModuleNotFoundError as error:
        if error.name not in ("distributed", "dask"):
            raise
        raise InputError(
            "--scheduler needs Dask, which is not installed: pip install 'invid[fleet]'"
        ) from None
    yield from cluster.analyse_on_cluster(scheduler, recordings, options, workers)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def analyse_here(recordings: Mapping[str, Path], options: Options, workers: int) -> Iterator[Outcome]:
    """Yield outcomes as they come. Whoever stops asking ends all processes."""
    helpers: list[Helper] = []

    def one(name: str, path: Path) -> Outcome:
        helper = own_helper()
        if helper not in helpers:
            helpers.append(helper)
        return helper.ask(path, name, options)

    with ThreadPoolExecutor(max_workers=min(workers, len(recordings))) as pool:
        futures = [pool.submit(one, name, path) for name, path in recordings.items()]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for helper in helpers:
                helper.close()
