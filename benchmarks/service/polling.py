"""Clients that ask for one address at a fixed rate: ``python polling.py URL PATH RATE CLIENTS SECONDS``.

A process of their own that needs a tenth of what the service needs for the answers, with precedence over
ordinary programs where the system allows it: they stand for other computers, which do not wait for a core of
this one. Every request has its due time and counts from there, so that a late server cannot hide behind its
clients. Ends early when its standard input is closed. One JSON document on stdout.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

CLIENTS = 20
RATE = 200.0
NICE = -15
"""Before the service's own."""
_LENGTH = b"content-length:"


@dataclass(frozen=True)
class Load:
    """What twenty clients met."""

    latencies: list[float]
    failures: list[str]
    processor_s: float

    @property
    def p99(self) -> float:
        """Latency [s] that one request in a hundred exceeds."""
        return float(np.quantile(self.latencies, 0.99))

    def __str__(self) -> str:
        p50, p99, worst = (1e3 * float(np.quantile(self.latencies, q)) for q in (0.5, 0.99, 1.0))
        return (
            f"{len(self.latencies)} requests from {CLIENTS} clients at {RATE:.0f}/s: p50 {p50:.1f} ms, "
            f"p99 {p99:.1f} ms, worst {worst:.1f} ms, {len(self.failures)} failed"
        )


def hammer(url: str, location: str, seconds: float, ended: threading.Event | None = None) -> Load:
    """Ask for the state of a run, until the time or the event has come."""
    numbers = [str(n) for n in (RATE, CLIENTS, seconds)]
    clients = subprocess.Popen(
        [sys.executable, str(Path(__file__)), url, location, *numbers],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    if ended is not None:
        ended.wait(seconds)
        return Load(**json.loads(clients.communicate()[0]))
    with clients:
        return Load(**json.loads(clients.stdout.read()))  # type: ignore[union-attr]


async def client(
    first: float, step: float, last: float, url: str, path: str, end: asyncio.Event
) -> tuple[list[float], list[str]]:
    """Latencies [s] of one client from each due time, and the answers that were none."""
    address = urlsplit(url)
    reader, writer = await asyncio.open_connection(address.hostname, address.port)
    request = f"GET {path} HTTP/1.1\r\nHost: {address.netloc}\r\nAccept: application/json\r\n\r\n".encode()
    latencies: list[float] = []
    failures: list[str] = []
    due = first
    while due < last and not end.is_set():
        await asyncio.sleep(max(0.0, due - time.perf_counter()))
        writer.write(request)
        head = await reader.readuntil(b"\r\n\r\n")
        (length,) = (line[len(_LENGTH) :] for line in head.lower().split(b"\r\n") if line.startswith(_LENGTH))
        await reader.readexactly(int(length))
        latencies.append(time.perf_counter() - due)
        if not head.startswith(b"HTTP/1.1 200"):
            failures.append(head.split(b"\r\n")[0].decode())
        due += step
    writer.close()
    return latencies, failures


async def poll(url: str, path: str, rate: float, clients: int, seconds: float) -> dict[str, object]:
    """All of them."""
    end = asyncio.Event()
    loop = asyncio.get_running_loop()

    def leave() -> None:
        loop.remove_reader(0)
        end.set()

    loop.add_reader(0, leave)
    start, began = time.perf_counter() + 0.3, time.process_time()
    last = start + seconds
    found = await asyncio.gather(
        *(client(start + k / rate, clients / rate, last, url, path, end) for k in range(clients))
    )
    return {
        "latencies": [s for latencies, _ in found for s in latencies],
        "failures": [f for _, failures in found for f in failures],
        "processor_s": time.process_time() - began,
    }


def main() -> None:
    """Entry of the process."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, NICE)
    url, path, rate, clients, seconds = sys.argv[1:]
    print(json.dumps(asyncio.run(poll(url, path, float(rate), int(clients), float(seconds)))))


if __name__ == "__main__":
    main()
