"""``invid init``: who is on the bus, and a first config."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import can
import typer
from canopen.sdo.client import SdoClient

from invid.cli.output import EXIT_OK, emit, note
from invid.config import parse_config
from invid.errors import BusError, InputError
from invid.planning.budget import SHARE, bound
from invid.wording.sentence import sentence
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.link import Link, SdoAbortedError, SdoError
from invid_drivers.cia402.objects import Object
from invid_drivers.cia402.reservation import Reservation
from invid_drivers.cia402.stated.scales import position_counts
from invid_drivers.connect import is_virtual, open_bus
from invid_drivers.first_config import CYCLES, Found, first_config, match, read_all
from invid_drivers.round_trip import sample

ANSWER_S = 0.05
"""A node answers an SDO request within a few milliseconds; 127 silent ids then take seven seconds."""

NAME = Object(0x1008, 0, "B", "device name")
MODES = {4: "profile torque", 8: "cyclic position", 10: "cyclic torque"}


def quiet_link(bus: can.BusABC) -> Link:
    """A link that has listened before it sends anything; BusError where another master is on the bus."""
    link = Link(bus, heartbeat_s=0.1)
    link.listen()
    link.refuse_others()
    return link


def ask_all(link: Link, *, first: int = 1, last: int = 127) -> list[Found]:
    """The nodes that answer on a link, and what each says of itself; reads only."""
    link.answer_s = ANSWER_S
    found = []
    for node_id in range(first, last + 1):
        client = link.sdo(node_id)

        def upload(what: Object, client: SdoClient = client) -> bytes | None:
            """Bytes of an object, none where the node refuses it; ``None`` where it does not answer."""
            try:
                return bytes(client.upload(what.index, what.sub))
            except SdoAbortedError:
                return b""
            except SdoError:
                return None

        def read(what: Object, upload: Callable[[Object], bytes | None] = upload) -> int | None:
            data = upload(what)
            return None if data is None else what.unpack(data)

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
                revision=read(od.REVISION_NUMBER) or 0,
                name=(upload(NAME) or b"").decode("utf-8", "replace").strip("\0 "),
                counts=position_counts(read, linear=False),
                watches=upload(od.CONSUMER_HEARTBEAT) != b"",
            )
        )
    return found


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    def init(
        interface: str = typer.Option("socketcan", "--interface", help="python-can interface."),
        channel: str = typer.Option("can0", "--channel", help="Its channel."),
        bitrate: int = typer.Option(1_000_000, "--bitrate", help="Bit rate [bit/s]."),
        eds: list[Path] = typer.Option(
            [], "--eds", help="EDS or DCF file, or a folder of them; matched by vendor, product, revision."
        ),
        out: Path = typer.Option(Path("cell.yaml"), "-o", "--out", help="Config to write."),
        as_json: bool = typer.Option(False, "--json", help="One JSON document on stdout."),
    ) -> int:
        """Scan a bus (reads only) and write a first config."""
        if out.exists():
            raise InputError(f"{out}: stands there already; name another file with -o or remove it first")
        files, refused = read_all(eds)
        for text in refused:
            note(f"warning: {text}")
        note(f"asking node ids 1…127 on {interface} {channel}")
        probe = parse_config(
            f"format: invid-config\nrobot: scan\nbus: {{interface: '{interface}', channel: '{channel}', "
            f"bitrate_bit_per_s: {bitrate}}}\naxes: [{{name: A1, node_id: 1, limits: {{torque_Nm: 1, "
            "position_window_rad: 1, velocity_rad_per_s: 1}}]\n",
            source="scan",
        )
        with contextlib.ExitStack() as after:
            after.callback(Reservation(interface, channel).release)
            bus = open_bus(probe)
            after.callback(bus.shutdown)
            link = quiet_link(bus)
            nodes = ask_all(link)
            drives = [n for n in nodes if n.is_drive and n.node_id <= 126]
            round_trip = (
                bound(sample(link, [d.node_id for d in drives], every_s=CYCLES[0]), SHARE)
                if drives and not is_virtual(probe)
                else 0.0
            )
        if not drives:
            seen = (
                f"{len(nodes)} nodes answered, none of them a CiA 402 drive" if nodes else "no node answered"
            )
            raise BusError(
                sentence(
                    "{interface} {channel}: {seen}; check power, cable, termination and bit rate",
                    interface=interface,
                    channel=channel,
                    seen=seen,
                )
            )
        matches = [match(d, files) for d in drives] if eds else []
        written = first_config(probe.bus, drives, round_trip, matches, out.parent)
        parse_config(written.text, source=str(out))
        out.write_text(written.text, encoding="utf-8")
        document = {
            "config": str(out),
            "round_trip_ms": round_trip * 1e3,
            "drives": [
                {
                    "node_id": d.node_id,
                    "vendor_id": d.vendor_id,
                    "product_code": d.product_code,
                    "revision": d.revision,
                    "name": d.name,
                    "eds": str(matches[i].file) if matches and matches[i].file else None,
                    "eds_reason": matches[i].why if matches else None,
                    "rated_torque": d.rated_torque,
                    "modes": [name for mode, name in MODES.items() if d.modes & 1 << (mode - 1)],
                }
                for i, d in enumerate(drives)
            ],
            "asked": written.asked,
        }
        emit(
            document,
            f"{out}: {len(drives)} drives. {len(written.asked)} lines say ASK: fill them in, then "
            f"`invid check {out}`",
            as_json=as_json,
        )
        return EXIT_OK
