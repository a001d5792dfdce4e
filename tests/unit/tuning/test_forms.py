"""Each form read back by its own reader."""

from __future__ import annotations

import configparser
import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from canopen.objectdictionary import import_od
from tuning.tuned import tuned

from invid.errors import InputError
from invid.tuning.document import loops_from_json, tuning_table, tuning_to_json, values_of
from invid.tuning.forms import (
    drive_form,
    klipper_form,
    moveit_form,
    plc_form,
    ros2_form,
    write_tuning,
)
from invid.tuning.motor_scale import MotorScale
from invid.tuning.page import tuning_page, tuning_picture
from invid.tuning.servo_loop import Notch
from invid.tuning.shapers import choose_shaper
from invid.tuning.tune import Tuning
from invid_drivers.cia402.stated.vendors import VENDORS
from invid_drivers.drive_values import DRIVES, NOT_FOUND, drive_values_form

MOTORS = {
    "A1": MotorScale(gear=50.0, torque_constant_Nm_per_A=0.05, node_id=3, torque_limit_Nm=20.0),
    "A2": MotorScale(gear=80.0, torque_constant_Nm_per_A=0.07, node_id=4),
}


def with_all() -> Tuning:
    """The tuning with a notch and a shaper on every axis, whatever the machine needed."""
    axes = tuple(
        replace(
            a,
            after=replace(
                a.after,
                gains=replace(a.after.gains, notches=(Notch(45.0, 0.1, 0.6),)),
                shaper=choose_shaper((6.0, 0.05), [(6.1, 0.05)]),
            ),
        )
        for a in tuned().axes
    )
    return replace(tuned(), axes=axes)


def test_the_document_gives_its_loops_back():
    document = json.loads(json.dumps(tuning_to_json(with_all()), allow_nan=False))
    loops = loops_from_json(document, "tuning.json")
    for a in with_all().axes:
        assert loops[a.axis].gains == a.after.gains
        forward, read = a.after.feedforward, loops[a.axis].feedforward
        assert (read.inertia, read.dry, read.viscous) == (forward.inertia, forward.dry, forward.viscous)
        assert loops[a.axis].shaper.kind == a.after.shaper.kind


@pytest.mark.parametrize(
    "broken", [{}, [], {"format": "invid-tuning", "format_version": 1, "axes": [{"axis": "A1"}]}]
)
def test_a_document_that_is_none_is_refused_in_a_sentence(broken: object):
    with pytest.raises(InputError, match=r"tuning\.json"):
        loops_from_json(broken, "tuning.json")


def test_the_table_holds_every_value():
    rows = list(csv.DictReader(io.StringIO(tuning_table(tuned()))))
    assert [(r["axis"], r["name"]) for r in rows] == [(v.axis, v.name) for v in values_of(tuned())]
    for row, value in zip(rows, values_of(tuned()), strict=True):
        assert value.after is not None
        assert float(row["after"]) == pytest.approx(value.after, rel=1e-8)


def test_klippers_block_is_read_by_a_parser_as_klippers():
    text = klipper_form(with_all(), {}).files["klipper.cfg"]
    # as klippy/configfile.py makes its own
    parser = configparser.RawConfigParser(strict=False, inline_comment_prefixes=(";", "#"))
    parser.read_string(text)
    block = parser["input_shaper"]
    for a, letter in zip(with_all().axes, "xyz", strict=False):
        assert block[f"shaper_type_{letter}"] in ("zv", "mzv", "zvd", "ei", "2hump_ei", "3hump_ei")
        assert block.getfloat(f"shaper_freq_{letter}") == pytest.approx(a.after.shaper.frequency, abs=1e-3)
        assert 0 < block.getfloat(f"damping_ratio_{letter}") < 1


def test_the_gains_of_ros2_control_are_the_same_law():
    document = yaml.safe_load(ros2_form(tuned(), {}).files["ros2_control.yaml"])
    parameters = document["joint_trajectory_controller"]["ros__parameters"]
    assert parameters["joints"] == ["A1", "A2"]
    for a in tuned().axes:
        g, own = parameters["gains"][a.axis], a.after.gains
        # u = k_p e + k_i ∫e + k_d ė against K_v (1 + 1/(T_i s)) (K_p + s) e
        for s in (2.0j, 30.0j):
            law = g["p"] + g["i"] / s + g["d"] * s
            assert law == pytest.approx(
                own.velocity_gain * (1 + 1 / (own.integral_time * s)) * (own.position_gain + s)
            )


def test_the_acceleration_limit_of_moveit_takes_the_torque_limit():
    form = moveit_form(tuned(), MOTORS)
    limits = yaml.safe_load(form.files["moveit_joint_limits.yaml"])["joint_limits"]
    forward = tuned().axes[0].after.feedforward
    assert limits["A1"]["max_acceleration"] * forward.inertia + forward.dry == pytest.approx(20.0)
    assert "A2" not in limits
    assert any("A2" in text and "torque_limit_Nm" in text for text in form.losses)


def test_names_for_a_plc_have_a_page_each():
    rows = list(csv.DictReader(io.StringIO(plc_form(with_all(), {}).files["plc-names.csv"])))
    names = {r["name"].rpartition(".")[2] for r in rows}
    assert {"fNotchFreq", "fBandwidth", "fNotchFrequency", "fQ", "Backlash", "fBacklash"} <= names
    assert all(r["source"].startswith(("infosys.beckhoff.com/", "content.helpme-codesys.com/")) for r in rows)
    q = float(next(r["value"] for r in rows if r["name"].endswith("fQ")))
    assert q == pytest.approx(1 / 1.2)


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


def test_amperes_at_the_shaft_make_the_torque_at_the_axis():
    row = DRIVES["epos4"].rows[0]
    motor, axis = MOTORS["A1"], tuned().axes[0]
    amperes_per_shaft_speed = 1e-6 * row.value(axis.after, motor)
    shaft_speed = 1.0 * motor.gear  # at 1 rad/s of the axis
    torque = amperes_per_shaft_speed * shaft_speed * motor.torque_constant_Nm_per_A * motor.gear
    assert torque == pytest.approx(axis.after.gains.velocity_gain)


def test_a_drive_in_amperes_asks_for_the_torque_constant():
    with pytest.raises(InputError, match=r"torque_constant_Nm_per_A of A1"):
        drive_values_form("epos4", tuned(), {"A1": MotorScale(gear=2.0)})


def test_every_drive_of_the_table_of_vendors_is_here_or_said_to_be_missing():
    assert set(VENDORS) - {"generic"} == (set(DRIVES) & set(VENDORS)) | set(NOT_FOUND)
    with pytest.raises(InputError, match="--drive elmo_gold"):
        drive_form("elmo_gold")


def test_the_folder_has_it_all_and_says_what_forms_do_not_hold(tmp_path: Path):
    written = write_tuning(tuned(), tmp_path / "tuned", motors=MOTORS)
    assert {
        "tuning.json",
        "tuning.csv",
        "tuning.html",
        "tuning.svg",
        "ros2_control.yaml",
        "klipper.cfg",
    } <= set(written.files)
    assert "klipper" in written.losses
    document = json.loads((tmp_path / "tuned" / "tuning.json").read_text(encoding="utf-8"))
    assert document["losses"]["ros2_control"]
    with pytest.raises(InputError, match="B7"):
        write_tuning(tuned(), tmp_path, motors={"B7": MotorScale()})


def test_page_and_picture_show_every_axis_and_escape_what_is_data():
    strange = replace(tuned(), model=replace(tuned().model, robot="<script>alert(1)</script>"))
    page = tuning_page(strange, {"klipper": ("<b>",)})
    assert "<script>" not in page
    assert page.count("worst peak of sensitivity") == 2
    assert tuning_picture(tuned()).startswith("<?xml")
    assert np.isfinite(tuned().run_after.load).all()
