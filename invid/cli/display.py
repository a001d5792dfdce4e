"""Progress on stderr: a bar on a terminal, a plain line now and then where there is none."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from invid.cli.output import note

if TYPE_CHECKING:
    from invid.numerics.budget import Progress

BUDGET = 60.0
"""Seconds that a command may take where nothing else is asked for: what a technician waits beside a robot."""
EVERY_S = 5.0
"""Seconds between two plain lines."""


@contextmanager
def shown_progress(title: str) -> Iterator[Callable[[Progress], None]]:
    """A callback for ``progress`` of ``invid.identify`` and ``invid.diagnose`` that shows what it is told."""
    if not sys.stderr.isatty():
        yield _plain(title)
        return
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=20),
        TaskProgressColumn(),
        TextColumn("{task.fields[left]}", markup=False),
    )
    # No thread of its own: the search forks helpers, which is safe only while there is none.
    bar = Bar(*columns, console=Console(stderr=True), transient=True, auto_refresh=False)
    with bar:
        task = bar.add_task(title, total=1.0, left="")
        shown = [0.0]

        def show(progress: Progress) -> None:
            now = time.monotonic()
            if now - shown[0] < 0.1:
                return
            shown[0] = now
            bar.update(task, description=str(progress), completed=progress.fraction, left=_left(progress))
            bar.refresh()

        yield show


def _plain(title: str) -> Callable[[Progress], None]:
    said, compiled = [time.monotonic()], list[str]()

    def show(progress: Progress) -> None:
        now = time.monotonic()
        waits = (
            progress.stage.startswith("compiling") and not compiled
        )  # said at once: nothing else is for a while
        if waits or now - said[0] >= EVERY_S:
            said[0] = now
            compiled.extend(["said"] * waits)
            note(f"{title}: {progress.fraction:4.0%} {progress} {_left(progress)}".rstrip())

    return show


def _left(progress: Progress) -> str:
    left = progress.seconds_left
    return "" if left is None else f"(at most {left:.0f} s left)"
