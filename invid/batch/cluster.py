"""Recordings analysed on a Dask cluster that is there already, named by its scheduler's address.

Recordings travel as bytes and documents as text: workers need invid installed, no file system shared. What a
worker that dies had in hand goes to another one.
"""

from __future__ import annotations

import contextlib
import logging
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from distributed import Client, KilledWorker, as_completed
from distributed.comm.core import CommClosedError
from distributed.scheduler import NoValidWorkerError

from invid import __version__
from invid.batch.analysis import KILLED, Options, Outcome
from invid.batch.helper import analyse_content
from invid.errors import InputError, InvidError

PATIENCE_S = 10.0
"""For a scheduler to answer, and for a first worker."""


class ClusterError(InvidError, ConnectionError):
    """The cluster is gone in the middle of a batch; what is done is stored."""

    exit_code = 5


def analyse_on_cluster(
    address: str, recordings: Mapping[str, Path], options: Options, at_once: int | None
) -> Iterator[Outcome]:
    """Yield outcomes as they come. At most ``at_once`` recordings are under way, by default two a thread."""
    client = _connect(address)
    try:
        room = at_once or 2 * max(sum(client.nthreads().values()), 1)
        waiting = iter(recordings.items())
        names: dict[str, str] = {}
        under_way = as_completed(loop=client.loop, raise_errors=False)

        def begin() -> Iterator[Outcome]:
            """Start one recording more; those that cannot even be read are finished here."""
            for name, path in waiting:
                try:
                    content = path.read_bytes()
                except OSError as error:
                    text = f"{name}: cannot be opened: {error.strerror}"
                    yield Outcome(name, "failed", InputError.exit_code, error=text)
                    continue
                key = f"invid-batch-{uuid.uuid4().hex}"
                names[key] = name
                under_way.add(client.submit(_task, content, name, options.to_json(), key=key, pure=False))
                return

        for _ in range(room):
            yield from begin()
        for future in under_way:
            if future.status == "lost":  # with the worker that had its result; it is worked out again
                under_way.add(future)
                continue
            yield _outcome(future, names.pop(future.key), address)
            future.release()
            yield from begin()
    except CommClosedError:  # while something was being sent to it
        raise _gone(address) from None
    finally:
        with contextlib.suppress(CommClosedError):
            client.close(timeout=PATIENCE_S)


def _quiet() -> None:
    """Silence Dask's own log, which is tracebacks: what goes wrong is said in a sentence of ours."""
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)


def _connect(address: str) -> Client:
    _quiet()
    try:
        client = Client(address, timeout=PATIENCE_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there ({error}); give its address as "
            "tcp://host:8786, or leave the option out to work on this machine"
        ) from None
    try:
        client.wait_for_workers(1, timeout=PATIENCE_S)
        versions = client.run(_version)
    except TimeoutError:
        client.close()
        raise InputError(
            f"--scheduler {address}: the scheduler has no workers; start some: dask worker {address}"
        ) from None
    except Exception as error:  # whatever a worker without invid answers
        client.close()
        raise InputError(
            f"--scheduler {address}: a worker cannot load invid ({error}); install invid there"
        ) from None
    for worker, version in versions.items():
        if version != __version__:
            client.close()
            raise InputError(f"--scheduler {address}: {worker} has invid {version}, here is {__version__}")
    return client


def _version() -> str:
    return __version__


def _task(content: bytes, name: str, options: dict[str, Any]) -> dict[str, Any]:
    """Analyse one recording on a worker; one with another version gives no result of this batch."""
    return {"version": __version__, "outcome": analyse_content(content, name, options)}


def _gone(address: str) -> ClusterError:
    return ClusterError(
        f"--scheduler {address}: the scheduler is gone; what is done is stored, the same command goes on"
    )


def _outcome(future: Any, name: str, address: str) -> Outcome:
    if future.status == "finished":
        answer = future.result()
        if answer["version"] == __version__:
            return Outcome(**answer["outcome"])
        text = f"a worker that joined later has invid {answer['version']}, here is {__version__}"
        return Outcome(name, "failed", KILLED, error=text)
    if future.status == "cancelled":
        raise _gone(address)
    error = future.exception()
    if isinstance(error, KilledWorker | NoValidWorkerError):
        return Outcome(name, "failed", KILLED, error="each worker that had it in hand died")
    return Outcome(name, "failed", KILLED, error=" ".join(f"{type(error).__name__}: {error}".split()))
