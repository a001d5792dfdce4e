"""The RO-Crate 1.1 description of a bundle: what each part is and which action made the results of what."""

from __future__ import annotations

import hashlib
import mimetypes
from collections.abc import Mapping
from typing import Any

METADATA = "ro-crate-metadata.json"
_CONTEXT = "https://w3id.org/ro/crate/1.1/context"
_KINDS = {
    "recording.h5": ("measured positions and torques", "application/x-hdf5"),
    "config.yaml": ("the cell's config at the time of measuring", "application/yaml"),
    "model.json": ("identified model", "application/json"),
    "diagnosis.json": ("what the simulation gets wrong, and the cause", "application/json"),
    "analysis.json": ("options, software and what is not in the bundle", "application/json"),
    "environment.txt": ("versions of the Python packages in use", "text/plain"),
    "requirements.lock": ("lock file of the installation", "text/plain"),
    "drives.json": ("what the drives told: identity, firmware, limits", "application/json"),
}


def crate_metadata(parts: Mapping[str, bytes], *, robot: str, made: str, software: str) -> dict[str, Any]:
    """The JSON-LD document."""
    files = [{"@id": name} for name in sorted(parts)]
    results = [{"@id": n} for n in ("model.json", "diagnosis.json")]
    graph: list[dict[str, Any]] = [
        {
            "@id": METADATA,
            "@type": "CreativeWork",
            "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"},
            "about": {"@id": "./"},
        },
        {
            "@id": "./",
            "@type": "Dataset",
            "name": f"identification of {robot or 'a robot'}",
            "description": "Measurement of a robot's drives with the model and diagnosis made of it.",
            "datePublished": made,
            "license": "not stated",
            "hasPart": files,
            "mentions": [{"@id": "#analysis"}],
        },
        {
            "@id": "#analysis",
            "@type": "CreateAction",
            "name": "identification and diagnosis",
            "endTime": made,
            "instrument": {"@id": "#software"},
            "object": [{"@id": "recording.h5"}],
            "result": results,
        },
        {"@id": "#software", "@type": "SoftwareApplication", "name": "invid", "softwareVersion": software},
    ]
    for name, content in sorted(parts.items()):
        guessed = mimetypes.guess_type(name)[0] or "application/octet-stream"
        text, media = _KINDS.get(name, (_text(name), guessed))
        graph.append(
            {
                "@id": name,
                "@type": "File",
                "name": text,
                "encodingFormat": media,
                "contentSize": str(len(content)),
                "sha256": hashlib.sha256(content).hexdigest(),
            }
        )
    return {"@context": _CONTEXT, "@graph": graph}


def _text(name: str) -> str:
    folder = name.partition("/")[0]
    return {"frames": "raw CAN frames", "eds": "electronic data sheet of a drive"}.get(folder, name)
