"""The cookbook, executed: every ``sh`` block of docs/how-to/rest.md, in order, against ``invid serve``.

Then the Python of docs/how-to/rest-languages.md, which starts a run of its own.
"""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from service_process import serving

COOKBOOK = Path(__file__).parents[2] / "docs" / "how-to" / "rest.md"
LANGUAGES = COOKBOOK.with_name("rest-languages.md")
pytestmark = [pytest.mark.campaign, pytest.mark.service]


def test_the_cookbook_runs_as_it_stands_and_finds_the_changed_tool(tmp_path: Path) -> None:
    assert shutil.which("curl"), "curl is needed to run the cookbook"
    blocks = re.findall(r"^```sh\n(.*?)^```", COOKBOOK.read_text(encoding="utf-8"), re.M | re.S)
    assert len(blocks) >= 7
    script = "set -eu\n" + "\n".join(blocks)
    with serving(tmp_path, cell=None) as service:
        done = subprocess.run(
            ["bash", "-c", script],
            cwd=tmp_path,
            env={"INVID": service.url, "PATH": "/usr/bin:/bin", "NO_PROXY": "*"},
            capture_output=True,
            text=True,
            timeout=550,
        )
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
        (python,) = re.findall(r"^```python\n(.*?)^```", LANGUAGES.read_text(encoding="utf-8"), re.M | re.S)
        asked = subprocess.run(
            [sys.executable, "-c", python],
            env={"INVID": service.url, "PATH": "/usr/bin:/bin", "NO_PROXY": "*"},
            capture_output=True,
            text=True,
            timeout=550,
        )
        assert asked.returncode == 0, asked.stderr[-3000:]
        assert asked.stdout.startswith("awaiting_accept explained"), asked.stdout  # no result of a run before
    changes = json.loads((tmp_path / "changes.json").read_text())
    changed = {p["parameter"]: p for p in changes["parameters"] if p["status"] == "changed"}
    # 1.31 kg·m² was added to the end of A2 and nothing else was touched.
    assert set(changed) == {"A2.mass.3"}, changes["sentence"]
    assert changed["A2.mass.3"]["difference"] == pytest.approx(1.31, abs=0.05)
    assert "looks like a tool change" in changes["sentence"]
    assert "<html" in (tmp_path / "report.html").read_text().lower()
    assert (tmp_path / "recording.h5").read_bytes().startswith(b"\x89HDF")
