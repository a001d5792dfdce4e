"""Each form read back by its own reader."""

import csv
import io
import json
from pathlib import Path

import pytest
from canopen.objectdictionary import import_od
from tuning.tuned import tuned

from invid.errors import InputError
from invid.tuning.axis_loop import loops_from_json
from invid.tuning.forms import (
    write_tuning,
)
from invid.tuning.motor_scale import MotorScale
from invid_drivers.values.forms import drive_values_form
from invid_drivers.values.rows import DRIVES

MOTORS = {
    "A1": MotorScale(gear=50.0, torque_constant_Nm_per_A=0.05, node_id=3),
    "A2": MotorScale(gear=80.0, torque_constant_Nm_per_A=0.07, node_id=4),
}


@pytest.mark.parametrize(
    "broken", [{}, [], {"format": "invid-tuning", "format_version": 1, "axes": [{"axis": "A1"}]}]
)
def test_a_document_that_is_none_is_refused_in_a_sentence(broken: object):
    with pytest.raises(InputError, match=r"tuning\.json"):
        loops_from_json(broken, "tuning.json")


@pytest.mark.parametrize("name", sorted(DRIVES))
def test_a_dcf_is_read_by_canopen_and_holds_the_changed_objects_alone(name: str, tmp_path: Path):
    form = drive_values_form(name, tuned(), MOTORS)
    rows = list(csv.DictReader(io.StringIO(form.files[f"{name}-changes.csv"])))
    assert all(r["source"] for r in rows)
    for a in tuned().axes:
        path = tmp_path / f"{a.axis}.dcf"
        path.write_text(form.files[f"{a.axis}-{name}.dcf"], encoding="utf-8")
        od = import_od(str(path))
        assert od.node_id == MOTORS[a.axis].node_id
        assert {i for i in od if i >= 0x1000} == {row.at.index for row in DRIVES[name].rows}
        for row in DRIVES[name].rows:
            value = od[row.at.index][row.at.sub].value
            want = row.value(a.after, MOTORS[a.axis])
            assert float(value) == pytest.approx(want, rel=1e-5, abs=0.5 if row.at.code == "I" else 1e-6)


def test_the_folder_has_it_all_and_says_what_forms_do_not_hold(tmp_path: Path):
    written = write_tuning(tuned(), tmp_path / "tuned", motors=MOTORS)
    assert {
        "tuning.json",
        "tuning.csv",
        "tuning.html",
        "tuning.svg",
        "ros2_control.yaml",
    } <= set(written.files)
    assert "ros2_control" in written.losses
    document = json.loads((tmp_path / "tuned" / "tuning.json").read_text(encoding="utf-8"))
    assert document["losses"]["ros2_control"]
    with pytest.raises(InputError, match="B7"):
        write_tuning(tuned(), tmp_path, motors={"B7": MotorScale()})
