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
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from invid.numerics import budget

A = TypeVar("A")
B = TypeVar("B")

MOST = 4
"""Processes at most: candidates are a handful, and other programs want a core too."""
_NUMBER = 4
"""Bytes of a call's number: none lies across two pages of a pipe."""
MOST_CALLS = 4096 // _NUMBER
"""As many as the smallest pipe takes at once, that of a user who has used up what the kernel allows."""


def parallel_map(run: Callable[[A], B], items: Sequence[A], known: Sequence[object] = ()) -> list[B]:
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
    try:
        numbers = _numbered(len(items))
    except OSError:  # no more files
        return [run(item) for item in items]
    calls = _Calls(run, items, numbers, known, os.getpid())
    working: list[tuple[BaseProcess, Connection]] = []
    with budget.use_helpers(helpers + 1):
        try:
            for _ in range(helpers):
                try:
                    mine, theirs = context.Pipe(duplex=False)
                except OSError:  # as below, where there are no more processes: with those that there are
                    break
                # A helper with the caller's ends open would never learn that the caller is gone.
                idle = [mine, *(m for _, m in working)]
                process = context.Process(target=_help, args=(calls, theirs, idle), daemon=True)
                try:
                    process.start()
                except OSError:
                    mine.close()
                    break
                finally:
                    theirs.close()
                working.append((process, mine))
            done = calls.taken(helps=False)
            for _, answer in working:
                done.update(_received(answer, known))
        finally:
            os.close(numbers)
            for helper, answer in working:
                helper.kill()
                helper.join()
                answer.close()
    return [done[k] if k in done else run(items[k]) for k in range(len(items))]


def _numbered(count: int) -> int:
    """A pipe with the numbers of all calls in it; whoever finds it empty is done."""
    numbers, told = os.pipe()
    try:
        os.write(told, b"".join(k.to_bytes(_NUMBER, "little") for k in range(count)))
    finally:
        os.close(told)
    return numbers


def _cores() -> int:
    """Processes that may work at once; 1 where forking is not safe."""
    alone = threading.active_count() == 1 and multiprocessing.parent_process() is None
    if sys.platform != "linux" or not alone:
        return 1
    return min(MOST, len(os.sched_getaffinity(0)))


@dataclass(frozen=True, eq=False)
class _Calls(Generic[A, B]):
    """Calls that whoever is free takes: a pipe has the numbers of those that nobody took."""

    run: Callable[[A], B]
    items: Sequence[A]
    numbers: int
    known: Sequence[object]
    caller: int

    def taken(self, *, helps: bool) -> dict[int, B]:
        """Return the answers to the calls that nobody else took; a helper ends where its caller is gone."""
        done = {}
        while number := os.read(self.numbers, _NUMBER):
            if helps and os.getppid() != self.caller:
                os._exit(1)
            k = int.from_bytes(number, "little")
            done[k] = self.run(self.items[k])
        return done


def _help(calls: _Calls[A, B], answer: Connection, idle: Sequence[Connection]) -> None:
    """Work as a helper: take calls, and say nothing where one fails."""
    signal.signal(signal.SIGINT, lambda *_: budget.stop())  # Ctrl-C: the caller wants what there is
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    budget.enter_helper()
    for end in idle:
        end.close()
    try:
        packed = io.BytesIO()
        _Pickler(packed, calls.known).dump(calls.taken(helps=True))
        answer.send_bytes(packed.getbuffer())
    except Exception:
        os._exit(1)


def _received(answer: Connection, known: Sequence[object]) -> Mapping[int, Any]:
    """Return what a helper answered; nothing where it died, or where its answer cannot be read."""
    try:
        found: Mapping[int, Any] = _Unpickler(io.BytesIO(answer.recv_bytes()), known).load()
    except Exception:  # whatever an object's own unpickling raises
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
