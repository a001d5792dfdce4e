"""Drives with the gaps that vendors' drives have, built from the EDS files in ``drivers/eds``: what becomes
of each at connect, with the same file named in the config."""

import runpy
from pathlib import Path
from typing import Any

import pytest
import yaml
from stepping import energise, exchange, set_modes

from invid.config import CellConfig, load_config, parse_config
from invid.errors import ConfigError, DriveError
from invid.sweep import Mode
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.connect import connect
from invid_drivers.eds import parse_eds
from invid_drivers.simulated import open_virtual_bus
from invid_drivers.simulated.cell import SimulatedCell

ROOT = Path(__file__).parents[2]
EDS = ROOT / "drivers" / "eds"
TABLES = runpy.run_path(str(ROOT / "scripts" / "drive-tables.py"))
eds_text = TABLES["eds_text"]
SCALES = {"rated_torque_Nm": 100, "position_rad_per_count": 1.1984e-5}


def config(node: Path, named: Path | None, vendor: str = "generic", **axis: Any) -> CellConfig:
    """One axis behind a drive made from ``node``, with ``named`` as the config's EDS."""
    return CellConfig.model_validate(
        {
            "format": "invid-config",
            "robot": "vendors",
            "bus": {"interface": "invid-virtual", "channel": "vendors", "cycle_s": 0.002},
            "axes": [
                {
                    "name": "A1",
                    "node_id": 1,
                    "gravity_loaded": False,
                    "vendor": vendor,
                    "eds": None if named is None else str(named),
                    "limits": {"torque_Nm": 5, "position_window_rad": 1.0, "velocity_rad_per_s": 10},
                    **axis,
                }
            ],
            "simulation": {
                "plant": {"branches": [{"axis": "A1", "masses": [1.0]}]},
                "axes": {"A1": {"objects": {"eds": str(node), "profile": vendor}}},
            },
        }
    )


def file(name: str) -> Path:
    return EDS / f"{name}.eds"


# From notes on 16 vendors' files, not from the code: what each lacks, and what is zero.
GAPS = {
    "epos4": ([0x6072, 0x608F, 0x6091], [0x6076], 4, 4, False),
    "elmo_gold": ([], [0x6076], 4, 4, True),
    "nanotec_c5e": ([0x6076, 0x6007, 0x1016], [0x6072], 8, 8, True),
    "zeroerr_erob": ([0x6072, 0x605A, 0x6007, 0x608F], [], 4, 4, True),
    "schunk": ([0x6071, 0x6072, 0x605A, 0x6007], [], 2, 4, True),
    "pilz": ([0x6071, 0x6072, 0x605A, 0x6007], [], 2, 4, True),
    "faulhaber_3150": ([0x6071, 0x6077, 0x6072, 0x605A, 0x6007], [], 4, 4, True),
}


@pytest.mark.parametrize("name", list(GAPS))
def test_each_file_has_exactly_its_vendors_gaps(name: str) -> None:
    missing, zero, rpdos, tpdos, dummies = GAPS[name]
    declared = parse_eds(file(name), 5)
    assert {i for i in missing if any(index == i for index, _ in declared.variables)} == set()
    for index in zero:
        entry = declared.find(index, 0)
        assert entry is not None
        assert entry.default == 0
    assert (declared.rpdos, declared.tpdos, (5, 0) in declared.variables) == (rpdos, tpdos, dummies)
    heartbeat = declared.find(0x1016, 1)
    assert (heartbeat is None) == (0x1016 in missing)
    cob = declared.find(0x1400, 1)
    assert cob is not None
    assert cob.default == 0x205


RUNS = [
    ("generic", {}, []),
    ("epos4", SCALES, ["0x6072 max torque: 0x3001:2"]),
    ("elmo_gold", {"rated_torque_Nm": 100}, []),
    (
        "nanotec_c5e",
        {
            "rated_torque_Nm": 100,
            "allow_missing_heartbeat": True,
            "overrides": {"0x6072": "0 as shipped, nobody set it"},
        },
        ["0x1016", "0x6007"],
    ),
    ("zeroerr_erob", SCALES, ["0x6072 max torque: only the master", "0x605A", "0x6007"]),
]


@pytest.mark.parametrize(("name", "axis", "lacks"), RUNS, ids=[r[0] for r in RUNS])
def test_a_drive_whose_gaps_are_bridged_by_the_config_runs_and_is_left_as_it_was(
    name: str, axis: dict[str, Any], lacks: list[str]
) -> None:
    cell = connect(config(file(name), file(name), name, **axis))
    (report,) = cell.check()
    for what in lacks:
        assert any(what in line for line in report.lacks), what
    assert not any("EDS" in w for w in report.warnings)
    entries = {(e.index, e.sub): e.value for e in simulated(cell)}
    energise(cell, [Mode.HOLD])
    set_modes(cell, [Mode.TORQUE])
    for _ in range(20):
        sample = exchange(cell, [1.0])
    assert sample.fresh == [True]
    assert sample.torque[0] == pytest.approx(1.0, abs=0.2)
    cell.stop()
    cell._restore([])
    changing = {
        0x6040,
        0x6041,
        0x6060,
        0x6061,
        0x6062,
        0x6064,
        0x606C,
        0x6071,
        0x6074,
        0x6077,
        0x607A,
        0x60F4,
    }
    after = {(e.index, e.sub): e.value for e in simulated(cell)}
    assert {k for k in entries if entries[k] != after[k] and k[0] not in changing} == set()
    assert cell.close() == []


def simulated(cell: Cia402Cell) -> Any:
    return cell._link.bus.cell.drives[0].node.od  # type: ignore[attr-defined]


def changed(name: str, tmp_path: Path, key: str = "DefaultValue", **values: int) -> Path:
    """The file of a vendor with other values of some objects, named as their sections are: ``o3001sub1``."""
    text = file(name).read_text(encoding="utf-8")
    for section, value in values.items():
        at = text.index("DefaultValue=", text.index(f"[{section[1:]}]"))
        old = text[at : text.index("\n", at)] if key == "DefaultValue" else ""
        text = text[:at] + f"{key}={value}" + ("" if old else "\n") + text[at + len(old) :]
    path = tmp_path / "node.eds"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("name", "speed"),
    # 10 rad/s and the drive's quarter: in counts a second, and in revolutions a minute
    [
        ("zeroerr_erob", 12.5 / 1.1984e-5),
        ("epos4", 12.5 * 60 / 6.283185),
        ("nanotec_c5e", 12.5 * 60 / 6.283185),
    ],
)
def test_the_speed_limit_reaches_every_drive_in_its_own_unit(name: str, speed: float) -> None:
    axis = {"allow_missing_heartbeat": True, "overrides": {"0x6072": "0 as shipped"}, **SCALES}
    cell = connect(config(file(name), file(name), name, **axis))
    energise(cell, [Mode.HOLD])
    assert simulated(cell).number(0x607F) == pytest.approx(speed, abs=1)
    assert cell.close() == []


def test_a_drive_without_a_torque_limit_has_its_current_limited_to_the_same_share(tmp_path: Path) -> None:
    node = changed("epos4", tmp_path, o3001sub1=3000)  # mA at the rated 100 N·m
    cell = connect(config(node, node, "epos4", **SCALES))
    energise(cell, [Mode.HOLD])
    assert simulated(cell).number(0x3001, 2) == 150  # 5 N·m
    assert cell.close() == []


def test_a_torque_limit_above_what_the_eds_allows_is_the_highest_that_it_allows(tmp_path: Path) -> None:
    named = changed("generic", tmp_path, "HighLimit", o6072=40)
    cell = connect(config(file("generic"), named, rated_torque_Nm=100))
    (report,) = cell.check()
    assert 5 / report.scaling.rated_torque > 0.040
    energise(cell, [Mode.HOLD])
    assert simulated(cell).number(0x6072) == 40
    assert cell.close() == []


def test_units_of_the_user_that_are_not_the_encoders_are_to_be_named_in_the_config(tmp_path: Path) -> None:
    node = changed("generic", tmp_path, o6092sub1=360_000)
    cell = connect(config(node, node))
    with pytest.raises(DriveError, match=r"contradicts itself.*0x6092 say 1.7453.*0x608F say 1.1984"):
        cell.check()
    cell.close()
    for says in (1.745329e-5, 1.19842e-5):
        cell = connect(config(node, node, position_rad_per_count=says))
        assert cell.check()[0].scaling.position_per_count == says
        cell.close()
    cell = connect(config(node, node, position_rad_per_count=4.8e-5))
    with pytest.raises(DriveError, match=r"position_rad_per_count is 4\.8e-05"):
        cell.check()
    cell.close()


REFUSED = [
    ("epos4", {}, "0x608F encoder resolution.*position_rad_per_count"),
    ("epos4", {"position_rad_per_count": 1.1984e-5}, "0x6076 motor rated torque.*rated_torque_Nm"),
    ("elmo_gold", {}, "0x6076 motor rated torque is missing or 0.*rated_torque_Nm"),
    ("nanotec_c5e", {}, "rated_torque_Nm"),
    ("nanotec_c5e", {"rated_torque_Nm": 100}, "0x1016 is missing.*allow_missing_heartbeat"),
    ("zeroerr_erob", {}, "0x608F"),
    ("schunk", {}, "schunk.eds the drive has no 0x6071 .target torque.*cannot be commanded"),
    ("pilz", {}, "pilz.eds the drive has no 0x6071 .target torque.*cannot be commanded"),
    ("faulhaber_3150", {}, "has no 0x6071 .target torque"),
]


@pytest.mark.parametrize(("name", "axis", "words"), REFUSED, ids=[f"{r[0]} {len(r[1])}" for r in REFUSED])
@pytest.mark.parametrize("named", [True, False], ids=["by its EDS", "by the drive"])
def test_a_drive_that_cannot_do_the_job_is_refused_in_a_sentence(
    name: str, axis: dict[str, Any], words: str, named: bool
) -> None:
    cell = connect(config(file(name), file(name) if named else None, name, **axis))
    if not named:
        words = words.removeprefix(f"{name}.eds the drive ")
    with pytest.raises(DriveError, match=words) as caught:
        cell.check()
    assert str(caught.value).startswith("axis A1 (node 1)")
    cell.close()


def test_a_drive_that_its_eds_rules_out_is_refused_before_it_is_asked_anything() -> None:
    cell = connect(config(file("schunk"), file("schunk")))
    bus: Any = cell._link.bus
    with pytest.raises(DriveError, match="import"):
        cell.check()
    assert bus.cell.frames_in <= 1  # NMT to pre-operational
    cell.close()


def test_an_eds_that_does_not_parse_is_a_warning_that_names_it_and_the_drive_is_asked() -> None:
    cell = connect(config(file("generic"), file("does_not_parse")))
    (report,) = cell.check()
    assert any("does_not_parse.eds does not parse" in w and "DataType" in w for w in report.warnings)
    energise(cell, [Mode.HOLD])
    assert all(exchange(cell, [0.0]).fresh)
    assert cell.close() == []


def test_an_eds_of_another_product_is_not_believed(tmp_path: Path) -> None:
    other = tmp_path / "other.eds"
    text = file("generic").read_text(encoding="utf-8").replace("ProductNumber=0x402", "ProductNumber=0x999")
    other.write_text(text, encoding="utf-8")
    cell = connect(config(file("generic"), other))
    (report,) = cell.check()
    assert any("0x999" in w and "0x402" in w for w in report.warnings)
    cell.close()


def test_torque_that_cannot_be_mapped_is_refused_by_the_eds(tmp_path: Path) -> None:
    text = file("generic").read_text(encoding="utf-8")
    start = text.index("[6077]")
    end = text.index("PDOMapping=1", start)
    node = tmp_path / "node.eds"
    node.write_text(text[:end] + "PDOMapping=0" + text[end + len("PDOMapping=1") :], encoding="utf-8")
    cell = connect(config(node, node))
    with pytest.raises(DriveError, match=r"0x6077.*into a PDO.*cannot be measured"):
        cell.check()
    cell.close()


def test_an_eds_is_looked_for_beside_the_config_and_its_absence_is_bad_input(tmp_path: Path) -> None:
    cell = config(file("generic"), None).model_dump(mode="json", exclude_none=True)
    cell["axes"][0]["eds"] = "drive.eds"
    path = tmp_path / "cell.yaml"
    path.write_text(yaml.safe_dump(cell), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"drive\.eds.*cannot be read"):
        connect(load_config(path))
    (tmp_path / "drive.eds").write_text(eds_text("generic"), encoding="utf-8")
    connected = connect(load_config(path))
    connected.check()
    connected.close()


@pytest.mark.campaign
def test_whatever_object_a_drive_lacks_it_runs_or_is_refused_in_a_sentence() -> None:
    """Each object of the simulated drive taken away in turn; nobody crashes, and nobody is left energised."""
    document = yaml.safe_load((ROOT / "configs" / "case-study.yaml").read_text(encoding="utf-8"))
    objects = sorted(
        {entry.index for entry in SimulatedCell(parse_config(yaml.safe_dump(document))).drives[0].node.od}
    )
    assert len(objects) > 60
    refused: dict[int, str] = {}
    for index in objects:
        document["simulation"].setdefault("axes", {}).setdefault("A2", {})["objects"] = {
            "lacks": [f"0x{index:04X}"]
        }
        bus = open_virtual_bus(parse_config(yaml.safe_dump(document)))
        cell = Cia402Cell(bus, parse_config(yaml.safe_dump(document)))
        try:
            cell.check()
            if index in (0x1400, 0x1600, 0x1800, 0x1A00, 0x6040):  # found when it is mapped
                with pytest.raises(DriveError, match="cannot be mapped"):
                    energise(cell, [Mode.HOLD] * 3)
        except DriveError as error:
            refused[index] = str(error)
        finally:
            cell.close()
        assert all(d.state.name not in ("OPERATION_ENABLED", "QUICK_STOP_ACTIVE") for d in bus.cell.drives)
    # without these there is no measurement; whatever else is missing is bridged or listed
    assert {0x1016, 0x6041, 0x6064, 0x6071, 0x6077} <= set(refused)
    assert all("axis A2 (node 2)" in sentence for sentence in refused.values())
