"""`make check` refuses scars and dead ends in the docs, and the site is not built with a conflict marker."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from pages import ROOT

from scripts.check_docs import complaints

MARKERS = "\n".join(["<" * 7 + " HEAD", "one", "=" * 7, "two", ">" * 7 + " branch", ""])
SOUND = """# One page

See [below](#a-part-of-it), [the other](other.md#other-part) and `tests/there.py`.

## A part of it

```sh
python tests/there.py     # [no](link.md) in code
```
"""


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A repository with two sound pages and a file that they name."""
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "there.py").write_text("", encoding="utf-8")
    (tmp_path / "page.md").write_text(SOUND, encoding="utf-8")
    (tmp_path / "other.md").write_text("# Other\n\n### Other part\n", encoding="utf-8")
    return tmp_path


def test_sound_pages_pass(repository: Path) -> None:
    assert complaints(repository) == []


@pytest.mark.parametrize(
    ("file", "text", "told"),
    [
        ("other.py", MARKERS, ["other.py:1: conflict", "other.py:3: conflict", "other.py:5: conflict"]),
        ("page.md", "[gone](gone.md)\n", ["page.md:1: no file gone.md"]),
        ("page.md", "\n[gone](other.md#gone)\n", ["page.md:2: no heading #gone in other.md"]),
        ("page.md", "[gone](#gone)\n", ["page.md:1: no heading #gone in page.md"]),
        ("page.md", "# One\n\n```sh\npython\n", ["page.md:3: this code block is never closed"]),
        ("page.md", "```sh\npython tests/gone.py\n```\n", ["page.md: no file tests/gone.py"]),
        ("page.md", "Run `bench_gone.py --runs 3`.\n", ["page.md: no file bench_gone.py"]),
    ],
)
def test_what_leads_nowhere_is_named_with_its_place(
    repository: Path, file: str, text: str, told: list[str]
) -> None:
    (repository / file).write_text(text, encoding="utf-8")
    found = complaints(repository)
    assert len(found) == len(told)
    for complaint, beginning in zip(found, told, strict=True):
        assert complaint.startswith(beginning)


@pytest.mark.campaign
@pytest.mark.skipif(find_spec("myst_parser") is None, reason="SPHINX IS MISSING: pip install 'invid[docs]'")
def test_the_site_with_a_conflict_marker_is_not_built(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text(f"# Page\n\n{MARKERS}", encoding="utf-8")
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", "-c", str(ROOT / "docs")]
    done = subprocess.run(
        [*command, str(tmp_path / "docs"), str(tmp_path / "site")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "index.md:3: WARNING: conflict marker" in done.stderr
