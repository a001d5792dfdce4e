"""``invid init`` against foreign drives: the right EDS or the reason why none, and what is asked."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from invid.cli.app import run
from invid.config import load_config, parse_config
from invid_drivers.cli import init
from invid_drivers.eds import parse_eds
from invid_drivers.first_config import Found, match, vendor_row
from invid_drivers.simulated import open_virtual_bus
from invid_drivers.simulated.vendors import PROFILES

EDS = Path(__file__).parents[2] / "drivers" / "eds"
VENDOR = 0x00ABCDEF
PRODUCTS = {name: 0x60000000 + n for n, name in enumerate(PROFILES)}


def stamped(name: str, folder: Path, *, revision: int = 0x00020001, drive: int | None = None) -> Path:
    """The vendor's file with an identity of its own; ``drive``: revision of the device, where it differs."""
    text = (EDS / f"{name}.eds").read_text(encoding="utf-8")
    text = text.replace("VendorNumber=0x0", f"VendorNumber=0x{VENDOR:X}")
    text = text.replace("ProductNumber=0x402", f"ProductNumber=0x{PRODUCTS[name]:X}")
    text = text.replace("RevisionNumber=1", f"RevisionNumber=0x{revision:X}")
    for sub, value in ((1, VENDOR), (2, PRODUCTS[name]), (3, revision if drive is None else drive)):
        text = re.sub(rf"(\[1018sub{sub}\][^\[]*?DefaultValue=)\d+", rf"\g<1>{value}", text)
    path = folder / f"{name}-{revision:x}.eds"
    path.write_text(text, encoding="utf-8")
    return path


def scanned(node: Path, vendor: str, given: Path | None, folder: Path, monkeypatch: Any, capsys: Any) -> dict:
    """What ``invid init --json`` says of a cell with one drive made from ``node``."""
    cell = parse_config(
        yaml.safe_dump(
            {
                "format": "invid-config",
                "robot": "vendors",
                "bus": {"interface": "invid-virtual", "channel": "init", "cycle_s": 0.002},
                "axes": [
                    {
                        "name": "A1",
                        "node_id": 1,
                        "vendor": vendor,
                        "limits": {"torque_Nm": 5, "position_window_rad": 1.0, "velocity_rad_per_s": 10},
                    }
                ],
                "simulation": {
                    "plant": {"branches": [{"axis": "A1", "masses": [1.0]}]},
                    "axes": {"A1": {"objects": {"eds": str(node), "profile": vendor}}},
                },
            }
        ),
        source="test",
    )
    monkeypatch.setattr(init, "open_bus", lambda _: open_virtual_bus(cell))
    out = folder / "cell.yaml"
    words = ["init", "--interface", "invid-virtual", "--channel", "init", "-o", str(out), "--json"]
    assert run([*words, *([] if given is None else ["--eds", str(given)])]) == 0
    document: dict = json.loads(capsys.readouterr().out)
    load_config(out)
    for line in out.read_text(encoding="utf-8").splitlines():
        told = "#" in line or re.match(r"(format|bus|  interface|  channel|  - name|      \w+:)", line)
        assert told, f"not explained: {line}"
    return document


@pytest.mark.parametrize(
    "name", [n for n in PROFILES if n not in ("generic",) and (EDS / f"{n}.eds").exists()]
)
def test_each_foreign_drive_is_given_its_own_file_and_asked_what_it_does_not_say(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {other: stamped(other, tmp_path) for other in PROFILES if (EDS / f"{other}.eds").exists()}
    found = files[name]
    document = scanned(found, name, tmp_path, tmp_path, monkeypatch, capsys)
    (drive,) = document["drives"]
    assert drive["eds"] == str(found)
    written = yaml.safe_load((tmp_path / "cell.yaml").read_text(encoding="utf-8"))["axes"][0]
    assert written["eds"] == found.name
    silent = 0x6076 in PROFILES[name].lacks or PROFILES[name].values.get((0x6076, 0)) == 0
    assert ("A1 rated_torque_Nm" in document["asked"]) == silent
    assert written.get("vendor") == (vendor_row(drive["name"]) or "generic")
    assert "A1 limits" in document["asked"]


def test_the_row_of_vendors_is_told_from_the_name_that_the_drive_gives_itself() -> None:
    assert vendor_row("EPOS4 Module 50/15") == "epos4"
    assert vendor_row("Gold DC Whistle") == "elmo_gold"
    assert vendor_row("ServoX") is None
    assert vendor_row("") is None


def drive_of(vendor: int, product: int, revision: int) -> Found:
    return Found(1, 0x00020192, vendor, product, 1.0, 0, revision)


@pytest.mark.parametrize(
    ("drive", "files", "taken", "said"),
    [
        (0x00020001, [0x00010001, 0x00020001], 0x00020001, "are the drive's"),
        (0x00020003, [0x00010001, 0x00020001], 0x00020001, "differs in the lower half"),
        (0x00030001, [0x00010001, 0x00020001], None, "get the file of its firmware"),
        (0x00020009, [0x00020001, 0x00020002], None, "fit equally"),
    ],
)
def test_the_revision_decides_between_files_of_one_product(
    drive: int, files: list[int], taken: int | None, said: str, tmp_path: Path
) -> None:
    paths = {r: stamped("epos4", tmp_path, revision=r) for r in files}
    declared = [parse_eds(p, 1) for p in paths.values()]
    found = match(drive_of(VENDOR, PRODUCTS["epos4"], drive), declared)
    assert found.file == (None if taken is None else paths[taken])
    assert said in found.why
    assert match(drive_of(VENDOR, 7, drive), declared).file is None
    assert "is 0" in match(drive_of(0, 0x402, drive), declared).why


@pytest.mark.parametrize("content", [None, b"", b"\xff\x00[DeviceInfo", b"[DeviceInfo]\nVendorNumber=x\n"])
def test_files_that_are_none_are_told_and_the_scan_goes_on(
    content: bytes | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "eds"
    folder.mkdir()
    if content is None:
        assert run(["init", "--eds", str(folder), "-o", str(tmp_path / "x.yaml")]) == 2
        assert "holds no file" in capsys.readouterr().err
        return
    (folder / "bad.eds").write_bytes(content)
    document = scanned(stamped("epos4", tmp_path), "epos4", folder, tmp_path, monkeypatch, capsys)
    assert document["drives"][0]["eds"] is None
    assert "no EDS given" in document["asked"]["A1 eds"]
