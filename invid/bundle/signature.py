"""Ed25519 keys and signatures (package ``cryptography``)."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

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
    """Whether this key signed this content."""
    try:
        key.verify(signature, content)
    except InvalidSignature:
        return False
    return True


def key_in(text: str, where: str) -> Ed25519PublicKey:
    """A public key from PEM text."""
    return _public(text.encode(), where)


def _public(content: bytes, where: str) -> Ed25519PublicKey:
    try:
        key = load_pem_public_key(content)
    except (ValueError, TypeError) as error:
        raise InputError(f"{where}: no public key can be read from it: {error}") from None
    if not isinstance(key, Ed25519PublicKey):
        raise InputError(f"{where}: is a key of another kind; an Ed25519 key is needed")
    return key
