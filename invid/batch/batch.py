"""Every recording below a folder identified and diagnosed, resumable."""

from __future__ import annotations

import json
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
from invid.batch.fleet import FALSE_ALARMS, FleetRow, compare_fleet, find_baselines, write_changes
from invid.batch.helper import Helper, own_helper
from invid.batch.results import INDEX, Results, checksum_of, find_recordings, row
from invid.errors import InputError
from invid.model.diagnosis_document import diagnosis_from_json
from invid.model.document import Model
from invid.model.doubts import doubts_of

INDEX_EVERY_S = 2.0


@dataclass(frozen=True)
class BatchReport:
    """What a batch did: all rows, how many of them an earlier one had done, seconds it took."""

    outcomes: tuple[Outcome, ...]
    kept: int
    index: str
    seconds: float
    fleet: tuple[FleetRow, ...] = ()
    """Recordings beside their baselines, the weightiest change first."""

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
            **({"changes": [r.to_json() for r in self.fleet]} if self.fleet else {}),
            "warnings": [said(o) for o in self.outcomes if o.status == "failed"],
        }


def said(outcome: Outcome) -> str:
    """A line for a person."""
    return f"{outcome.recording}: {outcome.verdict or outcome.error.removeprefix(outcome.recording + ': ')}"


def run_batch(  # noqa: PLR0913 - each is one option of the command
    folder: Path,
    results: Path,
    options: Options,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    baseline: Path | None = None,
    false_alarms: float = FALSE_ALARMS,
    told: Callable[[str], None] = lambda _text: None,
) -> BatchReport:
    """Analyse what ``results`` does not have yet.

    Parameters
    ----------
    scheduler
        Address of a Dask scheduler (``tcp://host:8786``); default: processes of this machine.
    workers
        Recordings at once; default: the cores of this machine, or two a thread of the cluster.
    baseline, false_alarms
        Models to compare with (see ``fleet``), and the probability of calling anything changed in a fleet
        that did not.
    told
        Is given a line for each recording.

    Raises
    ------
    InputError
        No recordings; a folder that cannot be written or is in use; no cluster at the address.
    """
    began = time.monotonic()
    found = find_recordings(folder, results)
    baselines = None if baseline is None else find_baselines(baseline, found)
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
    fleet: tuple[FleetRow, ...] = ()
    if baselines is not None:
        models = {o.recording: _model_of(o) for o in rows}
        fleet = tuple(compare_fleet(models, baselines, false_alarms))
        write_changes(results, fleet)
    return BatchReport(rows, kept, str(results / INDEX), time.monotonic() - began, fleet)


def _model_of(outcome: Outcome) -> Model | str:
    """The extended model of a recording; else why there is none to compare."""
    if outcome.status != "done":
        return outcome.error
    model = diagnosis_from_json(json.loads(outcome.diagnosis), source=outcome.recording).model
    doubts = [d.text for d in doubts_of(model.fit) if d.spoils_changes]
    return doubts[0] if doubts else model


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
