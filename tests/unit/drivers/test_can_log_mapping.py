"""PDO mappings as vendors' EDS and DCF files state them, against frames packed by hand."""

import struct
from pathlib import Path

import numpy as np
import pytest

from invid.recording.import_map import Source
from invid.recording.suggest import suggest
from invid_drivers.can_log.fields import pdos_of_eds
from invid_drivers.can_log.table import read_log

N = 50
TORQUE = np.round(900 * np.sin(np.arange(N) / 9)).astype(int)
POSITION = np.round(4e6 * np.cos(np.arange(N) / 9)).astype(int)
HEAD = "[FileInfo]\nFileName=a.eds\nFileVersion=1\n[DeviceInfo]\nVendorName=x\n"
OBJECTS = {0x6077: 0x0003, 0x6064: 0x0004, 0x6041: 0x0006, 0x2001: 0x0008, 0x2002: 0x0011}


def var(section: str, kind: int, value: int | str | None = None) -> str:
    given = "" if value is None else f"DefaultValue={value}\n"
    said = f"ParameterName=p{section}\nObjectType=0x7\nDataType=0x{kind:04X}\nAccessType=rw\n"
    return f"[{section}]\n{said}{given}"


def mapped(number: int, entries: list[int], identifier: str) -> str:
    comm, mapping = f"{0x1800 + number:04X}", f"{0x1A00 + number:04X}"
    text = f"[{comm}]\nParameterName=c\nObjectType=0x9\nSubNumber=2\n" + var(f"{comm}sub0", 5, 1)
    text += var(f"{comm}sub1", 7, identifier)
    text += f"[{mapping}]\nParameterName=m\nObjectType=0x9\nSubNumber={len(entries) + 1}\n"
    text += var(f"{mapping}sub0", 5, len(entries))
    return text + "".join(var(f"{mapping}sub{i}", 7, f"0x{e:08X}") for i, e in enumerate(entries, 1))


def eds(path: Path, *pdos: str) -> Path:
    path.write_text(HEAD + "".join(pdos) + "".join(var(f"{i:04X}", k) for i, k in OBJECTS.items()))
    return path


def log(path: Path, frames: list[tuple[int, bytes]]) -> Path:
    """``frames``: N payloads of each identifier after SYNC."""
    lines = []
    for k in range(N):
        lines.append(f"({1.7e9 + k * 1e-3:.6f}) can0 080#")
        lines += [
            f"({1.7e9 + k * 1e-3 + 1e-4:.6f}) can0 {i:03X}#{data[k].hex().upper()}" for i, data in frames
        ]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("number", [4, 17, 511])
def test_a_pdo_beyond_the_fourth_is_read_by_the_identifier_that_it_has(tmp_path, number):
    path = eds(tmp_path / "a.dcf", mapped(number, [0x20010020, 0x60770010], "$NODEID+0x2C0"))
    frames = [struct.pack("<fh", p / 7, t) for p, t in zip(POSITION.tolist(), TORQUE.tolist(), strict=True)]
    source = Source(eds=path.name, nodes=[3])
    table = read_log(log(tmp_path / "a.log", [(0x2C3, frames)]), source, beside=tmp_path)
    np.testing.assert_allclose(table.columns["n3_2001"], POSITION / 7, rtol=1e-6)
    np.testing.assert_array_equal(table.columns["n3_6077"], TORQUE)


def test_a_pdo_beyond_the_fourth_without_an_identifier_is_said_to_be_left_out(tmp_path):
    path = eds(tmp_path / "a.eds", mapped(0, [0x60640020], "0x181"), mapped(5, [0x60770010], "0"))
    pdos, remarks = pdos_of_eds(path, [1])
    assert [p.id for p in pdos] == [0x181]
    assert any("0x1A05" in r and "identifier" in r for r in remarks)


@pytest.mark.parametrize("nodes", [[1], [2, 5]])
@pytest.mark.parametrize("axes", [1, 2, 3])
def test_further_axes_of_a_node_are_axes_of_a_first_map(tmp_path, nodes, axes):
    """CiA 402: the objects of axis n of a node lie 0x800 · n above those of its first."""
    torques, positions = ([base + 0x800 * a for a in range(axes)] for base in (0x6077, 0x6064))
    objects = dict.fromkeys(positions, 0x0004) | dict.fromkeys(torques, 0x0003)
    pdos = [
        mapped(a, [torques[a] << 16 | 0x10, positions[a] << 16 | 0x20], f"$NODEID+0x{0x180 + 0x100 * a:X}")
        for a in range(axes)
    ]
    path = tmp_path / "dual.eds"
    path.write_text(HEAD + "".join(pdos) + "".join(var(f"{i:04X}", k) for i, k in objects.items()))
    rows = list(zip(POSITION.tolist(), TORQUE.tolist(), strict=True))
    frames = [
        (0x180 + 0x100 * a + node, [struct.pack("<hi", t, (1 + a) * p) for p, t in rows])
        for node in nodes
        for a in range(axes)
    ]
    source = {"kind": "can_log", "eds": path.name, "nodes": nodes}
    table = read_log(log(tmp_path / "a.log", frames), Source.model_validate(source), beside=tmp_path)
    found = suggest(table, tmp_path / "a.log", source).document["axes"]
    assert len(found) == len(nodes) * axes
    for k, axis in enumerate(found):
        node, a = nodes[k // axes], k % axes
        assert axis["position"]["column"] == f"n{node}_{positions[a]:04X}"
        assert axis["torque"]["column"] == f"n{node}_{torques[a]:04X}"
        np.testing.assert_array_equal(table.columns[axis["position"]["column"]], (1 + a) * POSITION)
