"""Values in the form that a controller reads: each form says what it cannot hold.

Forms of drives come from above the core by the entry point group ``invid.drive_values`` (``DriveForm``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import yaml
from pydantic import TypeAdapter, ValidationError

from invid.disk import not_written
from invid.errors import InputError
from invid.extensions import extension_names, load_extension
from invid.model.document import describe_validation_error, dump_json, save_text
from invid.tuning.document import tuning_table, tuning_to_json
from invid.tuning.motor_scale import MotorScale
from invid.tuning.page import tuning_page, tuning_picture
from invid.tuning.tune import Tuning

DRIVES = "invid.drive_values"
"""Entry point group of drives' own forms: a function (tuning, motors) → ``DriveForm`` by the drive's name."""


@dataclass(frozen=True)
class Form:
    """Texts of files by name, and what they do not hold, in sentences."""

    files: dict[str, str]
    losses: tuple[str, ...] = ()


class DriveForm(Protocol):
    """The form of one drive."""

    def __call__(self, tuning: Tuning, motors: dict[str, MotorScale]) -> Form: ...


def ros2_form(tuning: Tuning) -> Form:
    """Gains of ``joint_trajectory_controller`` on an effort interface, u = k_ff v_d + k_p e + k_i ∫e + k_d
    (v_d − v) (control.ros.org, ros2_controllers, Details about parameters)."""
    gains = {}
    for a in tuning.axes:
        p, i, d = a.after.gains.as_pid()
        gains[a.axis] = {"p": p, "i": i, "d": d, "ff_velocity_scale": a.after.feedforward.viscous}
    parameters = {
        "joints": [a.axis for a in tuning.axes],
        "command_interfaces": ["effort"],
        "state_interfaces": ["position", "velocity"],
        "gains": {k: {n: float(x) for n, x in g.items()} for k, g in gains.items()},
    }
    document = {
        "controller_manager": {"ros__parameters": {"update_rate": round(1.0 / tuning.settings.timing.cycle)}},
        "joint_trajectory_controller": {"ros__parameters": parameters},
    }
    lost = "joint_trajectory_controller has no inertia or dry friction feedforward, notch filter or shaper"
    return Form({"ros2_control.yaml": yaml.safe_dump(document, sort_keys=False, allow_unicode=True)}, (lost,))


def drive_names() -> list[str]:
    """Drives whose own values can be written."""
    return extension_names(DRIVES)


def drive_form(name: str) -> DriveForm:
    """The form of a drive; InputError names those there are."""
    form: DriveForm | None = load_extension(DRIVES, name)
    if form is None:
        raise InputError(f"--drive {name}: there are {', '.join(drive_names()) or 'none installed'}")
    return form


def read_motors(path: Path) -> dict[str, MotorScale]:
    """``MotorScale`` of each axis from YAML; InputError says what is wrong."""
    try:
        document: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    try:
        return TypeAdapter(dict[str, MotorScale]).validate_python(document)
    except ValidationError as error:
        raise InputError(describe_validation_error(error, str(path))) from None


@dataclass(frozen=True)
class WrittenTuning:
    """Files that were written, and what each form does not hold, in sentences."""

    folder: str
    files: tuple[str, ...]
    losses: dict[str, tuple[str, ...]]


def write_tuning(
    tuning: Tuning, folder: Path, *, drive: str | None = None, motors: dict[str, MotorScale] | None = None
) -> WrittenTuning:
    """Write the document, the page, the picture and every form into ``folder``."""
    known = motors or {}
    strange = set(known) - set(tuning.model.axes)
    if strange:
        raise InputError(f"motors: {sorted(strange)[0]!r} is no axis; the axes are {list(tuning.model.axes)}")
    made = {"ros2_control": ros2_form(tuning)}
    if drive is not None:
        made[drive] = drive_form(drive)(tuning, known)
    losses = {name: form.losses for name, form in made.items() if form.losses}
    files = {name: text for form in made.values() for name, text in form.files.items()}
    document = {**tuning_to_json(tuning), "losses": {k: list(v) for k, v in losses.items()}}
    files |= {
        "tuning.json": dump_json(document),
        "tuning.csv": tuning_table(tuning),
        "tuning.svg": tuning_picture(tuning),
        "tuning.html": tuning_page(tuning, losses),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise not_written(folder, error) from None
    for name, text in files.items():
        save_text(folder / name, text)
    return WrittenTuning(str(folder), tuple(sorted(files)), losses)
