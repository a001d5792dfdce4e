"""Picture the page with the result of a whole run on the simulated cell: `make pictures` (needs chromium)."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

from PIL import Image

CELL = "/api/v1/cells/case_study/identifications"
SIZE = (1280, 800)


def call(url: str, body: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the JSON that an address answers with."""
    data = None if body is None else json.dumps(body).encode()
    with urlopen(Request(url, data, {"Content-Type": "application/json"})) as answer:
        found: dict[str, Any] = json.load(answer)
    return found


def whole_run(url: str) -> None:
    """Measure and analyse, up to the decision."""
    run = call(f"{url}{CELL}", {"mode": "full", "arm": True})["id"]
    while (now := call(f"{url}/api/v1/identifications/{run}"))["state"] != "awaiting_accept":
        if now["error"]:
            raise SystemExit(f"the run ended {now['state']}: {now['error']['text']}")
        time.sleep(1.0)


def picture(url: str, out: Path) -> None:
    """Save what a browser shows, in few colours."""
    with tempfile.TemporaryDirectory() as profile:
        flags = f"--headless --no-sandbox --disable-gpu --hide-scrollbars --lang=en --user-data-dir={profile}"
        shot = f"--window-size={SIZE[0]},{SIZE[1]} --virtual-time-budget=10000 --screenshot={out}"
        subprocess.run(["chromium", *flags.split(), *shot.split(), url], check=True, capture_output=True)
    Image.open(out).convert("RGB").quantize(64).save(out, optimize=True)


def main(out: Path) -> None:
    """Serve the simulated cell, run it once, picture the result."""
    with tempfile.TemporaryDirectory() as data:
        command = [sys.executable, "-m", "invid", "serve", "--port", "0", "--data-dir", data]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as service:
            try:
                lines = service.stderr or []
                url = next(found[1] for line in lines if (found := re.search(r"(http://\S+?)/ ", line)))
                whole_run(url)
                picture(f"{url}/", out)
            finally:
                service.terminate()
    print(out)


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute())
