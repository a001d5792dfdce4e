"""Tuned values as files for drives: a DCF an axis with what changes, and a list of it.

Whoever loads a DCF decides: nothing here writes to a drive.
"""

from __future__ import annotations

import io
from functools import partial
from typing import Any

from canopen.objectdictionary import ObjectDictionary, ODRecord, ODVariable, datatypes
from canopen.objectdictionary.eds import export_eds

from invid.model.document import csv_text
from invid.tuning.forms import Form
from invid.tuning.motor_scale import MotorScale
from invid.tuning.tune import Tuning
from invid_drivers.values.rows import DRIVES, DriveValue, DriveValues

_TYPES = {"H": datatypes.UNSIGNED16, "I": datatypes.UNSIGNED32, "f": datatypes.REAL32}


def drive_values_form(name: str, tuning: Tuning, motors: dict[str, MotorScale]) -> Form:
    """A DCF for each axis and one list of all changed objects, before and after, with their sources.

    InputError where an axis' gear, or torque constant if the drive counts in amperes, is not stated.
    """
    drive, files = DRIVES[name], {}
    rows = []
    for a in tuning.axes:
        motor = drive.motor(a.axis, motors)
        values = {row: row.value(a.after, motor) for row in drive.rows}
        files[f"{a.axis}-{name}.dcf"] = dcf(drive, values, motor.node_id)
        for row, after in values.items():
            old = row.value(a.before, motor)
            counts = row.count(old), row.count(after)
            rows.append((a.axis, row.at.address, row.at.name, *counts, row.unit, row.source))
    head = ("axis", "object", "name", "before", "after", "unit", "source")
    files[f"{name}-changes.csv"] = csv_text(head, rows)
    losses = (*drive.losses, f"before is {tuning.before_source}")
    return Form(files, losses)


epos4_form = partial(drive_values_form, "epos4")
ax8000_form = partial(drive_values_form, "beckhoff_ax8000")
"""By name for the entry points."""


def dcf(drive: DriveValues, values: dict[DriveValue, float], node_id: int) -> str:
    """A DCF that holds these objects alone."""
    od: Any = ObjectDictionary()  # type: ignore[no-untyped-call]
    od.node_id = node_id
    od.device_information.product_name = drive.name
    od.comments = "Changed objects alone, by invid tune. Look at the list beside it before you load it."
    for row, value in values.items():
        variable: Any = ODVariable(row.at.name, row.at.index, row.at.sub)
        variable.data_type = _TYPES[row.at.code]
        variable.access_type = "rw"
        variable.value = row.count(value)
        if row.at.index not in od:
            od.add_object(ODRecord(row.at.name.rsplit(" ", 2)[0], row.at.index))
        od[row.at.index].add_member(variable)
    stream = io.StringIO()
    facts = {"FileName": "tuned.dcf", "FileVersion": 1}
    export_eds(od, stream, facts, device_commisioning=True)  # type: ignore[no-untyped-call]
    return stream.getvalue()
