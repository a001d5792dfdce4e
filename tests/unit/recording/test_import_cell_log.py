"""A bus log of a whole measurement, written by python-can, to the model behind it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import can
import numpy as np
import pytest
import yaml

import invid_drivers.connect
from invid.cli.app import run
from invid.model.diagnosis_document import load_model
from invid.recording import read_recording

# One axis, two masses 1 and 2 kg·m² on a spring of 1500 N·m/rad; 17-bit encoder.
CELL = """\
format: invid-config
format_version: 1
robot: small cell
bus: {interface: invid-virtual, channel: logged, cycle_s: 0.001}
axes:
  - name: A1
    node_id: 5
    rated_torque_Nm: 50
    masses: 2
    inertia_kgm2: 3.0
    limits: {torque_Nm: 25, position_window_rad: 1.0, velocity_rad_per_s: 5}
experiments:
  - {kind: multisine, band_Hz: [0.5, 12], period_s: 2.048, periods: 3}
simulation:
  plant:
    branches: [{axis: A1, masses_kgm2: [1.0, 2.0], springs_Nm_per_rad: [1500], dampers_Nms_per_rad: [1.0]}]
  defaults: {torque_noise_fraction_of_rated: 0.002, encoder_counts_per_rev: 131072}
"""


@pytest.fixture(scope="module")
def logged(tmp_path_factory) -> tuple[Path, Path]:
    """(candump log of everything on the bus, the recording that invid made of the same run)."""
    folder = tmp_path_factory.mktemp("logged")
    (folder / "cell.yaml").write_text(CELL, encoding="utf-8")
    log, recording = folder / "bus.log", folder / "measured.h5"
    original = invid_drivers.connect.open_bus
    writer = can.Logger(str(log))

    def tapped(config):
        bus = original(config)
        send, receive = bus.send, bus.recv

        def clocked(message: can.Message, *args, **kwargs):
            message.timestamp = bus.clock.now()
            writer(message)
            return send(message, *args, **kwargs)

        def received(*args, **kwargs):
            message = receive(*args, **kwargs)
            if message is not None:
                writer(message)
            return message

        bus.send, bus.recv = clocked, received
        return bus

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(invid_drivers.connect, "open_bus", tapped)
        assert run(["measure", str(folder / "cell.yaml"), "-o", str(recording)]) == 0
    writer.stop()
    return log, recording


def chart(folder: Path, rows: list[int], source: dict, columns: tuple[str, str, str]) -> Path:
    position, torque, demand = columns
    document = {
        "format": "invid-import-map",
        "robot": "from the bus",
        "motion": "rotary",
        "source": source,
        "time": {"column": "time", "unit": "s"},
        "axes": [
            {
                "name": "A1",
                "rated_torque": 50.0,
                "position": {"column": position, "unit": "counts", "per_count": 2 * np.pi / 131072},
                "torque": {"column": torque, "unit": "permille", "meaning": "measured"},
                "torque_demand": {"column": demand, "unit": "permille"},
            }
        ],
        "experiments": [{"rows": rows, "kind": "multisine", "excited_axis": 0, "period_samples": 2048}],
    }
    path = folder / "map.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


PDOS = {
    "pdos": [
        {
            "id": 0x185,
            "signals": [
                {"name": "q", "type": "int32"},
                {"name": "tau", "type": "int16"},
                {"name": "word", "type": "uint16"},
            ],
        },
        {
            "id": 0x205,
            "direction": "to_drive",
            "signals": [{"name": "control", "type": "uint16"}, {"name": "aim", "type": "int16"}],
        },
    ]
}


def rows_of(log: Path, folder: Path, measured) -> list[int]:
    """Rows of the log that are the measured experiment: where the positions run alike."""
    whole = folder / "whole.h5"
    path = chart(folder, [0, None], PDOS, ("q", "tau", "aim"))
    text = path.read_text(encoding="utf-8").replace("period_samples: 2048", "period_samples: 0")
    path.write_text(text, encoding="utf-8")
    assert run(["import", str(log), "--map", str(path), "-o", str(whole)]) == 0
    position = read_recording(whole).experiments[0].position[:, 0]
    wanted = measured.position[:, 0]
    starts = np.arange(position.size - wanted.size + 1)
    miss = [float(np.abs(position[s : s + wanted.size : 97] - wanted[::97]).max()) for s in starts]
    best = int(np.argmin(miss))
    assert miss[best] < 1e-9
    return [best, best + wanted.size]


@pytest.mark.campaign
def test_the_log_of_a_measurement_gives_the_plant_behind_it(logged, tmp_path):
    log, recording = logged
    measured = read_recording(recording).experiments[0]
    rows = rows_of(log, tmp_path, measured)
    path = chart(tmp_path, rows, PDOS, ("q", "tau", "aim"))
    out, model = tmp_path / "from_log.h5", tmp_path / "model.json"
    assert run(["import", str(log), "--map", str(path), "-o", str(out)]) == 0
    e = read_recording(out).experiments[0]
    np.testing.assert_allclose(e.torque, measured.torque, atol=1e-9)
    assert run(["identify", str(out), "--masses", "2", "-o", str(model)]) == 0
    chains = load_model(model).chains
    assert chains.masses[0] == pytest.approx([1.0, 2.0], rel=0.02)
    assert chains.springs[0] == pytest.approx([1500.0], rel=0.02)


def frames(n: int) -> list[str]:
    lines = []
    for k in range(n):
        lines.append(f"({1.7e9 + 0.01 * k:.6f}) can0 080#")
        data = (10 * k).to_bytes(4, "little") + (k % 900).to_bytes(2, "little") + b"\x37\x06"
        lines.append(f"({1.7e9 + 0.01 * k + 1e-3:.6f}) can0 185#{data.hex().upper()}")
        lines.append(f"({1.7e9 + 0.01 * k + 2e-3:.6f}) can0 205#0F000A00")
    return lines


@pytest.mark.campaign
def test_a_log_without_a_map_is_shown_as_pdos_with_the_fields_that_move(logged, capsys):
    """The position's four bytes are told from the torque's two; what they are is left to a person."""
    assert run(["import", "--suggest", str(logged[0]), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    pdos = {p["id"]: p for p in said["map"]["source"]["pdos"]}
    assert pdos[0x205]["direction"] == "to_drive"
    assert [s["type"] for s in pdos[0x185]["signals"]][:2] == ["int32", "int16"]
    assert pdos[0x185]["direction"] == "from_drive"
    assert any("node 5" in r for r in said["reasons"])
    assert any("name position and torque by hand" in u for u in said["unsure"])


def test_a_log_without_sync_or_pdos_is_refused_with_the_identifiers_it_has(tmp_path, capsys):
    log = tmp_path / "c.log"
    bare = [line for line in frames(50) if " 080#" not in line]
    log.write_text("\n".join(bare) + "\n", encoding="utf-8")
    assert run(["import", "--suggest", str(log)]) == 0
    assert "no SYNC" in capsys.readouterr().out
    log.write_text(
        "\n".join(re.sub(r" [0-9A-F]{3}#", " 705#", line) for line in bare) + "\n", encoding="utf-8"
    )
    assert run(["import", "--suggest", str(log)]) == 2
    assert "0x705" in capsys.readouterr().err
