"""Bill of materials (CycloneDX 1.5) and licences of what the product runs on, as requirements.lock pins it.

    python scripts/bill-of-materials.py [FOLDER]      (default: build; writes sbom.json and licences.md)

What it runs on, and the licences, are what the installed packages say of themselves: run it where the
image's extras are installed. A package that is not installed here (another system's), or in another version,
is listed without a licence and said.
"""

from __future__ import annotations

import json
import re
import sys
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "requirements.lock"
IMAGE = "invid[postgres,slcan,gs-usb]"
"""What the Dockerfile installs."""
_PIN = re.compile(r"^(?P<name>[A-Za-z0-9._-]+)==(?P<version>[^\s;]+)\s*(?:;\s*(?P<marker>.+))?$")


@dataclass(frozen=True)
class Package:
    """One line of the lock; ``licence`` "" where no package of that version is installed here."""

    name: str
    version: str
    marker: str
    licence: str


def packages(lock: str) -> list[Package]:
    """All pins, with the licence of those that are installed."""
    found = []
    for line in lock.splitlines():
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        pin = _PIN.match(text)
        if pin is None:
            raise SystemExit(f"{LOCK.name}: {text!r} is no pin of a version")
        found.append(
            Package(pin["name"], pin["version"], pin["marker"] or "", licence(pin["name"], pin["version"]))
        )
    return found


def needed(wanted: str) -> set[str]:
    """Return the canonical names of what ``wanted`` needs, at any depth, on whatever system."""
    names: set[str] = set()
    seen: set[tuple[str, str]] = set()
    ahead = [Requirement(wanted)]
    while ahead:
        here = ahead.pop()
        name = canonicalize_name(here.name)
        names.add(name)
        for extra in {"", *here.extras} - {e for n, e in seen if n == name}:
            seen.add((name, extra))
            try:
                required = [Requirement(r) for r in metadata.requires(name) or []]
            except metadata.PackageNotFoundError:
                continue
            ahead += [
                r
                for r in required
                if ("extra" in str(r.marker) and r.marker is not None and r.marker.evaluate({"extra": extra}))
                or (extra == "" and "extra" not in str(r.marker))
            ]
    return names


def licence(name: str, version: str) -> str:
    """What the installed package says: SPDX expression, classifiers, or the first line of its licence."""
    try:
        told = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return ""
    if told["Version"] != version:
        return ""
    if told.get("License-Expression"):
        return str(told["License-Expression"])
    classified = [
        c.rpartition(" :: ")[2]
        for c in told.get_all("Classifier", [])
        if c.startswith("License ::") and not c.endswith("OSI Approved")
    ]
    if classified:
        return " AND ".join(sorted(set(classified)))
    text = str(told.get("License") or "").strip()
    return text.splitlines()[0][:60] if text else "not stated"


def bill_of_materials(listed: list[Package], version: str) -> dict[str, Any]:
    """The CycloneDX document."""
    components = []
    for p in listed:
        component: dict[str, Any] = {
            "type": "library",
            "bom-ref": f"pkg:pypi/{p.name.lower()}@{p.version}",
            "name": p.name,
            "version": p.version,
            "purl": f"pkg:pypi/{p.name.lower()}@{p.version}",
        }
        if p.licence and p.licence != "not stated":
            component["licenses"] = [{"license": {"name": p.licence}}]
        if p.marker:
            component["properties"] = [{"name": "python:environment-marker", "value": p.marker}]
        components.append(component)
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {
            "component": {"type": "application", "bom-ref": "invid", "name": "invid", "version": version}
        },
        "components": components,
    }


def licences(listed: list[Package]) -> str:
    """The list for a person, with the browser's library that the page brings along."""
    lines = ["# Licences of what invid runs on", "", "| package | version | licence |", "| --- | --- | --- |"]
    for p in listed:
        where = f" ({p.marker})" if p.marker else ""
        lines.append(f"| {p.name}{where} | {p.version} | {p.licence or 'not installed here'} |")
    lines.append("| uPlot (in the page) | as in service/invid_service/web/static/vendor | MIT |")
    return "\n".join(lines) + "\n"


def main(arguments: list[str]) -> int:
    """Write both files; says what has no licence."""
    folder = Path(arguments[0] if arguments else "build")
    folder.mkdir(parents=True, exist_ok=True)
    image = needed(IMAGE)
    listed = [p for p in packages(LOCK.read_text(encoding="utf-8")) if canonicalize_name(p.name) in image]
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    version = re.search(r'^version = "(.+)"$', project, re.MULTILINE)
    document = bill_of_materials(listed, version[1] if version else "")
    (folder / "sbom.json").write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    (folder / "licences.md").write_text(licences(listed), encoding="utf-8")
    for p in listed:
        if not p.licence or p.licence == "not stated":
            why = "is not installed here in this version" if not p.licence else "does not state its licence"
            print(f"{p.name} {p.version} {why}", file=sys.stderr)
    print(f"{len(listed)} packages: {folder / 'sbom.json'}, {folder / 'licences.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
