"""``invid init``: who is on the bus, and a first config."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import can
import typer

from invid.cli.output import EXIT_OK, emit, note
from invid.config import parse_config
from invid.errors import BusError, InputError
from invid.planning import bus_load
from invid.planning.round_trip import SHARE, bound, shortest_cycle
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.link import Link, SdoAbortedError, SdoError
from invid_drivers.cia402.objects import Object
from invid_drivers.cia402.reservation import Reservation
from invid_drivers.connect import is_virtual, open_bus
from invid_drivers.round_trip import sample

ANSWER_S = 0.05
"""A node answers an SDO request within a few milliseconds; 127 silent ids then take seven seconds."""

MAX_LOAD = 0.8
CYCLES = (0.001, 0.002, 0.004, 0.01, 0.02)

MODES = {4: "profile torque", 8: "cyclic position", 10: "cyclic torque"}


@dataclass(frozen=True)
class Found:
    """A node that answered."""

    node_id: int
    device_type: int
    vendor_id: int
    product_code: int
    rated_torque: float
    modes: int

    @property
    def is_drive(self) -> bool:
        """Whether it says that it is a CiA 402 drive."""
        return self.device_type & 0xFFFF == 402


def scan(bus: can.BusABC, *, first: int = 1, last: int = 127) -> list[Found]:
    """Ask every node id for 0x1000 and, where one answers, who it is.

    Reads only, and not on the bus of another master (BusError).
    """
    return ask_all(quiet_link(bus), first=first, last=last)


def quiet_link(bus: can.BusABC) -> Link:
    """A link that has listened before it sends anything; BusError where another master is on the bus."""
    link = Link(bus, heartbeat_s=0.1)
    link.listen()
    link.refuse_others("nothing was sent")
    return link


def ask_all(link: Link, *, first: int = 1, last: int = 127) -> list[Found]:
    """Who answers on a link."""
    link.answer_s = ANSWER_S
    found = []
    for node_id in range(first, last + 1):
        client = link.sdo(node_id)

        def read(what: Object, client: object = client) -> int | None:
            try:
                return what.unpack(client.upload(what.index, what.sub))  # type: ignore[attr-defined]
            except SdoAbortedError:
                return 0
            except SdoError:
                return None

        device = read(od.DEVICE_TYPE)
        if device is None:
            continue
        found.append(
            Found(
                node_id,
                device,
                read(od.VENDOR_ID) or 0,
                read(od.PRODUCT_CODE) or 0,
                (read(od.RATED_TORQUE) or 0) / 1000.0,
                read(od.SUPPORTED_MODES) or 0,
            )
        )
    return found


def first_config(
    interface: str, channel: str, bitrate: int, nodes: list[Found], round_trip_s: float = 0.0
) -> str:
    """YAML text of a config for the drives found; limits are timid and to be set by a person.

    The cycle is the shortest that bus load and the adapter's round trip [s] carry.
    """
    lines = [
        "# Written by `invid init`. Check every limit before anything moves.",
        "format: invid-config",
        "format_version: 1",
        "robot: unnamed",
        "motion: rotary",
        "bus:",
        f"  interface: {interface}",
        f"  channel: {channel}",
        f"  bitrate_bit_per_s: {bitrate}",
        f"  cycle_s: {_cycle(len(nodes), bitrate, round_trip_s):g}"
        + (
            f"           # the adapter's round trip is {round_trip_s * 1e3:.2g} ms (99 %)"
            * (round_trip_s > 0)
        ),
        "axes:",
    ]
    for n, node in enumerate(nodes, start=1):
        torque = f"{0.1 * node.rated_torque:g}" if node.rated_torque > 0 else "0.1"
        lines += [
            f"  - name: A{n}",
            f"    node_id: {node.node_id}        # vendor 0x{node.vendor_id:08X}, product "
            f"0x{node.product_code:08X}",
        ]
        if node.rated_torque <= 0:
            lines.append("    rated_torque_Nm: 1      # the drive's 0x6076 is missing or 0: set it")
        lines += [
            "    gravity_loaded: unknown # does it fall without torque? true or false; unknown is as true",
            "    limits:                 # a tenth of rated torque, three degrees: raise with care",
            f"      torque_Nm: {torque}",
            "      position_window_rad: 0.05",
            "      velocity_rad_per_s: 0.5",
        ]
    return "\n".join(lines) + "\n"


def _cycle(drives: int, bitrate: int, round_trip_s: float) -> float:
    """Not below 1 ms, which few drives take."""
    loaded = next((c for c in CYCLES if bus_load(drives, cycle_s=c, bitrate=bitrate) <= MAX_LOAD), CYCLES[-1])
    return shortest_cycle(round_trip_s, drives, bitrate, loaded)


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    def init(
        interface: str = typer.Option("socketcan", "--interface", help="python-can interface."),
        channel: str = typer.Option("can0", "--channel", help="Its channel."),
        bitrate: int = typer.Option(1_000_000, "--bitrate", help="Bit rate [bit/s]."),
        out: Path = typer.Option(Path("cell.yaml"), "-o", "--out", help="Config to write."),
        as_json: bool = typer.Option(False, "--json", help="One JSON document on stdout."),
    ) -> int:
        """Scan a bus (reads only) and write a first config."""
        if out.exists():
            raise InputError(f"{out}: stands there already; name another file with -o or remove it first")
        note(f"asking node ids 1…127 on {interface} {channel}")
        probe = parse_config(
            "format: invid-config\nrobot: scan\n"
            f"bus: {{interface: '{interface}', channel: '{channel}', bitrate_bit_per_s: {bitrate}}}\n"
            "axes: [{name: A1, node_id: 1, "
            "limits: {torque_Nm: 1, position_window_rad: 1, velocity_rad_per_s: 1}}]\n",
            source="scan",
        )
        reservation = Reservation(interface, channel)
        try:
            bus = open_bus(probe)
            try:
                link = quiet_link(bus)
                nodes = ask_all(link)
                drives = [n for n in nodes if n.is_drive and n.node_id <= 126]
                round_trip = (
                    bound(sample(link, [d.node_id for d in drives], every_s=CYCLES[0]), SHARE)
                    if drives and not is_virtual(probe)
                    else 0.0
                )
            finally:
                bus.shutdown()
        finally:
            reservation.release()
        if not drives:
            seen = (
                f"{len(nodes)} nodes answered, none of them a CiA 402 drive" if nodes else "no node answered"
            )
            raise BusError(f"{interface} {channel}: {seen}; check power, cable, termination and bit rate")
        text = first_config(interface, channel, bitrate, drives, round_trip)
        parse_config(text, source=str(out))
        out.write_text(text, encoding="utf-8")
        document = {
            "config": str(out),
            "round_trip_ms": round_trip * 1e3,
            "drives": [
                {
                    "node_id": d.node_id,
                    "vendor_id": d.vendor_id,
                    "product_code": d.product_code,
                    "rated_torque": d.rated_torque,
                    "modes": [name for mode, name in MODES.items() if d.modes & 1 << (mode - 1)],
                }
                for d in drives
            ],
        }
        emit(
            document,
            f"{out}: {len(drives)} drives. Set names and limits, then `invid check {out}`",
            as_json=as_json,
        )
        return EXIT_OK
