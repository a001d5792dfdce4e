"""Which of some EDS files is that of a drive: vendor, product and revision of 0x1018 against [DeviceInfo]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from invid.errors import InputError
from invid_drivers.eds import Declared, parse_eds

ENDINGS = (".eds", ".dcf")


@dataclass(frozen=True)
class Identity:
    """Object 0x1018 of a drive."""

    vendor_id: int
    product_code: int
    revision: int


@dataclass(frozen=True)
class Match:
    """A drive's file: ``file`` is ``None`` where none fits or several do; ``why`` is the reason in words."""

    file: Path | None
    why: str


def read_all(places: Sequence[Path]) -> tuple[list[Declared], list[str]]:
    """Every EDS or DCF file named, or below a folder named, and a sentence for each that does not parse.

    Raises
    ------
    InputError
        A place that is not there, or a folder without such files.
    """
    found: list[Declared] = []
    refused: list[str] = []
    for place in places:
        if not place.exists():
            raise InputError(f"--eds {place}: no such file or folder")
        files = [place]
        if place.is_dir():
            files = sorted(p for p in place.rglob("*") if p.suffix.lower() in ENDINGS and p.is_file())
        if not files:
            raise InputError(f"--eds {place}: holds no file that ends in {' or '.join(ENDINGS)}")
        for file in files:
            try:
                found.append(parse_eds(file, 1))
            except OSError as error:
                refused.append(f"{file}: cannot be read ({error.strerror})")
            except ValueError as error:
                refused.append(f"{file}: {error}")
    return found, refused


def match(identity: Identity, files: Sequence[Declared]) -> Match:
    """The file for a drive.

    The revision's upper 16 bits count changes of CANopen behaviour, the lower ones what does not touch it
    (CiA 301, object 0x1018): another lower part is taken, another upper part is not.
    """
    if not identity.vendor_id:
        return Match(None, "the drive's vendor id (0x1018:1) is 0: no file can be told to be its own")
    same = [f for f in files if (f.vendor_id, f.product_code) == (identity.vendor_id, identity.product_code)]
    who = f"vendor 0x{identity.vendor_id:08X}, product 0x{identity.product_code:08X}"
    if not same:
        return Match(None, f"no EDS given is of {who}; its vendor's site has it")
    exact = [f for f in same if f.revision == identity.revision]
    major = [f for f in same if f.revision is not None and f.revision >> 16 == identity.revision >> 16]
    unsaid = [f for f in same if f.revision is None]
    for candidates, why in (
        (exact, f"vendor, product and revision 0x{identity.revision:08X} are the drive's"),
        (major, f"vendor and product are the drive's; its revision 0x{identity.revision:08X} differs in the "
                "lower half, which does not touch CANopen"),
        (unsaid, "vendor and product are the drive's; the file states no revision"),
    ):  # fmt: skip
        if len(candidates) == 1:
            return Match(candidates[0].path, why)
        if candidates:
            names = ", ".join(f.path.name for f in candidates)
            return Match(None, f"{names} fit equally ({why}): name the right one")
    stated = ", ".join(f"{f.path.name} 0x{f.revision:08X}" for f in same if f.revision is not None)
    return Match(
        None,
        f"the drive's revision is 0x{identity.revision:08X}, another CANopen behaviour than that of "
        f"{stated}: get the file of its firmware",
    )
