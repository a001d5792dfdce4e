"""Everything that a result rests on, in one signed file, with its RO-Crate 1.1 description."""

from __future__ import annotations

import hashlib
import json
import mimetypes
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import yaml

from invid import __version__
from invid.api import diagnose, identify, read_recording
from invid.bundle.archive import fingerprint, private_key, write_archive
from invid.errors import InputError
from invid.model.diagnosis_document import diagnosis_to_json, load_diagnosis
from invid.model.document import dump_json, load_model, model_to_json

RECORDING, MODEL, DIAGNOSIS, ANALYSIS = "recording.h5", "model.json", "diagnosis.json", "analysis.json"
ENVIRONMENT = "environment.txt"


@dataclass(frozen=True)
class Evidence:
    """Files that go in beside the recording; ``None`` and empty: there are none."""

    model: Path | None = None
    diagnosis: Path | None = None
    lock: Path | None = None
    drives: Path | None = None
    frames: Sequence[Path] = ()
    eds: Sequence[Path] = ()


@dataclass(frozen=True)
class Bundled:
    """What was written, who signed it, and what is not in it."""

    path: str
    parts: tuple[str, ...]
    signer: str
    key_made: bool
    missing: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The document of ``invid bundle --json``."""
        return {
            "output": self.path,
            "parts": list(self.parts),
            "signer": self.signer,
            "key_made": self.key_made,
            "missing": list(self.missing),
            "warnings": [],
        }


def make_bundle(
    recording: Path,
    output: Path,
    key: Path,
    evidence: Evidence,
    *,
    masses: Sequence[int] | str | None = None,
    method: str = "refined",
) -> Bundled:
    """Pack a recording with its results, worked out here where they are not given, and sign it.

    ``masses`` and ``method`` are those of ``invid.identify``; a replay uses the same.
    """
    data = read_recording(recording)
    parts = {RECORDING: _read(recording)}
    if data.config is not None:
        parts["config.yaml"] = data.config.encode()
    named = replace(data, source=RECORDING)
    if evidence.model is not None:
        model = load_model(evidence.model)
        parts[MODEL] = _read(evidence.model)
    else:
        model = identify(named, masses=masses, method=method)  # type: ignore[arg-type]
        parts[MODEL] = dump_json(model_to_json(model)).encode()
    if evidence.diagnosis is not None:
        load_diagnosis(evidence.diagnosis)
        parts[DIAGNOSIS] = _read(evidence.diagnosis)
    else:
        parts[DIAGNOSIS] = dump_json(diagnosis_to_json(diagnose(named, model=model))).encode()
    for name, path in (("requirements.lock", evidence.lock), ("drives.json", evidence.drives)):
        if path is not None:
            parts[name] = _read(path)
    for folder, paths in (("frames", evidence.frames), ("eds", evidence.eds)):
        for path in paths:
            name = f"{folder}/{path.name}"
            if name in parts:
                raise InputError(f"{path}: another file called {path.name} goes into the bundle already")
            parts[name] = _read(path)
    parts[ENVIRONMENT] = environment().encode()
    missing = _missing(data.config, parts)
    made = datetime.now(UTC).isoformat(timespec="seconds")
    analysis = {
        "format": "invid-bundle",
        "format_version": 1,
        "software": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "created": made,
        "masses": list(masses) if isinstance(masses, Sequence) and not isinstance(masses, str) else masses,
        "method": method,
        "missing": missing,
    }
    parts[ANALYSIS] = dump_json(analysis).encode()
    crate = crate_metadata(parts, robot=data.robot, made=made, software=__version__)
    parts[METADATA] = (json.dumps(crate, indent=2, ensure_ascii=False) + "\n").encode()
    secret, key_made = private_key(key)
    write_archive(output, parts, secret)
    return Bundled(
        str(output), tuple(sorted(parts)), fingerprint(secret.public_key()), key_made, tuple(missing)
    )


def environment() -> str:
    """``name==version`` of every Python package here, a line each."""
    found = {(d.metadata["Name"] or "").lower(): d.version for d in metadata.distributions()}
    return "".join(f"{name}=={version}\n" for name, version in sorted(found.items()) if name)


def _missing(config: str | None, parts: dict[str, bytes]) -> list[str]:
    """What evidence would have and this has not, in words."""
    missing = []
    if not any(name.startswith("frames/") for name in parts):
        missing.append("raw CAN frames (--frames, a candump log beside the measurement)")
    if "drives.json" not in parts:
        missing.append("identity and firmware of the drives (--drives, what invid check CONFIG --json says)")
    if "requirements.lock" not in parts:
        missing.append("the lock file of the installation (--lock)")
    if config is None:
        missing.append("the cell's config, which the recording does not carry")
        return missing
    try:
        axes = yaml.safe_load(config)["axes"]
        sheets = {Path(a["eds"]).name for a in axes if a.get("eds")}
    except (yaml.YAMLError, KeyError, TypeError, AttributeError):
        sheets = set()
    missing += [f"the EDS {s} (--eds)" for s in sorted(sheets) if f"eds/{s}" not in parts]
    return missing


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


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
