"""Behind a real nginx, under a path: the page, the calls and the events, for those who have a key."""

import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from service_process import serving

from invid_service.keys import add_key

NGINX = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
pytestmark = [
    pytest.mark.campaign,
    pytest.mark.skipif(
        NGINX is None, reason="NGINX IS MISSING: the reverse proxy is not tested; apt-get install nginx"
    ),
    pytest.mark.service,
]
# As in docs/how-to/operate.md.
CONFIG = """\
daemon off;
pid {folder}/nginx.pid;
error_log {folder}/error.log;
events {{}}
http {{
  access_log off;
  client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy; fastcgi_temp_path {folder}/f;
  uwsgi_temp_path {folder}/u; scgi_temp_path {folder}/s;
  server {{
    listen 127.0.0.1:{port};
    location /robots/invid/ {{
      proxy_pass {upstream}/;
      proxy_set_header Host $http_host;
      proxy_set_header X-Forwarded-For $proxy_add_x_forwarded_for;
      proxy_set_header X-Forwarded-Proto $scheme;
      proxy_http_version 1.1;
      client_max_body_size 600m;
    }}
  }}
}}
"""


@contextmanager
def proxy(folder: Path, upstream: str) -> Iterator[str]:
    """nginx in front of ``upstream``; the address of the service there."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    folder.mkdir()
    file = folder / "nginx.conf"
    file.write_text(CONFIG.format(folder=folder, port=port, upstream=upstream))
    process = subprocess.Popen([str(NGINX), "-p", str(folder), "-c", str(file)], stderr=subprocess.PIPE)
    try:
        deadline = time.monotonic() + 10
        while True:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            assert process.poll() is None, (folder / "error.log").read_text()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        yield f"http://127.0.0.1:{port}/robots/invid"
    finally:
        process.terminate()
        process.wait(10)


def test_a_run_is_started_and_followed_through_a_proxy_by_who_has_a_key(tmp_path: Path) -> None:
    key = add_key(tmp_path / "keys.json", "plc", ["read", "run"])
    given = ("--key-file", str(tmp_path / "keys.json"), "--root-path", "/robots/invid")
    with (
        serving(tmp_path, *given, "--trusted-proxy", "127.0.0.1") as served,
        proxy(tmp_path / "nginx", served.url) as url,
        httpx.Client(trust_env=False, timeout=20.0) as client,
    ):
        assert client.get(f"{url}/api/v1/cells").status_code == 401
        assert client.get(f"{url}/api/v1/cells", headers={"X-Forwarded-For": "127.0.0.1"}).status_code == 401
        client.headers["Authorization"] = f"Bearer {key}"
        cell = client.get(f"{url}/api/v1/cells").json()["cells"][0]["id"]
        started = client.post(f"{url}/api/v1/cells/{cell}/identifications", json={"mode": "test"})
        assert started.status_code == 202, started.text
        origin = url.removesuffix("/robots/invid")
        events = started.json()["links"]["events"]
        seen: list[float] = []

        def follow() -> None:
            with client.stream("GET", origin + events) as stream:
                for line in stream.iter_lines():
                    if line.startswith("data: "):
                        seen.append(time.monotonic())

        thread = threading.Thread(target=follow, daemon=True)
        thread.start()
        location = origin + started.headers["Location"]
        deadline = time.monotonic() + 60
        while client.get(location).json()["state"] != "awaiting_arm":
            assert time.monotonic() < deadline
            time.sleep(0.05)
        time.sleep(0.5)
        assert seen, "events are held back by the proxy"
        assert client.post(f"{location}/actions", json={"type": "cancel"}).status_code == 200
        thread.join(20)
        assert not thread.is_alive()
