"""Records that others published: fetched (here from a server on loopback), checked, with their licence."""

import hashlib
import json
import threading
from collections.abc import Iterator
from dataclasses import asdict
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest

from invid.cli.app import run
from invid.public_records import SETS, RecordFile, RecordSet

PENDULUM = next(s for s in SETS if s.name == "double_pendulum")


class Place:
    """A server that has what it is given, by path, and counts who asked."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.asked: list[str] = []
        place = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                path = unquote(self.path).lstrip("/")
                place.asked.append(path)
                content = place.files.get(path)
                self.send_response(200 if content is not None else 404)
                self.send_header("Content-Length", str(len(content or b"")))
                self.end_headers()
                self.wfile.write(content or b"")

            def log_message(self, *_: Any) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


@pytest.fixture
def place() -> Iterator[Place]:
    found = Place()
    yield found
    found.server.shutdown()
    found.server.server_close()


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch, place: Place) -> bytes:
    """The pendulum's set with one file of nine bytes and its licence."""
    content = b"0,1,2\n3,4"
    rows = [("a.csv", "far away/b.csv", content), ("LICENSE", "LICENSE", b"BSD 3-Clause License")]

    class Small(RecordSet):
        files = tuple(RecordFile(n, u, hashlib.sha256(c).hexdigest()) for n, u, c in rows)  # type: ignore[assignment]

    monkeypatch.setattr("invid.cli.fetch_data.SETS", (Small(**asdict(PENDULUM)),))
    for _, upstream, c in rows:
        place.files[f"{PENDULUM.repository}/{PENDULUM.commit}/{upstream}"] = c
    return content


def test_a_set_comes_with_licence_and_source_and_is_not_fetched_twice(
    tmp_path: Path, place: Place, small: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["fetch-data", "double_pendulum", "--to", str(tmp_path), "--source", place.url, "--json"]
    assert run(given) == 0
    (told,) = json.loads(capsys.readouterr().out)["sets"]
    own = tmp_path / "double_pendulum"
    assert (told["folder"], told["licence"][:12]) == (str(own), "BSD-3-Clause")
    assert (own / "a.csv").read_bytes() == small
    assert "BSD" in (own / "LICENSE").read_text()
    assert PENDULUM.commit in (own / "SOURCE.txt").read_text()
    assert len(place.asked) == 2
    assert run(given) == 0
    assert len(place.asked) == 2
    (own / "a.csv").write_bytes(b"damaged")
    assert run(given) == 0
    assert (own / "a.csv").read_bytes() == small


def test_without_a_network_the_words_say_what_to_do(
    tmp_path: Path, place: Place, small: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["fetch-data", "double_pendulum", "--to", str(tmp_path), "--source"]
    assert run([*given, "http://127.0.0.1:9"]) == 2  # nobody listens on the port "discard"
    said = capsys.readouterr().err
    for part in (
        "b.csv: cannot be reached",
        "copy that folder",
        "--source",
        "demo and quickstart need no record",
    ):
        assert part in said
    place.files.clear()
    assert run([*given, place.url]) == 2
    assert "answers 404" in capsys.readouterr().err
    assert run(["fetch-data", "nope"]) == 2
    assert "there are double_pendulum" in capsys.readouterr().err
