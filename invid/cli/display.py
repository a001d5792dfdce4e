"""Progress on stderr: a bar on a terminal, a plain line now and then where there is none."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING

from invid.cli.output import note
from invid.numerics import budget

if TYPE_CHECKING:
    from invid.numerics.budget import Found, Progress

EVERY_S = 5.0
"""Seconds between two plain lines."""


@contextmanager
def ends_on_interrupt() -> Iterator[None]:
    """Context manager in which the first Ctrl-C ends a search with the best answer so far, the second
    the command.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: FrameType | None) -> None:
        if not budget.stop():
            raise KeyboardInterrupt
        note("ending with the best answer so far (once more: at once, with none)")

    before = signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


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
    found: list[tuple[Found, ...]] = [()]

    def show(progress: Progress) -> None:
        now = time.monotonic()
        waits = (
            progress.stage.startswith("compiling") and not compiled
        )  # said at once: nothing else is for a while
        is_new = progress.found != found[0]
        if waits or is_new or now - said[0] >= EVERY_S:
            said[0], found[0] = now, progress.found
            compiled.extend(["said"] * waits)
            note(f"{title}: {progress.fraction:4.0%} {progress} {_left(progress)}".rstrip())

    return show


def _left(progress: Progress) -> str:
    left = progress.seconds_left
    words = [] if left is None else [f"(about {left:.0f} s left)"]
    words += [f"found so far, still looking: {', '.join(map(str, progress.found))}"] if progress.found else []
    return " ".join(words)
