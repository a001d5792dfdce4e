"""What the objects of a drive say of its units: read, compared, and refused with both numbers."""

import math
from typing import Any

import pytest

from invid.config import AxisConfig, CellConfig
from invid.errors import DriveError
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.objects import NodeAxis, Object
from invid_drivers.cia402.stated.scales import Factors, read_factors
from invid_drivers.cia402.stated.vendors import VENDORS
from invid_drivers.connect import connect

TURN = 2 * math.pi
LIMITS = {"torque_Nm": 5, "position_window_rad": 1.0, "velocity_rad_per_s": 10}
PLAIN = {"0x608F:1": 4096, "0x608F:2": 1, "0x6076": 2000}


def factors(objects: dict[str, int], vendor: str = "generic", **axis: Any) -> Factors:
    shown = PLAIN | objects

    def read(what: Object) -> int | None:
        return shown.get(what.address)

    config = AxisConfig.model_validate({"name": "A1", "node_id": 1, "limits": LIMITS, **axis})
    return read_factors(read, config, linear=False, vendor=VENDORS[vendor])


def refused(objects: dict[str, int], **axis: Any) -> DriveError:
    with pytest.raises(DriveError) as caught:
        factors(objects, **axis)
    assert caught.value.axis == "A1"
    return caught.value


def test_one_and_one_and_missing_factors_change_nothing() -> None:
    for objects in (
        {},
        {"0x6093:1": 1, "0x6093:2": 1, "0x6096:1": 7, "0x6096:2": 7, "0x607F": 1000, "0x607E": 0},
    ):
        found = factors(objects)
        assert found.scaling.position_per_count == pytest.approx(TURN / 4096)
        assert found.scaling.rated_torque == 2
        assert found.notes == ()


def test_a_position_factor_that_nothing_confirms_is_refused_with_both_numbers() -> None:
    error = refused({"0x6093:1": 336, "0x6093:2": 10})
    assert error.code == "scales_contradict"
    assert "0x6093 and 0x608F say 0.0515418 and 0x608F say 0.00153398" in str(error)
    assert "Give position_rad_per_count" in str(error)


def test_what_the_config_states_must_be_what_the_position_factor_makes_of_a_count() -> None:
    factor = {"0x6093:1": 336, "0x6093:2": 10}
    error = refused(factor, position_rad_per_count=TURN / 4096)
    assert "position_rad_per_count is 0.00153398 rad, but 0x6093 and 0x608F" in str(error)
    assert "0.0515418" in str(error)
    assert factors(factor, position_rad_per_count=33.6 * TURN / 4096).notes == ()
    kept = factors(
        factor, position_rad_per_count=TURN / 4096, overrides={"0x6093": "not used by this firmware"}
    )
    assert kept.scaling.position_per_count == TURN / 4096
    assert "not used by this firmware" in kept.notes[0]


def test_a_position_factor_and_a_feed_constant_that_agree_need_no_word_of_the_config() -> None:
    # 360000 units a turn behind a gear of 100: 409600 increments are 360000 units
    objects = {
        "0x6092:1": 360_000,
        "0x6092:2": 1,
        "0x6091:1": 100,
        "0x6091:2": 1,
        "0x6093:1": 4096,
        "0x6093:2": 3600,
    }
    assert factors(objects).scaling.position_per_count == pytest.approx(100 * TURN / 360_000)
    assert refused(objects | {"0x6093:1": 1}).code == "scales_contradict"


def test_a_speed_limit_whose_unit_the_drive_converts_is_refused_with_every_reading() -> None:
    objects = {"0x6096:1": 10, "0x6096:2": 1, "0x607F": 65190}
    error = refused(objects)
    assert error.code == "scales_contradict"
    assert "is 100 rad/s in the drive's plain unit, but 1000 or 10 rad/s by its 0x6096" in str(error)
    assert factors({**objects, "0x607F": 0}).notes == ()
    (note,) = factors(objects, overrides={"0x6096": "for 0x606C alone"}).notes
    assert "for 0x606C alone" in note


@pytest.mark.parametrize(
    ("polarity", "is_refused"), [(0, False), (0x40, False), (0x80, True), (0x20, True), (0xE0, False)]
)
def test_a_position_that_is_turned_without_its_torque_is_refused(polarity: int, is_refused: bool) -> None:
    if not is_refused:
        assert factors({"0x607E": polarity}).notes == ()
        return
    error = refused({"0x607E": polarity})
    assert error.code == "polarity_contradicts"
    assert f"0x607E polarity is 0x{polarity:02X}" in str(error)
    assert "turns both" in factors({"0x607E": polarity}, overrides={"0x607E": "turns both"}).notes[0]


def test_a_missing_scale_and_a_limit_beyond_the_command_have_codes() -> None:
    assert refused({"0x608F:1": 0}).code == "scale_missing"
    assert refused({"0x6076": 0}).code == "scale_missing"
    assert refused({"0x6076": 100}).code == "limit_beyond_command"
    assert refused({}, rated_torque_Nm=3).code == "scales_contradict"


def cell(*axes: dict[str, Any]) -> CellConfig:
    return CellConfig.model_validate(
        {
            "format": "invid-config",
            "robot": "factors",
            "bus": {"interface": "invid-virtual", "channel": "factors", "cycle_s": 0.004},
            "axes": [{"gravity_loaded": False, "limits": LIMITS, **a} for a in axes],
            "simulation": {
                "plant": {"branches": [{"axis": a["name"], "masses": [1.0]} for a in axes]},
            },
        }
    )


def test_check_refuses_a_drive_whose_position_factor_is_not_one() -> None:
    master = connect(cell({"name": "A1", "node_id": 1}))
    bus: Any = master.link.bus
    for sub, value in enumerate((336, 10), 1):
        bus.cell.drives[0].node.od.add(0x6093, sub, "I", "rw", value)
    with pytest.raises(
        DriveError, match=r"contradicts itself.*0x6093 and 0x608F say.*Give position_rad_per_count"
    ):
        master.check()
    master.close()


def test_a_config_names_two_axes_of_one_node_and_each_has_its_own_objects() -> None:
    axes = [{"name": "A1", "node_id": 1}, {"name": "A2", "node_id": 1, "axis_of_node": 2}]
    config = cell(*axes)
    assert [a.axis_of_node for a in config.axes] == [1, 2]
    with pytest.raises(ValueError, match=r"node_id 1 \(axis_of_node 2\) is used by more than one axis"):
        cell(*axes, {"name": "A3", "node_id": 1, "axis_of_node": 2})
    second = NodeAxis.by_profile(2)
    assert second.at(od.TARGET_TORQUE).address == "0x6871"
    assert second.at(od.POSITION_LIMIT_LOW).address == "0x687D:1"
    assert second.at(od.CONSUMER_HEARTBEAT) == od.CONSUMER_HEARTBEAT
    assert second.at(od.pdo_mapping("TPDO", 1, 2)).address == "0x1A40:2"
    assert NodeAxis(2, 2).at(od.RPDO_EVENT_TIMER).address == "0x1401:5"
    assert NodeAxis().at(od.TARGET_TORQUE) == od.TARGET_TORQUE
    assert (second.pdo, second.cob_id("RPDO", 3), second.cob_id("TPDO", 3)) == (65, 0x303, 0x283)
    assert (NodeAxis().pdo, NodeAxis().cob_id("RPDO", 3), NodeAxis().cob_id("TPDO", 3)) == (1, 0x203, 0x183)
