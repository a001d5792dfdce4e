"""Recordings analysed on this machine: a thread and its helper process for each worker."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from invid.batch.analysis import Options, Outcome
from invid.batch.helper import Helper, own_helper


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def analyse_here(recordings: Mapping[str, Path], options: Options, workers: int) -> Iterator[Outcome]:
    """Outcomes as they come. Whoever stops asking ends all processes."""
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
