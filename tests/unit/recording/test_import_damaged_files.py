"""Files of every kind, damaged at random: a message or a recording, never a traceback."""

import json
import struct
from pathlib import Path

import can
import h5py
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
import yaml
from scipy.io import savemat

from invid.cli.app import run
from invid.recording import read_recording

TIME = np.arange(400) * 0.002
ANGLE, TORQUE = 0.1 * np.sin(19 * TIME), 2 * np.sin(19 * TIME + 0.3)
KINDS = [
    "a.csv",
    "a.mat",
    "v73.mat",
    "a.h5",
    "a.parquet",
    "a.log",
    "a.asc",
    "a.blf",
    "a.mf4",
    "a.mcap",
    "a.tdms",
]
MUTATIONS = 12


def sound(path: Path) -> dict[str, object]:
    """Writes a whole file of the kind; the part of the map that says what its columns are."""
    columns = {"t": TIME, "q": ANGLE, "T": TORQUE}
    if path.name == "a.csv":
        rows = [f"{t:.6f},{q:.9f},{m:.9f}" for t, q, m in zip(TIME, ANGLE, TORQUE, strict=True)]
        path.write_text("\n".join(["t,q,T", *rows]) + "\n", encoding="utf-8")
    elif path.name == "a.mat":
        savemat(path, columns)
    elif path.suffix == ".parquet":
        pyarrow.parquet.write_table(pyarrow.table(columns), path)
    elif path.suffix == ".mf4":
        asammdf = pytest.importorskip("asammdf", reason="asammdf is missing: pip install 'invid[mdf]'")
        with asammdf.MDF(version="4.10") as file:
            file.append([asammdf.Signal(v, TIME, name=n) for n, v in columns.items() if n != "t"])
            file.save(path)
        return {"time": {"column": "time", "unit": "s"}}
    elif path.suffix == ".tdms":
        tdms = pytest.importorskip("nptdms", reason="npTDMS is missing: pip install 'invid[tdms]'")
        with tdms.TdmsWriter(path) as file:
            file.write_segment([tdms.ChannelObject("log", n, v) for n, v in columns.items()])
    elif path.suffix == ".mcap":
        writers = pytest.importorskip("mcap.writer", reason="mcap is missing: pip install 'invid[mcap]'")
        with path.open("wb") as stream:
            writer = writers.Writer(stream)
            writer.start()
            channel = writer.register_channel("", "json", writer.register_schema("s", "jsonschema", b"{}"))
            for t, q, torque in zip(TIME, ANGLE, TORQUE, strict=True):
                row = json.dumps({"q": q, "T": torque}).encode()
                writer.add_message(channel, round(t * 1e9), row, round(t * 1e9))
            writer.finish()
        return {"time": {"column": "time of ", "unit": "s"}}
    elif path.suffix in (".mat", ".h5"):
        with h5py.File(path, "w", userblock_size=512 if path.suffix == ".mat" else 0) as file:
            for name, values in columns.items():
                file[name] = values[None] if path.suffix == ".mat" else values
        if path.suffix == ".mat":
            with path.open("r+b") as raw:
                raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    else:
        with can.Logger(str(path)) as log:
            for t, q, torque in zip(TIME, ANGLE, TORQUE, strict=True):
                value = struct.pack("<ih", int(q * 1e5), int(torque * 100))
                for late, identifier, data in ((0.0, 0x80, b""), (1e-4, 0x181, value)):
                    log.on_message_received(
                        can.Message(1000 + t + late, identifier, is_extended_id=False, data=data)
                    )
        signals = [{"name": "q", "type": "int32"}, {"name": "T", "type": "int16"}]
        return {
            "source": {"pdos": [{"id": 0x181, "signals": signals}]},
            "time": {"column": "time", "unit": "s"},
        }
    return {"time": {"column": "t", "unit": "s"}}


def damaged(raw: bytes, rng: np.random.Generator) -> bytes:
    """Bytes changed anywhere or near the head, the end cut off, or a piece replaced."""
    out = bytearray(raw)
    kind = rng.integers(4)
    if kind == 0:
        return bytes(out[: rng.integers(1, len(out))])
    if kind == 1:
        at, length = int(rng.integers(len(out))), int(rng.integers(1, 200))
        out[at : at + length] = rng.bytes(int(rng.integers(300)))
        return bytes(out)
    for at in rng.integers(0, len(out) if kind == 2 else min(len(out), 2000), rng.integers(1, 30)):
        out[at] = rng.integers(256)
    return bytes(out)


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_read_or_refused_in_one_message(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, out, chart = tmp_path / kind, tmp_path / "out.h5", tmp_path / "map.yaml"
    columns = sound(whole)
    dot = "." if kind == "a.mcap" else ""
    axis = {
        "name": "A1",
        "position": {"column": f"{dot}q", "unit": "rad"},
        "torque": {"column": f"{dot}T", "unit": "N·m"},
    }
    chart.write_text(
        yaml.safe_dump(
            {"format": "invid-import-map", "format_version": 1, "robot": "r", "axes": [axis], **columns}
        ),
        encoding="utf-8",
    )
    assert run(["import", str(whole), "--map", str(chart), "-o", str(out)]) == 0
    read = read_recording(out).experiments[0]
    counts = {"q": 1.0, "T": 1.0} if "source" not in columns else {"q": 1e5, "T": 100.0}  # of a PDO
    np.testing.assert_allclose(read.time - read.time[0], TIME, atol=1e-6)
    np.testing.assert_allclose(read.position[:, 0] / counts["q"], ANGLE, atol=1.1e-5)
    np.testing.assert_allclose(read.torque[:, 0] / counts["T"], TORQUE, atol=1.1e-2)
    rng = np.random.default_rng(len(kind))
    for number in range(MUTATIONS // 4 if kind == "a.mf4" else MUTATIONS):  # a process each
        out.unlink(missing_ok=True)
        whole.with_name(f"x{kind}").write_bytes(damaged(whole.read_bytes(), rng))
        capsys.readouterr()
        status = run(["import", str(whole.with_name(f"x{kind}")), "--map", str(chart), "-o", str(out)])
        said = capsys.readouterr()
        assert status in (0, 2), (number, said.err)
        assert "Traceback" not in said.out + said.err
        assert out.exists() == (status == 0)
        if status == 0:
            assert np.isfinite(read_recording(out).experiments[0].position).all()
