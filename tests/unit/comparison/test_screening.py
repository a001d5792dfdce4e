"""A short record against an accepted model: nothing found where nothing changed, else what did."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from invid.api import screen
from invid.cli.app import run
from invid.config import CellConfig, load_config
from invid.errors import ModelError, SafetyStop
from invid.identification.identify import identify
from invid.model.document import Model, save_model
from invid.recording import Recording, read_recording
from invid_drivers.cli.measure import screen_cell
from invid_drivers.measurement import measure_to_file

CELL = """\
format: invid-config
format_version: 1
robot: two axes
bus: {interface: invid-virtual, channel: two, cycle_s: 0.002}
axes:
  - {name: A1, node_id: 1, rated_torque_Nm: 50, masses: 2, inertia_kgm2: 3.0, gravity_loaded: false,
     limits: {torque_Nm: 25, position_window_rad: 1.0, velocity_rad_per_s: 5, stopping_room_rad: 3}}
  - {name: A2, node_id: 2, rated_torque_Nm: 80, masses: 2, inertia_kgm2: 7.0, gravity_loaded: false,
     limits: {torque_Nm: 40, position_window_rad: 1.0, velocity_rad_per_s: 5, stopping_room_rad: 3}}
safety: {heartbeat_s: 0.03}
experiments:
  - {kind: multisine, band_Hz: [0.5, 12], period_s: 2.048, periods: 3}
simulation:
  seed: SEED
  plant:
    branches:
      - {axis: A1, masses_kgm2: [1.0, 2.0], springs_Nm_per_rad: [SPRING], dampers_Nms_per_rad: [1.0]}
      - {axis: A2, masses_kgm2: [1.5, LOAD], springs_Nm_per_rad: [4000], dampers_Nms_per_rad: [3.0]}
  defaults: {torque_noise_fraction_of_rated: 0.002}
  axes:
    A1: {friction: {coulomb_Nm: 0.2, viscous_Nms_per_rad: 0.2}}
    A2: {friction: {coulomb_Nm: 0.4, viscous_Nms_per_rad: 0.4}}
"""
pytestmark = pytest.mark.xdist_group("screening")


def cell_file(folder: Path, seed: int, *, load: float = 5.97, spring: float = 1500.0) -> Path:
    path = folder / f"cell-{seed}.yaml"
    path.write_text(CELL.replace("SEED", str(seed)).replace("LOAD", str(load)).replace("SPRING", str(spring)))
    return path


def cell(folder: Path, seed: int, *, load: float = 5.97, spring: float = 1500.0) -> CellConfig:
    return load_config(cell_file(folder, seed, load=load, spring=spring))


@pytest.fixture(scope="module")
def accepted(tmp_path_factory: pytest.TempPathFactory) -> Model:
    folder = tmp_path_factory.mktemp("accepted")
    measure_to_file(cell(folder, 1), folder / "r.h5")
    return identify(read_recording(folder / "r.h5"))


@pytest.mark.campaign
def test_an_unchanged_cell_is_said_to_be_unchanged_and_what_would_have_been_seen(
    accepted: Model, tmp_path: Path
) -> None:
    config = cell(tmp_path, 2)
    result, found = screen_cell(config, accepted, tmp_path / "r.h5")
    assert result.duration_s < 10  # doublets, the climb of its trial and one block
    assert (found.verdict, found.changed) == ("unchanged", ())
    assert found.sentence.startswith("Nothing changed since the accepted model")
    assert "would have been found" in found.sentence
    assert found.comparison is not None
    # Friction that a record of seconds could not name by itself is compared as the accepted model has it.
    assert {c.status.value for c in found.comparison.causes} <= {"unchanged", "cannot_tell"}


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("changed", "parameter", "by"),
    [({"load": 7.28}, "A2.mass.2", 1.31), ({"spring": 1400.0}, "A1.spring.1", -100.0)],
)
def test_what_changed_is_named_with_its_size(
    accepted: Model, tmp_path: Path, changed: dict[str, float], parameter: str, by: float
) -> None:
    config = cell(tmp_path, 3, **changed)
    _, found = screen_cell(config, accepted, tmp_path / "r.h5")
    assert found.verdict == "changed"
    assert found.changed == (parameter[:2],)
    assert found.sentence.endswith("Measure in full to take it over.")
    assert found.comparison is not None
    (told,) = [c for c in found.comparison.parameters if c.status == "changed"]
    assert told.name == parameter
    assert told.difference is not None
    assert told.std is not None
    assert abs(told.difference - by) < 4 * told.std
    assert told.std < 0.06 * abs(by)


@pytest.mark.parametrize("heavier", [0.2, 5.0])
def test_an_axis_that_its_model_does_not_know_again_is_weighed_and_refused(
    accepted: Model, tmp_path: Path, heavier: float
) -> None:
    document = cell(tmp_path, 6).model_dump(mode="python")
    branch = document["simulation"]["plant"]["branches"][0]
    for key in ("masses_kgm2", "springs_Nm_per_rad", "dampers_Nms_per_rad"):
        branch[key] = [heavier * value for value in branch[key]]
    changed = CellConfig.model_validate(document)
    with pytest.raises(SafetyStop, match="which no elastic axis explains") as stopped:
        screen_cell(changed, accepted, tmp_path / "r.h5")
    assert (stopped.value.code, stopped.value.axis) == ("scales", "A1")


def test_the_command_answers_in_json_and_by_its_exit_status(
    accepted: Model, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_model(accepted, tmp_path / "model.json")
    config, out = str(cell_file(tmp_path, 4, load=7.28)), str(tmp_path / "r.h5")
    command = ["measure", config, "--screen", "-o", out, "--json"]
    model = ["--model", str(tmp_path / "model.json")]
    assert run([*command, *model]) == 0
    told = json.loads(capsys.readouterr().out)["screening"]
    assert (told["verdict"], told["changed"]) == ("changed", ["A2"])
    assert told["comparison"]["format"] == "invid-comparison"
    assert run(command) == 2
    assert "--model" in capsys.readouterr().err
    assert run([*command, *model, "--amplitude", "0.5"]) == 2


def test_a_model_without_covariance_or_of_another_cell_is_refused(accepted: Model) -> None:
    recording = Recording("r", accepted.axes, "rad", "N·m", "2026-01-01T00:00:00Z", ())
    with pytest.raises(ModelError, match="its own model"):
        screen(replace(recording, axes=("X", "Y")), accepted)
    with pytest.raises(ModelError, match="no covariance"):
        screen(recording, replace(accepted, covariance=None, parameter_names=()))
