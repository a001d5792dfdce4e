"""Recordings analysed on a Dask cluster that is there already, named by its scheduler's address.

Recordings travel as bytes and documents as text: workers need invid installed, no file system shared. What a
worker that dies had in hand goes to another one.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path

from distributed import Client
from distributed.comm.core import CommClosedError

from invid import __version__
from invid.batch.analysis import Options, Outcome, analyse_content
from invid.errors import InputError

PATIENCE_S = 10.0
"""For a scheduler to answer, and for a first worker."""


@contextmanager
def cluster_at(address: str, options: Options) -> Iterator[tuple[Callable[..., Future[Outcome]], int]]:
    """What sends a recording to the cluster, and how many are under way at once: two a thread.

    Raises
    ------
    InputError
        No scheduler at the address, no worker, or one without this version of invid.
    """
    for name in list(logging.root.manager.loggerDict):
        # Dask's own log is tracebacks: what goes wrong is said in a sentence of ours.
        if name.partition(".")[0] in ("distributed", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    client = _connect(address)
    try:
        _require_workers(client, address)
        executor = client.get_executor(pure=False)

        def submit(name: str, path: Path) -> Future[Outcome]:
            try:
                content = path.read_bytes()
            except OSError as error:
                unread: Future[Outcome] = Future()
                said = f"{name}: cannot be opened: {error.strerror}"
                unread.set_result(Outcome.failed(name, InputError.exit_code, said))
                return unread
            begun: Future[Outcome] = executor.submit(analyse_content, content, name, options)
            return begun

        yield submit, 2 * max(sum(client.nthreads().values()), 1)
    finally:
        with suppress(CommClosedError):
            client.close(timeout=PATIENCE_S)


def _connect(address: str) -> Client:
    try:
        return Client(address, timeout=PATIENCE_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there ({error}); give its address as "
            "tcp://host:8786, or leave the option out to work on this machine"
        ) from None


def _version() -> str:
    return __version__


def _require_workers(client: Client, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=PATIENCE_S)
        versions = client.run(_version)
    except TimeoutError:
        raise InputError(
            f"--scheduler {address}: the scheduler has no workers; start some: dask worker {address}"
        ) from None
    except Exception as error:  # whatever a worker without invid answers
        raise InputError(
            f"--scheduler {address}: a worker cannot load invid ({error}); install invid there"
        ) from None
    for worker, version in versions.items():
        if version != __version__:
            raise InputError(f"--scheduler {address}: {worker} has invid {version}, here is {__version__}")
