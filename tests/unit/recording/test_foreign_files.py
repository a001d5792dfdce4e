"""Files as other people log them: read right, or refused in words that help.

Each kind is made here, from a motion that is known, never from the code under test.
"""

import re
import struct
from datetime import datetime, timedelta
from pathlib import Path

import can
import numpy as np
import pytest
from foreign_records import text, written_map

from invid.cli.app import run
from invid.recording.hdf5 import read_recording

COUNT = 1.1984224905356572e-05
N = 1200
ROW = np.arange(N)
POSITION = np.round(
    (0.03 * np.sin(2 * np.pi * ROW / 300) + 0.004 * np.sin(2 * np.pi * ROW / 37)) / COUNT
).astype(int)
TORQUE = np.round(180 * np.sin(2 * np.pi * ROW / 300 + 0.4) + 90 * np.sin(2 * np.pi * ROW / 37)).astype(int)
PDO = [
    {
        "id": 0x181,
        "signals": [
            {"name": "status", "type": "uint16"},
            {"name": "torque", "type": "int16"},
            {"name": "position", "type": "int32"},
        ],
    }
]
CAN_MAP = {
    "format": "invid-import-map",
    "motion": "rotary",
    "source": {"kind": "can_log", "pdos": PDO},
    "time": {"column": "time"},
    "axes": [
        {
            "name": "A1",
            "rated_torque": 50,
            "position": {"column": "position", "unit": "counts", "per_count": COUNT},
            "torque": {"column": "torque", "unit": "permille", "meaning": "measured"},
        }
    ],
}
CSV_MAP = {
    "format": "invid-import-map",
    "time": {"column": 0},
    "axes": [
        {
            "name": "A1",
            "rated_torque": 50,
            "position": {"column": 1, "unit": "rad"},
            "torque": {"column": 2, "unit": "Nm", "meaning": "measured"},
        }
    ],
}


def taken(folder: Path, source: Path, chart: dict, capsys, status: int = 0):
    """The one experiment of an import and what was said; for a refusal the message alone."""
    capsys.readouterr()
    assert run(["import", str(source), *written_map(folder, chart)]) == status, capsys.readouterr().err
    said = capsys.readouterr().err
    if status:
        assert len(said.strip().splitlines()) == 1, said
        return said
    return read_recording(folder / "r.h5").experiments[0], said


def with_time(chart: dict, **time) -> dict:
    return {**chart, "time": time}


def with_source(chart: dict, **source) -> dict:
    return {**chart, "source": {**chart.get("source", {}), **source}}


def payload(k: int, order: str = "<", torque=TORQUE, position=POSITION) -> bytes:
    return struct.pack(order + "Hhi", 0x1237, int(torque[k]), int(position[k]))


def candump(folder: Path, stamps, *, channel="can0", name="c.log", order="<", apart=2e-4) -> Path:
    lines = []
    for k, t in enumerate(stamps):
        lines.append(f"({t:.6f}) {channel} 080#")
        lines.append(f"({t + apart:.6f}) {channel} 181#{payload(k, order).hex().upper()}")
    return text(folder / name, lines)


def csv(folder: Path, stamps, name="t.csv") -> Path:
    lines = ["time,position_rad,torque_Nm"]
    rows = zip(stamps, POSITION * COUNT, TORQUE * 0.05, strict=True)
    lines += [f"{t},{p:.9f},{m:.4f}" for t, p, m in rows]
    return text(folder / name, lines)


def whole(e, samples: int = N) -> None:
    """The rows are those of the motion, in SI units, each once."""
    assert abs(e.samples - samples) <= 1
    skipped = N - e.samples if samples == N else 0
    np.testing.assert_allclose(e.position[:, 0], POSITION[skipped:] * COUNT, atol=1e-8)
    np.testing.assert_allclose(e.torque[:, 0], TORQUE[skipped:] * 0.05, atol=1e-6)


# --- time ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tick", "at"),
    [(1e-6, 2**32), (1e-3, 2**16), (1e-3, 60_000), (1e-6, 7_000_000)],
    ids=["2^32 µs", "16-bit ms", "a minute of ms", "a number that only the map tells"],
)
def test_a_counter_that_wraps_goes_on_with_a_warning(tmp_path, capsys, tick, at):
    known = at != 7_000_000
    counter = (at - 400_000e-6 / tick + ROW * 1e-3 / tick) % at
    log = csv(tmp_path, [f"{c:.0f}" for c in counter])
    unit = {1e-6: "us", 1e-3: "ms"}[tick]
    chart = with_time(CSV_MAP, column=0, unit=unit)
    if not known:
        refused = taken(tmp_path, log, chart, capsys, 2)
        assert "'wraps_at'" in refused
        chart["time"]["wraps_at"] = at
    e, said = taken(tmp_path, log, chart, capsys)
    assert "starts over" in said
    whole(e)
    np.testing.assert_allclose(np.diff(e.time), 1e-3, atol=1e-9)


@pytest.mark.parametrize(
    "kind", ["zero", "frozen", "differences", "differences of frames", "two a tick", "three a tick"]
)
def test_stamps_that_are_no_instants_are_named_with_the_line_that_reads_the_file(tmp_path, capsys, kind):
    rate = 1000.0
    if kind in ("zero", "frozen"):
        stamp = 0.0 if kind == "zero" else 1.7e9
        log, chart = candump(tmp_path, np.full(N, stamp), apart=0.0), CAN_MAP
    elif kind == "differences":
        steps = 1e-3 + 1e-5 * np.random.default_rng(1).normal(size=N)
        log, chart = csv(tmp_path, [f"{s:.6f}" for s in steps]), CSV_MAP
    elif kind == "differences of frames":
        lines = []
        for k in range(N):
            lines += ["(0.000800) can0 080#", f"(0.000200) can0 181#{payload(k).hex()}"]
        log, chart = tmp_path / "d.log", CAN_MAP
        log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    else:
        rate = 2000.0 if kind == "two a tick" else 3000.0
        log = csv(tmp_path, [f"{np.floor(1e3 * k / rate) * 1e-3:.3f}" for k in range(N)])
        chart = CSV_MAP
    said = taken(tmp_path, log, chart, capsys, 2)
    line = re.search(r"sample_rate_hz: ([\d.]+|…)", said)
    assert line is not None
    if line[1] != "…":
        assert float(line[1]) == pytest.approx(rate, rel=1e-3)
    e, _ = taken(tmp_path, log, with_time(chart, sample_rate_hz=rate), capsys)
    whole(e)
    if kind.startswith("differences"):
        assert "'differences: true'" in said
        e, _ = taken(tmp_path, log, with_time(chart, **chart["time"], differences=True), capsys)
        whole(e)
        assert e.time[-1] - e.time[0] == pytest.approx((e.samples - 1) * 1e-3, rel=1e-3)


# --- channels, echoes, bytes
# ----------------------------------------------------------------------------------


def two_robots(folder: Path, ending: str) -> Path:
    path = folder / f"two.{ending}"
    with can.Logger(str(path)) as log:
        for k in range(N):
            for channel, shift in ((0, 0.0), (1, 3e-4)):
                t = 1e9 + k * 1e-3 + shift
                position = POSITION if channel == 0 else 2 * POSITION
                for number, data in ((0x80, b""), (0x181, payload(k, position=position))):
                    log(
                        can.Message(
                            timestamp=t,
                            arbitration_id=number,
                            data=data,
                            channel=channel,
                            is_extended_id=False,
                        )
                    )
                    t += 1e-4
    return path


@pytest.mark.parametrize("ending", ["log", "blf", "asc"])
def test_two_robots_in_one_log_are_refused_until_the_channel_is_said(tmp_path, capsys, ending):
    log = two_robots(tmp_path, ending)
    said = taken(tmp_path, log, CAN_MAP, capsys, 2)
    named = re.findall(r"(\S+) \(1200 frames\)", said)
    assert len(named) == 2
    assert "channel:" in said
    e, _ = taken(tmp_path, log, with_source(CAN_MAP, channel=sorted(named)[0]), capsys)
    whole(e)
    e, _ = taken(tmp_path, log, with_source(CAN_MAP, channel=sorted(named)[1]), capsys)
    np.testing.assert_allclose(e.position[:, 0], 2 * POSITION * COUNT, atol=1e-8)


# --- formats
# --------------------------------------------------------------------------------------------------


def gvret(folder: Path, *, way: bool) -> Path:
    lines = ["Time Stamp,ID,Extended," + ("Dir," if way else "") + "Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8"]
    for k in ROW:
        for shift, number, data in ((0, 0x80, b""), (200, 0x181, payload(k))):
            cells = "".join(f"{b:02X}," for b in data)
            head = f"{170_000_000 + 1000 * k + shift},{number:08X},false,{'Rx,' if way else ''}"
            lines.append(f"{head}0,{len(data)},{cells}")
    return text(folder / f"g{way}.csv", lines)


def busmaster(folder: Path, *, base: str) -> Path:
    lines = ["***BUSMASTER Ver 3.2.2***", f"***{base}***"]
    for k in ROW:
        for shift, number, data in ((0, 0x80, b""), (2, 0x181, payload(k))):
            tenth = 10 * int(k) + shift
            clock = (
                f"23:59:{59 + tenth // 10000:02d}:{tenth % 10000:04d}"
                if tenth < 10000
                else f"00:00:00:{tenth - 10000:04d}"
            )
            name, cells = (f"0x{number:03X}", "{:02X}") if base == "HEX" else (f"{number:03d}", "{:03d}")
            lines.append(
                f"{clock} Rx 1 {name} s {len(data)} " + " ".join(cells.format(b) for b in data) + " "
            )
    return text(folder / f"b{base}.log", lines)


def shown(folder: Path, *, kind: str) -> Path:
    """What Kvaser's CanKing and `candump -t A` print."""
    lines = ["Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir"] * (
        kind == "canking"
    )
    start = datetime(2023, 11, 14, 23, 59, 59, 900_000)
    for k in ROW:
        for shift, number, data in ((0, 0x80, b""), (200, 0x181, payload(k))):
            us, cells = 1000 * int(k) + shift, " ".join(f"{b:02X}" for b in data)
            if kind == "canking":
                lines.append(f"0    {number:08X}         {len(data)}  {cells:24s}  {us / 1e6:.6f} R")
            else:
                stamp = f"{start + timedelta(microseconds=us):%Y-%m-%d %H:%M:%S.%f}"
                lines.append(f" ({stamp})  can0  {number:03X}   [{len(data)}]  {cells}")
    return text(folder / "shown.txt", lines)


@pytest.mark.parametrize(
    "kind",
    ["gvret", "gvret without direction", "busmaster", "busmaster in decimals", "canking", "dates", "trc"],
)
def test_can_logs_of_other_tools_are_read(tmp_path, capsys, kind):
    if kind.startswith("gvret"):
        log = gvret(tmp_path, way=kind == "gvret")
    elif kind.startswith("busmaster"):
        log = busmaster(tmp_path, base="HEX" if kind == "busmaster" else "DEC")
    elif kind in ("canking", "dates"):
        log = shown(tmp_path, kind=kind)
    else:
        log = tmp_path / "t.trc"
        with can.Logger(str(log)) as writer:
            for k in ROW:
                for shift, number, data in ((0.0, 0x80, b""), (2e-4, 0x181, payload(k))):
                    t = 1e9 + k * 1e-3 + shift
                    writer(
                        can.Message(
                            timestamp=t, arbitration_id=number, data=data, channel=1, is_extended_id=False
                        )
                    )
    e, _ = taken(tmp_path, log, CAN_MAP, capsys)
    whole(e)


# --- numbers and encodings
# ------------------------------------------------------------------------------------


def grouped(value: float, decimals: int, group: str, sign: str) -> str:
    return f"{value:,.{decimals}f}".replace(",", "~").replace(".", sign).replace("~", group)


def test_a_sign_that_may_be_either_is_asked_for(tmp_path, capsys):
    rows = ["t_ms;x;m"]
    # Whole counts with points between thousands look like three decimals.
    rows += [f"{k};{grouped(POSITION[k], 0, '.', ',')};{TORQUE[k]}" for k in ROW]
    path = text(tmp_path / "n.csv", rows)
    axis = {**CAN_MAP["axes"][0]}
    axis["position"] = {"column": 1, "unit": "counts", "per_count": COUNT}
    axis["torque"] = {"column": 2, "unit": "permille", "meaning": "measured"}
    chart = {**CSV_MAP, "motion": "rotary", "time": {"column": 0, "unit": "ms"}, "axes": [axis]}
    said = taken(tmp_path, path, chart, capsys, 2)
    assert "'thousands: '.''" in said
    e, _ = taken(tmp_path, path, with_source(chart, thousands="."), capsys)
    whole(e)


# --- EDS and DCF
# ----------------------------------------------------------------------------------------------


def eds_map(name: str) -> dict:
    axis = {**CAN_MAP["axes"][0], "position": {"column": "n1_6064", "unit": "counts", "per_count": COUNT}}
    axis["torque"] = {"column": "n1_6077", "unit": "permille", "meaning": "measured"}
    return {**CAN_MAP, "source": {"kind": "can_log", "eds": name, "nodes": [1]}, "axes": [axis]}


EDS = """[DeviceInfo]
VendorName={vendor}
VendorNumber={number}
ProductNumber=0x7
{rest}"""


def eds(*, vendor="Müller Antriebe für Größen", zeros="0x", configured=False) -> str:
    """A TPDO of statusword, torque and position, in the default or in the value configured."""

    def entry(section: str, kind: int, value: str, default: str) -> str:
        chosen = f"DefaultValue={default}\nParameterValue={value}" if configured else f"DefaultValue={value}"
        number = f"0x{kind:04X}" if zeros == "0x" else f"{kind:04d}"
        head = f"[{section}]\nParameterName=x\nObjectType=0x7\nDataType={number}\nAccessType=rw"
        return f"{head}\nPDOMapping=1\n{chosen}\n"

    record = "[{0}]\nParameterName=r\nObjectType=0x9\nSubNumber=4\n"
    count = "3" if zeros == "0x" else "003"
    rest = entry("6041", 6, "0", "0") + entry("6077", 3, "0", "0") + entry("6064", 4, "0", "0")
    rest += record.format("1800") + entry("1800sub1", 7, "$NODEID+0x180", "$NODEID+0x80000180")
    rest += record.format("1A00") + entry("1A00sub0", 5, count, "1")
    for sub, value in ((1, "0x60410010"), (2, "0x60770010"), (3, "0x60640020")):
        rest += entry(f"1A00sub{sub}", 7, value, "0x60400010" if sub == 1 else "0")
    number = "0x1" if zeros == "0x" else "0000001"
    return EDS.format(vendor=vendor, number=number, rest=rest)


@pytest.mark.parametrize(
    ("ending", "encoding", "zeros", "configured"),
    [
        ("eds", "cp1252", "0x", False),
        ("eds", "utf-8-sig", "0x", False),
        ("eds", "utf-16", "0x", False),
        ("eds", "latin-1", "00", False),
        ("dcf", "utf-8", "0x", True),
        ("dcf", "cp1252", "00", True),
    ],
)
def test_eds_and_dcf_of_vendors_are_read_as_they_are(tmp_path, capsys, ending, encoding, zeros, configured):
    (tmp_path / f"drive.{ending}").write_bytes(eds(zeros=zeros, configured=configured).encode(encoding))
    log = candump(tmp_path, ROW * 1e-3)
    e, _ = taken(tmp_path, log, eds_map(f"drive.{ending}"), capsys)
    whole(e)


# --- plausibility
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("every", [2, 4])
def test_columns_of_two_rates_in_one_table_are_read_at_the_slower(tmp_path, capsys, every):
    rows = ["time,position,torque"]
    for k in ROW:
        torque = f"{TORQUE[k] * 0.05:.4f}" if k % every == 0 else ""
        rows.append(f"{k * 1e-3:.3f},{POSITION[k] * COUNT:.9f},{torque}")
    path = text(tmp_path / "two.csv", rows)
    e, said = taken(tmp_path, path, CSV_MAP, capsys)
    assert f"every {every} rows only" in said
    np.testing.assert_allclose(e.position[:, 0], POSITION[::every] * COUNT, atol=1e-8)
    np.testing.assert_allclose(e.torque[:, 0], TORQUE[::every] * 0.05, atol=1e-4)


@pytest.mark.parametrize("kind", ["int16", "sign16", "int32"])
def test_a_sign_lost_on_the_way_is_told_with_the_key_that_gives_it_back(tmp_path, capsys, kind):
    bits = int(kind[-2:])
    raw = np.where(TORQUE < 0, TORQUE + 2**bits if kind[0] == "i" else 2 ** (bits - 1) - TORQUE, TORQUE)
    path = tmp_path / "u.csv"
    rows = [f"{k * 1e-3:.3f},{POSITION[k] * COUNT:.9f},{raw[k]}" for k in ROW]
    path.write_text("\n".join(["time,position_rad,torque", *rows]) + "\n", encoding="utf-8")
    axis = {**CSV_MAP["axes"][0], "torque": {"column": 2, "unit": "permille", "meaning": "measured"}}
    chart = {**CSV_MAP, "axes": [axis]}
    _, said = taken(tmp_path, path, chart, capsys)
    assert f"read_as: {kind}" in said
    assert "times its rated torque" in said
    axis["torque"]["read_as"] = kind
    e, said = taken(tmp_path, path, chart, capsys)
    assert "rated torque" not in said
    whole(e)
