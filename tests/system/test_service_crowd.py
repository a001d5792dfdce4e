"""Connections that ask for nothing, more than there are files to open: a stop gets through."""

from __future__ import annotations

import contextlib
import resource
import socket
import threading
import time
from pathlib import Path

import httpx
import pytest
from service_process import serving

pytestmark = pytest.mark.service
FILES = 256
HALVES = (
    b"",
    b"GET /api/v1/state HTTP/1.1\r\nHost: 127",
    b"POST /api/v1/recordings HTTP/1.1\r\nHost: 127.0.0.1\r\n",
)


def test_three_hundred_silent_connections_and_fifty_pollers_keep_no_stop_waiting(tmp_path: Path) -> None:
    with serving(tmp_path) as service, contextlib.ExitStack() as all_of_them:
        resource.prlimit(service.process.pid, resource.RLIMIT_NOFILE, (FILES, FILES))
        address = ("127.0.0.1", int(service.url.rsplit(":", 1)[1]))
        for k in range(300):
            silent = all_of_them.enter_context(socket.create_connection(address))
            silent.sendall(HALVES[k % len(HALVES)])
        over, answers = threading.Event(), list[int]()

        def poll() -> None:
            with httpx.Client(base_url=service.url, trust_env=False, timeout=20) as client:
                while not over.is_set():
                    with contextlib.suppress(httpx.HTTPError):
                        answers.append(client.get("/api/v1/state").status_code)
                    over.wait(0.5)

        pollers = [threading.Thread(target=poll) for _ in range(50)]
        for poller in pollers:
            poller.start()
        try:
            took = []
            for _ in range(5):
                began = time.monotonic()
                with httpx.Client(base_url=service.url, trust_env=False, timeout=20) as client:
                    assert client.post("/api/v1/stop").status_code == 200
                took.append(time.monotonic() - began)
                time.sleep(0.3)
        finally:
            over.set()
            for poller in pollers:
                poller.join()
        assert sorted(took)[2] < 1.0, took
        assert answers.count(200) > 50
