"""The file: a ZIP of parts, ``manifest.json`` with each one's size and SHA-256, ``signature.json`` (Ed25519)
over the manifest.

Reading refuses a file that is cut, and parts that are altered, missing, added or there twice, by their
names.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)

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
        signer = _public(given["public_key"].encode(), f"{path}: {SIGNATURE}")
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


def private_key(path: Path) -> tuple[Ed25519PrivateKey, bool]:
    """The key in a PEM file, made there for its owner alone where there is none; True where it was made."""
    if not path.exists():
        made = Ed25519PrivateKey.generate()
        text = made.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
                file.write(text)
            Path(f"{path}.pub").write_text(public_text(made.public_key()), encoding="ascii")
        except OSError as error:
            raise InputError(f"{path}: the key cannot be written: {error.strerror}") from None
        return made, True
    try:
        key = load_pem_private_key(path.read_bytes(), password=None)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{path}: no private key without a password can be read from it: {error}") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError(f"{path}: is no Ed25519 key; openssl genpkey -algorithm ed25519 makes one")
    return key, False


def public_key(path: Path) -> Ed25519PublicKey:
    """The key in a PEM file."""
    try:
        return _public(path.read_bytes(), str(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def public_text(key: Ed25519PublicKey) -> str:
    """PEM of a public key."""
    pem: bytes = key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    return pem.decode("ascii")


def fingerprint(key: Ed25519PublicKey) -> str:
    """SHA-256 of the raw key, in hexadecimal: what two people compare."""
    return hashlib.sha256(key.public_bytes(Encoding.Raw, PublicFormat.Raw)).hexdigest()


def is_signed(content: bytes, signature: bytes, key: Ed25519PublicKey) -> bool:
    """Return whether this key signed this content."""
    try:
        key.verify(signature, content)
    except InvalidSignature:
        return False
    return True


def _public(content: bytes, where: str) -> Ed25519PublicKey:
    try:
        key = load_pem_public_key(content)
    except (ValueError, TypeError) as error:
        raise InputError(f"{where}: no public key can be read from it: {error}") from None
    if not isinstance(key, Ed25519PublicKey):
        raise InputError(f"{where}: is a key of another kind; an Ed25519 key is needed")
    return key
