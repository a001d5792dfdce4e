"""Refuse what no reader may meet: conflict markers, and links, anchors and code blocks that lead nowhere.

    python scripts/check_docs.py          (part of `make check`; needs nothing but Python and git)

Markers are looked for in every file of the repository. Of every Markdown page: relative links and their
anchors, fences that are not closed, and in code the files of this repository that it names. Whether a command
is one that `invid` takes, and whether a Python block runs, is for `tests/docs/test_blocks.py`.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from urllib.parse import unquote

ROOT = Path(__file__).resolve().parents[1]
MARKER = re.compile(r"^(?:<{7}(?: .*)?|\|{7}(?: .*)?|={7}|>{7}(?: .*)?)$")
_FENCE = re.compile(r"^ {0,3}(`{3,}|~{3,})")
_CODE = re.compile(r"(`+)(.+?)\1(?!`)", re.DOTALL)
_LINK = re.compile(r"\[[^\]]*\]\(\s*<?([^)\s>]+)")
_FOLDERS = "benchmarks|configs|deploy|docs|drivers|invid|scripts|service|tests"
_KINDS = "py|sh|md|ya?ml|ipynb|service"
_NAMED = re.compile(rf"(?<![\w./-])((?:{_FOLDERS})/[\w./-]*\w\.(?:{_KINDS})|bench_\w+\.py)\b")


def marker_lines(text: str) -> list[int]:
    """Return the numbers of the lines that a merge left behind."""
    return [n for n, line in enumerate(text.splitlines(), 1) if MARKER.match(line)]


def repository_files(root: Path) -> list[str]:
    """Return the files that git has or would take, relative to ``root``."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout
    return sorted(name for name in set(listed.split("\0")) if name and (root / name).is_file())


def markers(root: Path, files: list[str]) -> Iterator[str]:
    """Yield a complaint for each conflict marker in a text file."""
    for name in files:
        content = (root / name).read_bytes()
        if b"\0" not in content:
            for number in marker_lines(content.decode("utf-8", errors="replace")):
                yield f"{name}:{number}: conflict marker"


def prose_and_code(text: str) -> tuple[str, str, int | None]:
    """Split a page into prose and code of the same lines; last, the line of a fence that is never closed."""
    prose, code, fence, opened = [], [], "", None
    for number, line in enumerate(text.splitlines(), 1):
        found = _FENCE.match(line)
        if fence:
            ends = found is not None and found[1].startswith(fence) and not line.strip().strip(fence[0])
            prose.append("")
            code.append("" if ends else line)
            fence = "" if ends else fence
        elif found:
            fence, opened = found[1], number
            prose.append("")
            code.append("")
        else:
            prose.append(line)
            code.append("")
    inline = "\n".join(prose)
    named = "\n".join(code) + "\n" + "\n".join(words for _, words in _CODE.findall(inline))
    plain = _CODE.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), inline)
    return plain, named, opened if fence else None


@cache
def anchors(page: Path) -> frozenset[str]:
    """Return the anchors of a page's headings, as forges and the site make them."""
    text, found = page.read_text(encoding="utf-8"), []
    without_code = re.sub(r"^(```|~~~).*?^\1", "", text, flags=re.MULTILINE | re.DOTALL)
    for title in re.findall(r"^#{1,6} +(.+?)(?: +#+)?$", without_code, re.MULTILINE):
        shown = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title)
        slug = re.sub(r"[^\w\- ]", "", shown.strip().lower()).replace(" ", "-")
        found.append(slug if slug not in found else f"{slug}-{found.count(slug)}")
    return frozenset(found) | frozenset(re.findall(r"^\(([\w-]+)\)=$", text, re.MULTILINE))


def links(root: Path, name: str, prose: str) -> Iterator[str]:
    """Yield a complaint for each relative link of a page whose file or heading is not there."""
    for number, line in enumerate(prose.splitlines(), 1):
        for target in _LINK.findall(line):
            if re.match(r"[a-z][a-z0-9+.-]*:", target):
                continue
            path, _, anchor = unquote(target).partition("#")
            page = (root / name).parent / path if path else root / name
            if not page.exists():
                yield f"{name}:{number}: no file {path}"
            elif anchor and page.suffix == ".md" and anchor not in anchors(page.resolve()):
                yield f"{name}:{number}: no heading #{anchor} in {path or name}"


def named_files(name: str, code: str, files: list[str]) -> Iterator[str]:
    """Yield a complaint for each file of this repository that code names and that is not there."""
    known = set(files) | {Path(f).name for f in files}
    for named in sorted(set(_NAMED.findall(code))):
        if named not in known:
            yield f"{name}: no file {named}"


def complaints(root: Path) -> list[str]:
    """Return everything that is wrong, a line each."""
    files = repository_files(root)
    found = list(markers(root, files))
    for name in (f for f in files if f.endswith(".md")):
        prose, code, opened = prose_and_code((root / name).read_text(encoding="utf-8"))
        found += [f"{name}:{opened}: this code block is never closed"] if opened else []
        found += links(root, name, prose)
        found += named_files(name, code, files)
    return found


def words(root: Path) -> int:
    """Return how many words README, CONTRIBUTING and docs ask a reader to read: without code blocks."""
    pages = [n for n in repository_files(root) if re.fullmatch(r"(README|CONTRIBUTING|docs/.*)\.md", n)]
    texts = ((root / name).read_text(encoding="utf-8") for name in pages)
    shown = (re.sub(r"^(```|~~~).*?^\1", "", text, flags=re.MULTILINE | re.DOTALL) for text in texts)
    return sum(1 for text in shown for word in text.split() if re.search(r"\w", word))


if __name__ == "__main__":
    wrong = complaints(ROOT)
    print(
        "\n".join(wrong)
        if wrong
        else "no conflict markers, and every link, anchor and file of the docs is there; "
        f"{words(ROOT):,} words of docs"
    )
    sys.exit(1 if wrong else 0)
