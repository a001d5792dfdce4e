"""The file: a ZIP of parts, ``manifest.json`` with each one's size and SHA-256, ``signature.json`` over the
manifest.

Reading refuses a file that is cut, and parts that are altered, missing, added or there twice, by their names.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from invid.bundle.signature import fingerprint, is_signed, key_in, public_key, public_text
from invid.errors import InputError

MANIFEST, SIGNATURE = "manifest.json", "signature.json"
LARGEST = 8_000_000_000
"""Bytes that all parts may unpack to: a day of eight axes at 1 kHz."""


@dataclass(frozen=True)
class Archive:
    """Parts that are what was signed; ``signer`` the fingerprint of the key, ``trusted`` where it was asked
    for."""

    parts: Mapping[str, bytes]
    signer: str
    trusted: bool


def write_archive(path: Path, parts: Mapping[str, bytes], key: Ed25519PrivateKey) -> None:
    """Write the parts, their manifest and its signature."""
    manifest = {
        "format": "invid-bundle-manifest",
        "format_version": 1,
        "parts": {name: _entry(content) for name, content in sorted(parts.items())},
    }
    signed = json.dumps(manifest, indent=2, ensure_ascii=False).encode() + b"\n"
    signature = {
        "algorithm": "Ed25519",
        "signs": MANIFEST,
        "public_key": public_text(key.public_key()),
        "signature": base64.b64encode(key.sign(signed)).decode("ascii"),
    }
    temporary = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as file:
            for name, content in sorted(parts.items()):
                file.writestr(name, content)
            file.writestr(MANIFEST, signed)
            file.writestr(SIGNATURE, json.dumps(signature, indent=2) + "\n")
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


def read_archive(path: Path, trust: Path | None = None) -> Archive:
    """The parts, where all of them are what was signed.

    Raises
    ------
    InputError
        Names the part that is not: ``{path}: {part}: …``; or that another key than that in ``trust`` signed.
    """
    found = _unpacked(path)
    for needed in (MANIFEST, SIGNATURE):
        if needed not in found:
            raise InputError(f"{path}: {needed}: is missing; this is no bundle of invid, or it was altered")
    given = _json(found[SIGNATURE], path, SIGNATURE)
    try:
        signer = key_in(given["public_key"], f"{path}: {SIGNATURE}")
        signature = base64.b64decode(given["signature"], validate=True)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: {SIGNATURE}: holds no key and signature") from None
    if not is_signed(found[MANIFEST], signature, signer):
        raise InputError(f"{path}: {MANIFEST}: is not what was signed: it or the signature was altered")
    if trust is not None and fingerprint(public_key(trust)) != fingerprint(signer):
        raise InputError(
            f"{path}: {SIGNATURE}: was signed by the key {fingerprint(signer)[:16]}…, not by that in {trust}"
        )
    listed = _json(found[MANIFEST], path, MANIFEST).get("parts")
    if not isinstance(listed, dict):
        raise InputError(f"{path}: {MANIFEST}: lists no parts")
    for name, entry in listed.items():
        if name not in found:
            raise InputError(f"{path}: {name}: is missing")
        if entry != _entry(found[name]):
            raise InputError(f"{path}: {name}: is not what was signed: it was altered")
    added = sorted(found.keys() - listed.keys() - {MANIFEST, SIGNATURE})
    if added:
        raise InputError(f"{path}: {added[0]}: was added after the bundle was signed")
    return Archive({name: found[name] for name in listed}, fingerprint(signer), trust is not None)


def _unpacked(path: Path) -> dict[str, bytes]:
    try:
        with zipfile.ZipFile(path) as file:
            entries = file.infolist()
            if sum(e.file_size for e in entries) > LARGEST:
                raise InputError(f"{path}: unpacks to more than {LARGEST / 1e9:g} GB: no measurement does")
            found: dict[str, bytes] = {}
            for entry in entries:
                if entry.filename in found:
                    raise InputError(f"{path}: {entry.filename}: is there twice")
                try:
                    found[entry.filename] = file.read(entry)
                except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
                    raise InputError(f"{path}: {entry.filename}: is damaged: {error}") from None
    except zipfile.BadZipFile:
        raise InputError(f"{path}: its end is missing: the file was cut, or is no bundle") from None
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: cannot be read: {error}") from None
    return found


def _json(content: bytes, path: Path, name: str) -> dict[str, Any]:
    try:
        document = json.loads(content)
    except ValueError:
        document = None
    if not isinstance(document, dict):
        raise InputError(f"{path}: {name}: is no JSON document")
    return document


def _entry(content: bytes) -> dict[str, Any]:
    return {"size": len(content), "sha256": hashlib.sha256(content).hexdigest()}
