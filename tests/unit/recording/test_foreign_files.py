"""Files as other people log them: read right, or refused in words that help.

Each kind is made here, from a motion that is known, never from the code under test.
"""

from __future__ import annotations

import json
import re
import struct
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import can
import numpy as np
import pytest
import yaml
from scipy.signal import butter, lfilter
from two_masses import free_multisine

import invid
from invid.cli.app import run
from invid.recording.hdf5 import read_recording
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.recording.plausibility import doubts

ROOT = Path(__file__).resolve().parents[3]
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


LONG = 2048
BY_NIGHT = pytest.mark.campaign


def driven(periods: int) -> Experiment:
    """Two masses driven by a multisine: 0.7, 2.0 kg·m², 1000 N·m/rad; exact over held torque, then noise."""
    position, torque = free_multisine(periods, COUNT)
    return Experiment(
        key="000", kind=Kind.MULTISINE, role=Role.IDENTIFY, excited_axis=0, hold_gain=np.zeros(1),
        period_samples=LONG, frequencies_hz=np.zeros(0), sample_rate_hz=1000.0,
        time=np.arange(torque.size) * 1e-3, position=position[:, None], torque=torque[:, None],
    )  # fmt: skip


def recorded(e: Experiment) -> Recording:
    return Recording(
        robot="bench", axes=("A1",), position_unit="rad", torque_unit="N·m", created="2026-01-01T00:00:00Z",
        experiments=(e,), masses_per_axis=(2,),
    )  # fmt: skip


def near_truth(model) -> None:
    """Masses and spring within three standard deviations, which are small."""
    chain, std = model.chains, model.std
    found = [*zip(chain.masses[0], std.masses[0], (0.7, 2.0), strict=True)]
    found += [(chain.springs[0][0], std.springs[0][0], 1000.0)]
    for value, one, truth in found:
        assert abs(value - truth) <= 3 * one, (value, one, truth)
        assert one < 0.01 * truth


def taken(folder: Path, source: Path, chart: dict, capsys, status: int = 0):
    """The one experiment of an import and what was said; for a refusal the message alone."""
    path = folder / "map.yaml"
    path.write_text(yaml.safe_dump(chart), encoding="utf-8")
    capsys.readouterr()
    assert run(["import", str(source), "--map", str(path), "-o", str(folder / "r.h5")]) == status, (
        capsys.readouterr().err
    )
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
    path = folder / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def csv(folder: Path, stamps, name="t.csv") -> Path:
    lines = ["time,position_rad,torque_Nm"]
    rows = zip(stamps, POSITION * COUNT, TORQUE * 0.05, strict=True)
    lines += [f"{t},{p:.9f},{m:.4f}" for t, p, m in rows]
    path = folder / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


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


def test_a_wrapping_counter_of_a_can_log_is_unwrapped(tmp_path, capsys):
    log = candump(tmp_path, (4294.6 + ROW * 1e-3) % (2**32 * 1e-6))
    e, said = taken(tmp_path, log, CAN_MAP, capsys)
    assert "2^32 µs" in said
    whole(e)
    np.testing.assert_allclose(np.diff(e.time), 1e-3, atol=2e-6)


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


@pytest.mark.parametrize(
    "pattern", ["%m/%d/%Y %I:%M:%S.%f %p", "%I:%M:%S.%f %p", "%d-%b-%Y %H:%M:%S.%f", "%H:%M:%S:%f"]
)
def test_wall_clocks_of_half_days_and_of_month_names_are_instants(tmp_path, capsys, pattern):
    # The hour turns from 12 to 1, and the day over.
    for start in (datetime(2026, 2, 3, 12, 59, 59, 500_000), datetime(2026, 2, 3, 23, 59, 59, 500_000)):
        stamps = [f"{start + timedelta(milliseconds=int(k)):{pattern}}" for k in ROW]
        e, _ = taken(tmp_path, csv(tmp_path, stamps), CSV_MAP, capsys)
        whole(e)
        np.testing.assert_allclose(np.diff(e.time), 1e-3, atol=1e-6)


def test_a_wall_clock_set_back_an_hour_goes_on(tmp_path, capsys):
    start = datetime(2026, 10, 25, 2, 59, 59, 500_000)
    back = [timedelta(hours=1) if k >= 500 else timedelta() for k in ROW]
    stamps = [
        f"{start + timedelta(milliseconds=int(k)) - b:%Y-%m-%d %H:%M:%S.%f}"
        for k, b in zip(ROW, back, strict=True)
    ]
    e, said = taken(tmp_path, csv(tmp_path, stamps), CSV_MAP, capsys)
    assert "hour" in said
    np.testing.assert_allclose(np.diff(e.time), 1e-3, atol=1e-6)


def test_two_records_in_one_file_are_said_to_be_two_and_read_so(tmp_path, capsys):
    stamps = np.where(ROW < 700, ROW * 1e-3, 5000.0 + ROW * 1e-3)
    log = csv(tmp_path, [f"{t:.4f}" for t in stamps])
    said = taken(tmp_path, log, CSV_MAP, capsys, 2)
    assert "rows: [0, 700]" in said
    assert "rows: [700, null]" in said
    chart = {**CSV_MAP, "experiments": [{"rows": [0, 700]}, {"rows": [700, None]}]}
    taken(tmp_path, log, chart, capsys)
    assert [e.samples for e in read_recording(tmp_path / "r.h5").experiments] == [700, 500]


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


def test_sync_of_a_bus_without_the_drive_clocks_nobody(tmp_path, capsys):
    log = candump(tmp_path, 10.0 + ROW * 1e-3)
    other = [f"({10.0005 + k * 1e-3:.6f}) can7 080#" for k in ROW]
    lines = sorted([*log.read_text(encoding="utf-8").splitlines(), *other])
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    e, _ = taken(tmp_path, log, CAN_MAP, capsys)
    whole(e)


@pytest.mark.parametrize("flagged", [True, False])
def test_frames_logged_twice_are_asked_for(tmp_path, capsys, flagged):
    lines = []
    for k in ROW:
        t = 5.0 + k * 1e-3
        for shift, way in ((0.0, " T"), (4e-5, " R")):
            lines.append(f"({t + shift:.6f}) can0 080#{way if flagged else ''}")
        for shift in (2e-4, 2.4e-4) if not flagged else (2e-4,):
            lines.append(f"({t + shift:.6f}) can0 181#{payload(k).hex()}{' R' if flagged else ''}")
    log = tmp_path / "echo.log"
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    said = taken(tmp_path, log, CAN_MAP, capsys, 2)
    value = re.search(r"echo: (\w+)", said)
    assert value is not None
    e, _ = taken(tmp_path, log, with_source(CAN_MAP, echo=value[1]), capsys)
    whole(e)
    np.testing.assert_allclose(np.diff(e.time), 1e-3, atol=2e-6)


@pytest.mark.parametrize("whole_source", [True, False])
def test_bytes_the_other_way_round_are_asked_for(tmp_path, capsys, whole_source):
    log = candump(tmp_path, ROW * 1e-3, order=">")
    said = taken(tmp_path, log, CAN_MAP, capsys, 2)
    assert "byte_order: big" in said
    if whole_source:
        chart = with_source(CAN_MAP, byte_order="big")
    else:
        signals = [{**s, "byte_order": "big"} for s in PDO[0]["signals"]]
        chart = with_source(CAN_MAP, pdos=[{**PDO[0], "signals": signals}])
    e, _ = taken(tmp_path, log, chart, capsys)
    whole(e)


# --- formats
# --------------------------------------------------------------------------------------------------


def gvret(folder: Path, *, way: bool) -> Path:
    lines = ["Time Stamp,ID,Extended," + ("Dir," if way else "") + "Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8"]
    for k in ROW:
        for shift, number, data in ((0, 0x80, b""), (200, 0x181, payload(k))):
            cells = "".join(f"{b:02X}," for b in data)
            head = f"{170_000_000 + 1000 * k + shift},{number:08X},false,{'Rx,' if way else ''}"
            lines.append(f"{head}0,{len(data)},{cells}")
    path = folder / f"g{way}.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


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
    path = folder / f"b{base}.log"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


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
    path = folder / "shown.txt"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


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


@pytest.mark.parametrize("text", ["nothing of a bus\n" * 50, "1;2;3\n" * 50, "12:00:01 hello 0x181\n" * 50])
def test_a_log_that_holds_no_frame_is_told_which_kinds_are_read(tmp_path, capsys, text):
    log = tmp_path / "x.log"
    log.write_text(text, encoding="utf-8")
    said = taken(tmp_path, log, CAN_MAP, capsys, 2)
    assert "no line of it is a CAN frame" in said
    assert "candump" in said
    assert "BUSMASTER" in said


# --- numbers and encodings
# ------------------------------------------------------------------------------------


def grouped(value: float, decimals: int, group: str, sign: str) -> str:
    return f"{value:,.{decimals}f}".replace(",", "~").replace(".", sign).replace("~", group)


@pytest.mark.parametrize(
    ("group", "sign", "delimiter"),
    [(".", ",", ";"), (",", ".", ";"), ("'", ".", "\t"), ("\u202f", ",", ";"), (",", ".", ",")],
)
def test_thousands_are_read(tmp_path, capsys, group, sign, delimiter):
    rows = [delimiter.join(["Zeit [ms]", "Position", "Moment"])]
    for k in ROW:
        cells = [
            grouped(float(k), 1, group, sign),
            grouped(POSITION[k], 0, group, sign),
            grouped(50.0 * TORQUE[k], 1, group, sign),
        ]
        rows.append(delimiter.join(f'"{c}"' if delimiter == "," else c for c in cells))
    path = tmp_path / "n.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    axis = {**CAN_MAP["axes"][0]}
    axis["position"] = {"column": 1, "unit": "counts", "per_count": COUNT}
    axis["torque"] = {"column": 2, "unit": "mNm", "meaning": "measured"}
    chart = {**CSV_MAP, "motion": "rotary", "time": {"column": 0, "unit": "ms"}, "axes": [axis]}
    e, _ = taken(tmp_path, path, chart, capsys)
    whole(e)


def test_a_sign_that_may_be_either_is_asked_for(tmp_path, capsys):
    rows = ["t_ms;x;m"]
    # Whole counts with points between thousands look like three decimals.
    rows += [f"{k};{grouped(POSITION[k], 0, '.', ',')};{TORQUE[k]}" for k in ROW]
    path = tmp_path / "n.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    axis = {**CAN_MAP["axes"][0]}
    axis["position"] = {"column": 1, "unit": "counts", "per_count": COUNT}
    axis["torque"] = {"column": 2, "unit": "permille", "meaning": "measured"}
    chart = {**CSV_MAP, "motion": "rotary", "time": {"column": 0, "unit": "ms"}, "axes": [axis]}
    said = taken(tmp_path, path, chart, capsys, 2)
    assert "'thousands: '.''" in said
    e, _ = taken(tmp_path, path, with_source(chart, thousands="."), capsys)
    whole(e)


@pytest.mark.parametrize("sign", [".", ","])
def test_three_decimals_everywhere_are_decimals(tmp_path, capsys, sign):
    # Never below one, where a zero would tell; several, for rounding decides which of two equals is more.
    for offset in (16.0, 20.0, 33.3, 47.11, 80.5, 123.4, 250.25, 500.7):
        three_decimals(tmp_path, capsys, sign, offset)


def three_decimals(tmp_path, capsys, sign, offset):
    rows = [
        f"{k:d};{p:.6f};{0.05 * m + offset:.3f}"
        for k, p, m in zip(ROW, POSITION * COUNT, TORQUE, strict=True)
    ]
    path = tmp_path / "n.csv"
    path.write_text("\n".join(["t_ms;x;m", *rows]).replace(".", sign) + "\n", encoding="utf-8")
    axis = {**CSV_MAP["axes"][0], "torque": {**CSV_MAP["axes"][0]["torque"], "offset": offset}}
    e, _ = taken(tmp_path, path, {**CSV_MAP, "time": {"column": 0, "unit": "ms"}, "axes": [axis]}, capsys)
    np.testing.assert_allclose(e.torque[:, 0], TORQUE * 0.05, atol=1e-6)


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-16-le", "utf-8-sig"])
def test_names_in_any_usual_encoding_are_found(tmp_path, capsys, encoding):
    path = csv(tmp_path, [f"{k * 1e-3:.3f}" for k in ROW])
    text = (
        path.read_text(encoding="utf-8")
        .replace("position_rad", "Größe für die Öffnung")
        .replace("torque_Nm", "Drehmoment über alles")
    )
    path.write_bytes(text.encode(encoding))
    axis = {**CSV_MAP["axes"][0], "position": {"column": "Größe für die Öffnung", "unit": "rad"}}
    axis["torque"] = {"column": "Drehmoment über alles", "unit": "Nm", "meaning": "measured"}
    e, _ = taken(tmp_path, path, {**CSV_MAP, "axes": [axis]}, capsys)
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


@pytest.mark.parametrize("held", [2, 3, 4, 2.5])
def test_values_that_stand_for_several_rows_are_told_with_their_rate(tmp_path, capsys, held):
    fresh = np.floor(np.floor(ROW / held) * held).astype(int)
    path = csv(tmp_path, [f"{k * 1e-3:.3f}" for k in ROW])
    lines = path.read_text(encoding="utf-8").splitlines()
    cells = [line.split(",") for line in lines[1:]]
    path.write_text(
        "\n".join(
            [lines[0], *(f"{c[0]},{cells[f][1]},{cells[f][2]}" for c, f in zip(cells, fresh, strict=True))]
        )
        + "\n"
    )
    _, said = taken(tmp_path, path, CSV_MAP, capsys)
    assert f"stands for {held:.3g} rows" in said
    assert f"{1000 / held:.4g} Hz" in said
    if held == int(held):
        assert f"every: {held}" in said
        e, said = taken(tmp_path, path, {**CSV_MAP, "experiments": [{"every": held}]}, capsys)
        assert "stands for" not in said
        np.testing.assert_allclose(e.position[:, 0], POSITION[:: int(held)] * COUNT, atol=1e-8)


@pytest.mark.parametrize(
    ("held", "channel"),
    [(2.5, None), *(pytest.param(*c, marks=BY_NIGHT) for c in ((3, None), (4, "torque"), (4, "position")))],
)
def test_identification_uses_one_row_of_each_value_that_stands_for_several(held, channel):
    e = driven(periods=6)
    fresh = np.ceil(np.floor(np.arange(e.samples) / held) * held).astype(int)
    stale = {n: getattr(e, n)[fresh] for n in ("position", "torque") if channel in (None, n)}
    model = invid.identify(recorded(replace(e, **stale)))
    assert any(f"{1000 / held:.4g} Hz" in w and "one row of each is used" in w for w in model.warnings)
    near_truth(model)


def test_a_slow_motion_of_coarse_counts_is_not_called_held(tmp_path, capsys):
    rng = np.random.default_rng(3)
    path = tmp_path / "slow.csv"
    slow = np.round(20 * np.sin(2 * np.pi * ROW / 700) + 6 * np.sin(2 * np.pi * ROW / 90)) * 1e-3
    torque = np.round(3 * np.sin(ROW / 60) + 0.2 * rng.normal(size=N), 0)
    rows = [f"{k * 1e-3:.3f},{p:.4f},{m}" for k, p, m in zip(ROW, slow, torque, strict=True)]
    path.write_text("\n".join(["time,position_rad,torque_Nm", *rows]) + "\n", encoding="utf-8")
    _, said = taken(tmp_path, path, CSV_MAP, capsys)
    assert "stands for" not in said


@pytest.mark.parametrize(
    "kind",
    ["in turn", *(pytest.param(k, marks=BY_NIGHT) for k in ("every fourth torque", "every third position"))],
)
def test_columns_of_two_rates_in_one_table_are_read_at_the_slower(tmp_path, capsys, kind):
    e = driven(periods=6)
    rows = ["time,torque,position" if kind == "every third position" else "time,position,torque"]
    for k in range(e.samples):
        p, m = f"{e.position[k, 0]:.9f}", f"{e.torque[k, 0]:.4f}"
        if kind == "every fourth torque":
            rows.append(f"{k * 1e-3:.3f},{p},{m if k % 4 == 0 else ''}")
        elif kind == "every third position":
            rows.append(f"{k * 1e-3:.3f},{m},{p if k % 3 == 1 else ''}")
        else:
            rows.append(f"{k * 1e-3:.3f},{p if k % 2 else ''},{'' if k % 2 else m}")
    path = tmp_path / "two.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    axis = {"name": "A1", "position": {"column": "position", "unit": "rad"}, "masses": 2}
    axis["torque"] = {"column": "torque", "unit": "Nm", "meaning": "measured"}
    period = 0 if kind == "every third position" else LONG
    chart = {**CSV_MAP, "time": {"column": "time"}, "axes": [axis]}
    chart["experiments"] = [{"kind": "multisine", "period_samples": period, "excited_axis": 0}]
    _, said = taken(tmp_path, path, chart, capsys)
    assert f"every {4 if 'fourth' in kind else 3 if 'third' in kind else 2} rows only" in said
    near_truth(invid.identify(read_recording(tmp_path / "r.h5")))


def test_blanks_at_no_rate_are_broken_rows(tmp_path, capsys):
    path = csv(tmp_path, [f"{k * 1e-3:.3f}" for k in ROW])
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[400:] = [line.rpartition(",")[0] + "," for line in lines[400:]]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert "holds no number" in taken(tmp_path, path, CSV_MAP, capsys, 2)


@pytest.mark.parametrize(("order", "corner"), [(1, 60.0), (1, 120.0), (2, 150.0), (4, 110.0)])
def test_a_filter_is_told_with_its_corner(order, corner):
    e = driven(periods=8)
    noise = np.random.default_rng(order).normal(0, 0.1, e.samples)
    passed = lfilter(*butter(order, corner, fs=1000.0), e.torque[:, 0] + noise)
    rounded = np.round(passed / 0.05) * 0.05
    told = [s for s in doubts(recorded(replace(e, torque=rounded[:, None]))) if "low-pass" in s]
    assert len(told) == 1
    said = re.search(r"level up to ([\d.]+) Hz", told[0])
    assert said is not None
    assert float(said[1]) == pytest.approx(corner, rel=0.35)
    assert not [s for s in doubts(recorded(replace(e, torque=e.torque + noise[:, None]))) if "low-pass" in s]


def test_noise_that_falls_from_the_first_line_on_is_no_filter():
    e = driven(periods=8)
    rng = np.random.default_rng(9)
    walk = lfilter([1.0], [1.0, -0.999], rng.normal(0, 0.05, e.samples)) + rng.normal(0, 0.05, e.samples)
    assert not [s for s in doubts(recorded(replace(e, torque=e.torque + walk[:, None]))) if "low-pass" in s]


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


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"position": {"column": 1, "unit": "rev", "scale": 1e5}}, "faster than any drive"),
        ({"torque": {"column": 2, "unit": "kNm", "meaning": "measured"}}, "times its rated torque"),
        ({"torque": {"column": 2, "unit": "Nm"}}, "'meaning'"),
    ],
)
def test_numbers_that_no_axis_reaches_name_the_line_of_the_map(tmp_path, capsys, change, said):
    log = csv(tmp_path, [f"{k * 1e-3:.3f}" for k in ROW])
    _, told = taken(tmp_path, log, {**CSV_MAP, "axes": [{**CSV_MAP["axes"][0], **change}]}, capsys)
    assert said in told


@pytest.mark.parametrize(
    ("torque", "motion", "doubted"),
    [
        ("motor_torque", "link_position", True),
        ("tau_m", "q_load", True),
        ("motor_torque", "motor_position", False),
        ("torque", "position", False),
    ],
)
def test_torque_of_one_side_with_motion_of_the_other_is_doubted(tmp_path, capsys, torque, motion, doubted):
    path = csv(tmp_path, [f"{k * 1e-3:.3f}" for k in ROW])
    text = path.read_text(encoding="utf-8").replace("position_rad", motion).replace("torque_Nm", torque)
    path.write_text(text, encoding="utf-8")
    axis = {**CSV_MAP["axes"][0], "position": {"column": motion, "unit": "rad"}}
    axis["torque"] = {"column": torque, "unit": "Nm", "meaning": "measured"}
    _, told = taken(tmp_path, path, {**CSV_MAP, "axes": [axis]}, capsys)
    assert ("must be of one side" in told) is doubted


# --- maps
# -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"experiments": [{"rows": [0, 99_999]}]}, "1200 rows of data"),
        ({"skip": {"t.csv": " "}}, "say why 't.csv'"),
        ({"time": {"colum": 0}}, "time.colum is no key of a map"),
        ({"axes": []}, "axes"),
        ({"source": {"kind": "cvs"}}, "source.kind is 'cvs': it must be 'csv', "),
    ],
)
def test_a_map_that_is_wrong_is_told_with_its_line_and_no_words_of_a_library(tmp_path, capsys, change, said):
    log = csv(tmp_path, [f"{k * 1e-3:.3f}" for k in ROW])
    path = tmp_path / "map.yaml"
    path.write_text(yaml.safe_dump({**CSV_MAP, **change}), encoding="utf-8")
    assert run(["import", str(log), "--map", str(path), "-o", str(tmp_path / "r.h5")]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert "Value error" not in told
    assert "more)" not in told


def test_a_map_names_its_files_and_what_it_leaves_out_and_why(tmp_path, capsys):
    for number in range(3):
        csv(tmp_path, [f"{k * 1e-3:.3f}" for k in ROW], name=f"run{number}.csv")
    (tmp_path / "run1.csv").write_text("no numbers\n", encoding="utf-8")
    chart = {**CSV_MAP, "files": ["run*.csv"]}
    path, out = tmp_path / "map.yaml", tmp_path / "r.h5"
    path.write_text(yaml.safe_dump(chart), encoding="utf-8")
    assert run(["import", "--map", str(path), "-o", str(out)]) == 2
    assert "skip: {'run1.csv'" in capsys.readouterr().err
    assert run(["import", "--check", str(path), "--json", "--plots", str(tmp_path / "plots")]) == 2
    document = json.loads(capsys.readouterr().out)
    assert [f["error"] is None for f in document["files"]] == [True, False, True]
    shown = document["files"][0]["experiments"][0]
    assert shown["rows"] == N
    assert shown["rate_hz"] == pytest.approx(1000.0)
    assert shown["axes"][0]["torque"][1] == pytest.approx(TORQUE.max() * 0.05)
    assert len(list((tmp_path / "plots").glob("*.png"))) == 2
    assert not out.exists()
    path.write_text(yaml.safe_dump({**chart, "skip": {"run1.csv": "the logger was off"}}), encoding="utf-8")
    assert run(["import", "--map", str(path), "-o", str(out)]) == 0
    assert "the logger was off" in capsys.readouterr().err
    assert len(read_recording(out).experiments) == 2
