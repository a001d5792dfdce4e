"""Two folders of results of bench_frozen.py side by side."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

LEFT_OUT = ("provenance.software", "provenance.recording")
"""What may differ between runs of one behaviour: the version and the path of the file. Documents hold no
time of their own; ``provenance.recorded`` is the recording's and must agree."""
DOCUMENTS = ("model.json", "diagnosis.json")
SHOWN = 6
"""Differing entries of one kind that are printed of a case."""


def flat(document: Any, path: str = "") -> dict[str, Any]:
    """Every entry of a document by its path; a finding by its cause and place, not by its number."""
    if isinstance(document, dict):
        pairs = [(f"{path}.{k}".lstrip("."), v) for k, v in document.items()]
    elif isinstance(document, list):
        pairs = [(f"{path}[{_place(v) or i}]", v) for i, v in enumerate(document)]
    else:
        return {path: document}
    return {k: v for p, inside in pairs if not p.endswith(LEFT_OUT) for k, v in flat(inside, p).items()}


def _place(entry: Any) -> str:
    if not isinstance(entry, dict) or "cause" not in entry:
        return ""
    return " ".join(str(entry[k]) for k in ("cause", "axis", "element", "other_axis") if entry.get(k))


def differences(old: Path, new: Path) -> Iterator[tuple[str, str]]:
    """Kind and text of every entry that differs between the documents of one case."""
    for name in DOCUMENTS:
        a, b = (
            flat(json.loads((f / name).read_text(encoding="utf-8"))) if (f / name).exists() else {}
            for f in (old, new)
        )
        for path in sorted(a.keys() | b.keys()):
            x, y = (repr(d[path]) if path in d else "–" for d in (a, b))
            if x != y:
                yield _kind(path, "–" in (x, y)), f"{name} {path}: {x[:60]} → {y[:60]}"


def _kind(path: str, gone: bool) -> str:
    """What a person sees first has a name of its own."""
    if "chi2" in path.rsplit(".", 1)[-1]:
        return "χ²"
    if path.startswith("findings[") and (gone or ".parameters." in path):
        return "cause or place" if gone else "size"
    return "verdict" if path == "verdict" else "other entries"


def compare(old: Path, new: Path) -> int:
    """Print every difference; 1 where there is one."""
    names = [{p.parent.name for p in folder.glob("*/answer.json")} for folder in (old, new)]
    both, counts, cpu = sorted(names[0] & names[1]), Counter[str](), [0.0, 0.0]
    for name in both:
        said: dict[str, list[str]] = defaultdict(list)
        for kind, text in differences(old / name, new / name):
            said[kind].append(text)
        answers = [json.loads((f / name / "answer.json").read_text(encoding="utf-8")) for f in (old, new)]
        cpu = [c + a["cpu_s"] for c, a in zip(cpu, answers, strict=True)]
        if answers[0]["status"] != answers[1]["status"]:
            ends = f"{answers[0]['status']} → {answers[1]['status']}: {answers[1]['said'][-300:]!r}"
            said["exit status"].append(ends)
        for kind, texts in said.items():
            more = f" … ({len(texts)})" if len(texts) > SHOWN else ""
            print(f"{name}: {kind}: {'; '.join(texts[:SHOWN])}{more}")
        counts.update(said.keys() or ["identical"])
    print(f"left out of the documents: {', '.join(LEFT_OUT)}; CPU {cpu[0]:.0f} s and {cpu[1]:.0f} s")
    print(f"{counts.pop('identical', 0)} of {len(both)} identical; {len(names[0] ^ names[1])} not compared")
    for kind, number in counts.most_common():
        print(f"  {kind} differs in {number}")
    return int(bool(counts) or not both)
