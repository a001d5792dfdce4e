"""Every recording below a folder identified and diagnosed, resumable."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from invid import __version__
from invid.batch.analysis import (
    INDEX,
    KILLED,
    Options,
    Outcome,
    Results,
    analyse_apart,
    checksum_of,
    find_recordings,
    row,
)
from invid.errors import InputError, InvidError
from invid.processes import Helper

Submit = Callable[[str, Path], Future[Outcome]]
"""Begins with a recording, by its name and path."""


class ClusterError(InvidError, ConnectionError):
    """The cluster is gone in the middle of a batch; what is done is stored."""

    exit_code = 5


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
        try:
            with _place(scheduler, workers, options) if open_ones else nullcontext() as place:
                for outcome in () if place is None else outcomes_of(open_ones, *place):
                    name = outcome.recording
                    store.store(outcome, checksums[name])
                    outcomes[name] = outcome
                    told(f"[{len(outcomes)}/{len(found)}] {said(outcome)}")
                    store.write_index(outcomes.values())
        finally:
            store.write_index(outcomes.values())
    rows = tuple(outcomes[name] for name in sorted(outcomes))
    return BatchReport(rows, kept, str(results / INDEX), time.monotonic() - began)


@contextmanager
def _place(scheduler: str | None, workers: int | None, options: Options) -> Iterator[tuple[Submit, int]]:
    """Where recordings are analysed, and how many of them at once."""
    if scheduler is None:
        with this_machine(options, workers or len(os.sched_getaffinity(0))) as here:
            yield here
        return
    try:
        cluster = import_module("invid.batch.cluster")
    except ModuleNotFoundError as error:
        if error.name not in ("distributed", "dask"):
            raise
        raise InputError(
            "--scheduler needs Dask, which is not installed: pip install 'invid[fleet]'"
        ) from None
    with cluster.cluster_at(scheduler, options) as (submit, room):
        yield submit, workers or room


@contextmanager
def this_machine(options: Options, room: int) -> Iterator[tuple[Submit, int]]:
    """What analyses a recording in a process of its own, and how many at once; all processes end with it."""
    helpers = [Helper() for _ in range(room)]
    free: SimpleQueue[Helper] = SimpleQueue()

    def one(name: str, path: Path) -> Outcome:
        helper = free.get()
        try:
            return analyse_apart(helper, path, name, options)
        finally:
            free.put(helper)

    for helper in helpers:
        free.put(helper)
    with ThreadPoolExecutor(max_workers=room) as pool:
        try:
            yield lambda name, path: pool.submit(one, name, path), room
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for helper in helpers:
                helper.close()


def outcomes_of(recordings: Mapping[str, Path], submit: Submit, room: int) -> Iterator[Outcome]:
    """Outcomes as they come; at most ``room`` recordings are under way."""
    waiting, under_way = iter(recordings.items()), dict[Future[Outcome], str]()
    while True:
        for name, path in islice(waiting, room - len(under_way)):
            try:
                under_way[submit(name, path)] = name
            except OSError:
                raise _gone() from None
        if not under_way:
            return
        for future in wait(under_way, return_when=FIRST_COMPLETED).done:
            yield _outcome(future, under_way.pop(future))


def _outcome(future: Future[Outcome], name: str) -> Outcome:
    try:
        outcome = future.result()
    except CancelledError:
        raise _gone() from None
    except Exception as error:  # each worker that had it in hand died, or could not say what it found
        return Outcome.failed(name, KILLED, f"its workers ended ({type(error).__name__}: {error})")
    if outcome.software != __version__:
        said = f"a worker that joined later has invid {outcome.software}, here is {__version__}"
        return Outcome.failed(name, KILLED, said)
    return outcome


def _gone() -> ClusterError:
    return ClusterError("--scheduler: it is gone; what is done is stored, the same command goes on")
