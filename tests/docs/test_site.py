"""The documentation site is built without a warning: no dead link, no page outside the contents."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from pages import ROOT

WANTED = ("sphinx", "myst_parser", "furo")


@pytest.mark.panel
@pytest.mark.campaign
@pytest.mark.skipif(
    any(find_spec(name) is None for name in WANTED),
    reason="SPHINX IS MISSING: the documentation site is not built; pip install 'invid[docs]'",
)
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "-d"]
    done = subprocess.run(
        [*command, str(tmp_path / "trees"), str(ROOT / "docs"), str(tmp_path / "site")],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    reference = (tmp_path / "site" / "reference" / "python.html").read_text(encoding="utf-8")
    # The docstrings are in it, not only the directives.
    assert 'id="invid.api.diagnose"' in reference
    assert 'id="invid.errors.SafetyStop"' in reference
