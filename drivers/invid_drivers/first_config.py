"""The config that ``invid init`` writes: what each drive says, which EDS file is its own, what nobody
but a person knows, and why."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from invid.config.schema import BusConfig
from invid.errors import InputError
from invid.planning import bus_load
from invid.planning.budget import shortest_cycle
from invid_drivers.cia402.stated.scales import Count, agree, in_words
from invid_drivers.cia402.stated.vendors import VENDORS
from invid_drivers.eds import Declared, parse_eds

ENDINGS = (".eds", ".dcf")
MAX_LOAD = 0.8
CYCLES = (0.001, 0.002, 0.004, 0.01, 0.02)


@dataclass(frozen=True)
class Found:
    """A node that answered; 0 and "" where it does not say."""

    node_id: int
    device_type: int
    vendor_id: int
    product_code: int
    rated_torque: float
    modes: int
    revision: int = 0
    name: str = ""
    counts: tuple[Count, ...] = ()
    """What it says of a count of 0x6064, of a rotary axis."""
    watches: bool = True
    """Whether it has 0x1016, by which it notices that its master has died."""

    @property
    def is_drive(self) -> bool:
        """Whether it says that it is a CiA 402 drive."""
        return self.device_type & 0xFFFF == 402


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


def match(node: Found, files: Sequence[Declared]) -> Match:
    """The file for a drive.

    The revision's upper 16 bits count changes of CANopen behaviour, the lower ones what does not touch it
    (CiA 301, object 0x1018): another lower part is taken, another upper part is not.
    """
    if not node.vendor_id:
        return Match(None, "the drive's vendor id (0x1018:1) is 0: no file can be told to be its own")
    same = [f for f in files if (f.vendor_id, f.product_code) == (node.vendor_id, node.product_code)]
    who = f"vendor 0x{node.vendor_id:08X}, product 0x{node.product_code:08X}"
    if not same:
        return Match(None, f"no EDS given is of {who}; its vendor's site has it")
    exact = [f for f in same if f.revision == node.revision]
    major = [f for f in same if f.revision is not None and f.revision >> 16 == node.revision >> 16]
    unsaid = [f for f in same if f.revision is None]
    for candidates, why in (
        (exact, f"vendor, product and revision 0x{node.revision:08X} are the drive's"),
        (major, f"vendor and product are the drive's; its revision 0x{node.revision:08X} differs in the "
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
        f"the drive's revision is 0x{node.revision:08X}, another CANopen behaviour than that of "
        f"{stated}: get the file of its firmware",
    )


def vendor_row(name: str) -> str | None:
    """Row of the table of vendors for a drive that calls itself so (0x1008); ``None`` where none is plain."""
    said = re.sub(r"[^a-z0-9]", "", name.lower())
    fits = [key for key, row in VENDORS.items() if key != "generic" and _short(row.name) in said]
    return fits[0] if len(fits) == 1 else None


def _short(name: str) -> str:
    # The product alone: "Elmo Gold" calls itself "Gold".
    return re.sub(r"[^a-z0-9]", "", name.split()[-1].lower())


@dataclass(frozen=True)
class FirstConfig:
    """YAML with a comment on each line, and what a person must say, by key."""

    text: str
    asked: dict[str, str]


def first_config(
    bus: BusConfig,
    nodes: Sequence[Found],
    round_trip_s: float = 0.0,
    matches: Sequence[Match] = (),
    beside: Path = Path(),
) -> FirstConfig:
    """A config for the drives found; limits are timid and to be set by a person.

    Parameters
    ----------
    round_trip_s
        The adapter's, 99 %; the cycle is the shortest that it and the bus load carry.
    matches
        The EDS of each node; none: no file was given.
    beside
        Folder of the config: files below it are named from there.
    """
    asked = {"robot": "what it is called in reports", "motion": "rotary or linear"}
    cycle = _cycle(len(nodes), bus.bitrate_bit_per_s, round_trip_s)
    why = "of bus load" + (
        f" and the adapter's round trip, {round_trip_s * 1e3:.2g} ms (99 %)" * (round_trip_s > 0)
    )
    lines = [
        "# Written by `invid init`. Check every limit before anything moves. ASK: only you know.",
        "format: invid-config",
        "format_version: 1",
        "robot: unnamed          # ASK: its name in reports",
        "motion: rotary          # ASK: rotary, or linear (m and N instead of rad and N·m)",
        "bus:",
        f"  interface: {bus.interface}",
        f"  channel: {bus.channel}",
        f"  bitrate_bit_per_s: {bus.bitrate_bit_per_s}  # as given; a wrong one stops all traffic",
        f"  cycle_s: {cycle:g}  # the shortest carried, because {why}",
        "axes:                   # in the order of node ids",
    ]
    for n, node in enumerate(nodes, start=1):
        lines += _axis(f"A{n}", node, matches[n - 1] if matches else None, beside, asked)
    return FirstConfig("\n".join(lines) + "\n", asked)


def _axis(name: str, node: Found, file: Match | None, beside: Path, asked: dict[str, str]) -> list[str]:
    row = vendor_row(node.name)
    lines = [
        f"  - name: {name}",
        f"    node_id: {node.node_id}          # {_who(node)}",
    ]
    if file is None:
        lines.append(
            "    # eds:              # none was given: the drive is asked for everything (--eds FOLDER)"
        )
    elif file.file is None:
        lines.append(f"    # eds:              # ASK: {file.why}")
        asked[f"{name} eds"] = file.why
    else:
        lines.append(f"    eds: {_quoted(_from(beside, file.file))}  # {file.why}")
    if row is not None:
        lines.append(
            f"    vendor: {row}      # it calls itself {_plain(node.name)!r}: row of docs/reference/drives.md"
        )
        if VENDORS[row].advice:
            lines.append(f"                        # {VENDORS[row].advice}")
    else:
        lines.append(
            "    vendor: generic     # ASK: a row of docs/reference/drives.md, where its vendor has one"
        )
        asked[f"{name} vendor"] = "a row of docs/reference/drives.md, where its vendor has one"
    if node.rated_torque > 0:
        lines.append(
            f"    # rated_torque_Nm: {node.rated_torque:g}  # the drive's (0x6076): compare with the plate"
        )
    else:
        lines.append("    rated_torque_Nm: 1  # ASK: 0x6076 is missing or 0; from the plate")
        asked[f"{name} rated_torque_Nm"] = "from the motor's plate: 0x6076 is missing or 0"
    key = "position_rad_per_count"
    if node.counts and agree(node.counts):
        said = " and ".join(node.counts[0].objects)
        lines.append(f"    # {key}: {node.counts[0].value:.6g}  # {said}, at the motor")
    else:
        why = (
            f"the drive contradicts itself: {in_words(node.counts)}"
            if node.counts
            else ("0x608F is missing or 0; 2π / counts a turn of the motor")
        )
        lines.append(f"    # {key}:  # ASK: {why}")
        asked[f"{name} {key}"] = why
    if not node.modes >> 9 & 1:
        asked[f"{name} modes"] = "0x6502 does not list cyclic torque (bit 9): see docs/reference/drives.md"
        lines.append(
            "    # 0x6502 does not list cyclic torque: `invid check` says which other way there is, if any"
        )
    if not node.watches:
        asked[f"{name} allow_missing_heartbeat"] = (
            "it has no 0x1016 and does not notice when this computer dies: does another device stop it then?"
        )
        lines.append(
            "    # allow_missing_heartbeat: true  # ASK: it has no 0x1016: only where another device "
            "stops it when this computer dies"
        )
    asked[f"{name} inertia_kgm2"] = (
        "motor and what it moves, roughly; without it how far, how fast and with how much torque the axis "
        "may go is only known once the trial has weighed it"
    )
    lines.append(
        "    # inertia_kgm2:         # ASK: motor and what it moves, roughly: the dry run then knows its way "
        "to rest"
    )
    asked[f"{name} gravity_loaded"] = "does it fall without torque? true or false"
    asked[f"{name} limits"] = "torque, travel and speed that the machine may see"
    torque = f"{0.1 * node.rated_torque:g}" if node.rated_torque > 0 else "0.1"
    return [
        *lines,
        "    gravity_loaded: unknown # ASK: does it fall without torque? true or false; unknown is as true",
        "    limits:                 # ASK: a tenth of rated torque, three degrees: raise with care",
        f"      torque_Nm: {torque}",
        "      position_window_rad: 0.05",
        "      velocity_rad_per_s: 0.5",
    ]


def _who(node: Found) -> str:
    name = f"{_plain(node.name)!r}, " if node.name else ""
    return (
        f"{name}vendor 0x{node.vendor_id:08X}, product 0x{node.product_code:08X}, "
        f"revision 0x{node.revision:08X}"
    )


def _plain(text: str) -> str:
    """A name that a drive sent, fit for one line of YAML."""
    return "".join(c for c in text if c.isprintable())[:60]


def _quoted(path: str) -> str:
    return "'" + path.replace("'", "''") + "'"


def _from(folder: Path, file: Path) -> str:
    inside = file.resolve().is_relative_to(folder.resolve())
    return str(file.resolve().relative_to(folder.resolve()) if inside else file.resolve())


def _cycle(drives: int, bitrate: int, round_trip_s: float) -> float:
    """Cycle time [s] for the drives found; not below 1 ms, which few drives take."""
    loaded = next((c for c in CYCLES if bus_load(drives, cycle_s=c, bitrate=bitrate) <= MAX_LOAD), CYCLES[-1])
    return shortest_cycle(round_trip_s, drives, bitrate, loaded)
