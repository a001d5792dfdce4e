"""Independent calls on all cores: forked helpers, where forking is safe, and the answers of one process."""

from __future__ import annotations

import io
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.connection import Connection
from typing import Any, TypeVar

A = TypeVar("A")
B = TypeVar("B")

MOST = 4
"""Processes at most: candidates are a handful, and other programs want a core too."""
_NUMBER = 4
"""Bytes of a call's number: all numbers fit into a pipe (64 KiB), and none lies across two of its pages."""
MOST_CALLS = 65536 // _NUMBER


def at_once(run: Callable[[A], B], items: Sequence[A], known: Sequence[object] = ()) -> list[B]:
    """``[run(item) for item in items]``, on several cores where forking is safe.

    What ``run`` returns is pickled where a helper called it; of the objects ``known`` it may refer to, it
    comes back with the caller's own and not with copies. What ``run`` changes in place is lost with the
    helper, so it must not matter. A call that raises, or whose helper died, is made again here.

    Forking is safe where no other thread of this process may hold a lock: not in a service or beside a bus,
    where the calls follow each other as they would without this function.
    """
    helpers = min(_cores(), len(items)) - 1
    if helpers < 1 or len(items) > MOST_CALLS:
        return [run(item) for item in items]
    context = multiprocessing.get_context("fork")
    numbers, told = os.pipe()
    os.write(told, b"".join(k.to_bytes(_NUMBER, "little") for k in range(len(items))))
    os.close(told)  # whoever finds the pipe empty is done
    working = []
    try:
        for _ in range(helpers):
            mine, theirs = context.Pipe(duplex=False)
            process = context.Process(target=_help, args=(run, items, numbers, known, theirs), daemon=True)
            process.start()
            theirs.close()
            working.append((process, mine))
        done = _taken(run, items, numbers)
        for _, mine in working:
            done.update(_received(mine, known))
    finally:
        os.close(numbers)
        for process, mine in working:
            process.kill()
            process.join()
            mine.close()
    return [done[k] if k in done else run(items[k]) for k in range(len(items))]


def _cores() -> int:
    """Processes that may work at once; 1 where forking is not safe."""
    alone = threading.active_count() == 1 and multiprocessing.parent_process() is None
    if sys.platform != "linux" or not alone:
        return 1
    return min(MOST, len(os.sched_getaffinity(0)))


def _taken(run: Callable[[A], B], items: Sequence[A], numbers: int) -> dict[int, B]:
    """The answers to the calls that nobody else took."""
    done = {}
    while number := os.read(numbers, _NUMBER):
        k = int.from_bytes(number, "little")
        done[k] = run(items[k])
    return done


def _help(
    run: Callable[[A], B], items: Sequence[A], numbers: int, known: Sequence[object], answer: Connection
) -> None:
    """What a helper does: it takes calls, and says nothing where it fails."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the caller, who ends the helper
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        packed = io.BytesIO()
        _Pickler(packed, known).dump(_taken(run, items, numbers))
        answer.send_bytes(packed.getbuffer())
    except Exception:
        os._exit(1)


def _received(answer: Connection, known: Sequence[object]) -> Mapping[int, Any]:
    """What a helper answered; nothing where it died."""
    try:
        found: Mapping[int, Any] = _Unpickler(io.BytesIO(answer.recv_bytes()), known).load()
    except (EOFError, OSError):
        return {}
    return found


class _Pickler(pickle.Pickler):
    """Writes the number of a known object in its place."""

    def __init__(self, file: io.BytesIO, known: Sequence[object]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._numbers = {id(one): k for k, one in enumerate(known)}

    def persistent_id(self, obj: object) -> int | None:
        return self._numbers.get(id(obj))


class _Unpickler(pickle.Unpickler):
    """Puts the known objects back."""

    def __init__(self, file: io.BytesIO, known: Sequence[object]) -> None:
        super().__init__(file)
        self._known = known

    def persistent_load(self, number: Any) -> object:
        return self._known[number]


__all__ = ["at_once"]
