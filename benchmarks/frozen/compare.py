"""Two folders of results of bench_frozen.py side by side."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

LEFT_OUT = ("provenance.software", "provenance.recording")
"""What may differ between runs of one behaviour: the version and the path of the file. Documents hold no
time of their own; ``provenance.recorded`` is the recording's and must agree."""
DOCUMENTS = ("model.json", "diagnosis.json")
SHOWN = 6
"""Differing entries of one document that are printed."""


def normalised(document: Any, path: str = "") -> Any:
    """A document without what ``LEFT_OUT`` names, at any depth."""
    if isinstance(document, dict):
        inside = {k: normalised(v, f"{path}.{k}") for k, v in document.items()}
        return {k: v for k, v in inside.items() if not f"{path}.{k}".endswith(LEFT_OUT)}
    if isinstance(document, list):
        return [normalised(v, path) for v in document]
    return document


def compare(old: Path, new: Path) -> int:
    """Print every difference; 1 where there is one."""
    names = [{p.parent.name for p in folder.glob("*/answer.json")} for folder in (old, new)]
    both = sorted(names[0] & names[1])
    alone = len(names[0] ^ names[1])
    print(f"{len(both)} cases in both" + (f"; {alone} in one of them only, not compared" if alone else ""))
    print(f"left out of the documents: {', '.join(LEFT_OUT)}")
    counts: Counter[str] = Counter()
    cpu = [0.0, 0.0]
    for name in both:
        answers = [json.loads((f / name / "answer.json").read_text(encoding="utf-8")) for f in (old, new)]
        cpu = [c + a["cpu_s"] for c, a in zip(cpu, answers, strict=True)]
        said = list(differences(old / name, new / name, answers))
        counts["identical"] += not said
        counts.update({kind for kind, _ in said})
        for kind, text in said:
            print(f"{name}: {kind}: {text}")
    print(f"CPU {cpu[0]:.0f} s and {cpu[1]:.0f} s")
    print(
        f"{counts.pop('identical', 0)} of {len(both)} identical byte by byte" if both else "nothing compared"
    )
    for kind, number in counts.most_common():
        print(f"  {kind} differs in {number}")
    return int(bool(counts) or not both)


def differences(old: Path, new: Path, answers: list[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    """Kind and text of each difference of one case."""
    if answers[0]["status"] != answers[1]["status"]:
        yield "exit status", f"{answers[0]['status']} → {answers[1]['status']}: {answers[1]['said'][-300:]!r}"
    for name in DOCUMENTS:
        there = [(folder / name).exists() for folder in (old, new)]
        if there[0] != there[1]:
            yield "document", f"{name} is written by one only"
        if not all(there):
            continue
        a, b = (normalised(json.loads((f / name).read_text(encoding="utf-8"))) for f in (old, new))
        if json.dumps(a) == json.dumps(b):
            continue
        yield from _results(a, b)
        entries = list(_entries(a, b, ""))
        shown = "; ".join(entries[:SHOWN]) + (" …" if len(entries) > SHOWN else "")
        yield name, f"{len(entries)} entries: {shown}" if entries else "order of keys"


def _results(a: dict[str, Any], b: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """What a person sees first: verdict, cause, place, size, χ²."""
    if a.get("verdict") != b.get("verdict"):
        yield "verdict", f"{a.get('verdict')} → {b.get('verdict')}"
    places = [{_place(f): f for f in d.get("findings", [])} for d in (a, b)]
    if set(places[0]) != set(places[1]):
        lost, won = set(places[0]) - set(places[1]), set(places[1]) - set(places[0])
        causes = [{p.split(" at ")[0] for p in ps} for ps in (places[0], places[1])]
        kind = "place" if causes[0] == causes[1] else "cause"
        yield kind, f"gone: {', '.join(sorted(lost)) or '–'}; new: {', '.join(sorted(won)) or '–'}"
    for place in sorted(set(places[0]) & set(places[1])):
        for key, x in places[0][place]["parameters"].items():
            y = places[1][place]["parameters"].get(key)
            if y is None or x["value"] != y["value"]:
                value, std = (math.nan, None) if y is None else (y["value"], x["std"])
                sigma = f" ({(value - x['value']) / std:+.2g} std)" if std else ""
                yield "size", f"{place} {key}: {x['value']:.8g} → {value:.8g}{sigma}"
    before, after = (_chi2(d) for d in (a, b))
    for where in sorted(set(before) & set(after)):
        if before[where] != after[where]:
            yield "χ²", f"{where}: {before[where]:.10g} → {after[where]:.10g}"


def _place(finding: dict[str, Any]) -> str:
    spots = (finding.get("axis"), finding.get("element"), finding.get("other_axis"))
    return f"{finding['cause']} at {' '.join(s for s in spots if s)}"


def _chi2(document: Any, path: str = "") -> dict[str, float]:
    """Every number below a key that begins with chi2 or ends with it."""
    if isinstance(document, list):
        pairs = [(f"{path}[{i}]", v) for i, v in enumerate(document)]
    elif isinstance(document, dict):
        pairs = [(f"{path}.{k}".lstrip("."), v) for k, v in document.items()]
    else:
        last = path.rsplit(".", 1)[-1]
        number = isinstance(document, int | float) and not isinstance(document, bool)
        return {path: float(document)} if number and "chi2" in last else {}
    return {k: v for p, inside in pairs for k, v in _chi2(inside, p).items()}


def _entries(a: Any, b: Any, path: str) -> Iterator[str]:
    """Paths at which two documents differ, with both values."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in sorted(a.keys() | b.keys()):
            if key in a and key in b:
                yield from _entries(a[key], b[key], f"{path}.{key}".lstrip("."))
            else:
                yield f"{path}.{key} {'gone' if key in a else 'new'}".lstrip(".")
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            yield from _entries(x, y, f"{path}[{i}]")
    elif a != b and not (isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b)):
        x, y = (repr(v) if len(repr(v)) <= 60 else f"{repr(v)[:57]}…" for v in (a, b))
        yield f"{path} {x} → {y}"
