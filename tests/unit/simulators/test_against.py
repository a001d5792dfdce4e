"""A user's simulator against a recording of a machine that MuJoCo simulated: what is wrong, and its copy."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines.mujoco_cells import Cell, drawn, measured, users, write, wrong

import invid
from invid.cli.app import run
from invid.errors import InputError
from invid.simulators.judge import judge
from invid.simulators.open import open_simulator


@pytest.fixture(scope="module")
def linear(tmp_path_factory: pytest.TempPathFactory) -> tuple[Cell, Path, invid.Recording]:
    folder = tmp_path_factory.mktemp("linear")
    cell = drawn(3, kinds=(), motion="multisine", sizes=(2, 2))
    write(cell, measured(cell), folder / "rec.h5")
    return cell, folder, invid.read_recording(folder / "rec.h5")


@pytest.fixture(scope="module")
def diagnosis(linear: Any) -> Any:
    return invid.diagnose(linear[2], budget=60)


@pytest.mark.campaign
def test_the_xml_that_made_the_recording_is_called_right(linear: Any, diagnosis: Any) -> None:
    cell, folder, recording = linear
    (folder / "right.xml").write_text(users(cell))
    found = judge(recording, diagnosis, open_simulator(folder / "right.xml", recording.axes))
    assert found["right"]
    assert (found["parameters"], found["missing"], found["corrected"]) == ([], [], None)
    assert found["held_out"]["before"] == pytest.approx(1.0, abs=0.15)


@pytest.mark.campaign
@pytest.mark.parametrize("kind", ["xml", pytest.param("json", marks=pytest.mark.campaign)])
def test_wrong_numbers_are_told_and_the_corrected_copy_reaches_the_noise_in_its_own_engine(
    linear: Any, diagnosis: Any, kind: str
) -> None:
    cell, folder, recording = linear
    path = folder / f"wrong.{kind}"
    other = wrong(cell, 0.3)
    if kind == "xml":
        path.write_text(users(other))
    else:
        chains = diagnosis.model.chains
        masses = tuple(np.array(m) * f for m, f in zip(chains.masses, (1.2, 0.8), strict=True))
        replace(diagnosis.model, chains=replace(chains, masses=masses)).save(path)
    found = judge(recording, diagnosis, open_simulator(path, recording.axes), folder / f"right.{kind}")
    assert not found["right"]
    assert found["held_out"]["before"] > 20.0
    assert found["held_out"]["after"] < 1.3
    names = {p["name"]: p for p in found["parameters"]}
    told = names["R1 mass 1"]
    assert abs(told["value"] / cell.inertia[0][0] - 1.0) < 0.01
    if kind == "xml":
        assert told["simulator"] == pytest.approx(other.inertia[0][0])
        again = judge(recording, diagnosis, open_simulator(folder / "right.xml", recording.axes))
        assert again["right"]


def test_the_inertia_of_a_corrected_xml_is_the_one_asked_for_with_the_coupling_of_its_links(
    linear: Any,
) -> None:
    cell, folder, recording = linear
    model = invid.identify(recording)
    (folder / "w.xml").write_text(users(wrong(cell, 0.5)))
    open_simulator(folder / "w.xml", recording.axes).corrected(model, folder / "c.xml")
    claimed = open_simulator(folder / "c.xml", recording.axes).claimed()
    assert claimed is not None
    for ours, theirs in zip(claimed.chains.masses, model.chains.masses, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4)
    np.testing.assert_allclose(claimed.chains.couplings, model.chains.couplings, atol=1e-4)


@pytest.mark.campaign
@pytest.mark.parametrize("kind", ["plastic", "cogging"])
def test_a_missing_cause_is_named_and_stands_in_the_copy_as_an_element_of_mujoco(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = drawn(4, kinds=(kind,), motion="multisine", sizes=(2,), size=0.5)
    write(cell, measured(cell), tmp_path / "rec.h5")
    (tmp_path / "robot.xml").write_text(users(wrong(cell, 0.2)))
    args = ["diagnose", f"{tmp_path}/rec.h5", "--against", f"{tmp_path}/robot.xml", "--json"]
    assert run([*args, "--corrected", f"{tmp_path}/mended.xml", "-o", f"{tmp_path}/d.json"]) == 0
    found = json.loads(capsys.readouterr().out)["against"]
    cause = {"plastic": "spring_hysteresis", "cogging": "cogging"}[kind]
    assert [m["cause"] for m in found["missing"]] == [cause]
    assert found["cannot_hold"] == []
    # The cell's hold works inside its drive, which no recording tells from one held over the sample: its
    # motor's mass is known to 0.2 %, where the springs' constants are to 0.01 %, which shows above 10 Hz.
    most = 1.3 if kind == "cogging" else 0.01 * found["held_out"]["before"]
    assert found["held_out"]["after"] < most < found["held_out"]["before"]
    element = {"plastic": "springyield=", "cogging": 'input="none"'}[kind]
    assert element in (tmp_path / "mended.xml").read_text()
    loaded = invid.load_diagnosis(tmp_path / "d.json").against
    assert json.loads(json.dumps(loaded)) == found


def test_what_is_no_simulator_of_the_machine_is_refused_with_the_way_out(tmp_path: Path, linear: Any) -> None:
    _, _, recording = linear
    for name, text, says in (
        ("a.txt", "", "MuJoCo XML"),
        ("a.xml", "<mujoco/>", "drives 0 joints"),
        ("b.xml", "<robot", "b.xml"),
        ("a.fmu", "", "no FMU"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(invid.InputError, match=says):
            open_simulator(tmp_path / name, recording.axes)
    with pytest.raises(invid.InputError, match="needs against"):
        invid.diagnose(recording, corrected=tmp_path / "c.xml")


@pytest.mark.parametrize("name", ["arm.urdf.xacro", "robot.xacro", "bench.sdf", "cell.usd", "cell.usda"])
def test_other_descriptions_of_robots_are_refused_with_a_way_that_keeps_the_file(tmp_path, name):
    path = tmp_path / name
    path.write_text("<robot/>")
    with pytest.raises(InputError) as refused:
        open_simulator(path, ["A1"])
    assert refused.value.code == "simulator_not_read"
    assert refused.value.way_out
    assert f"> {name}" not in str(refused.value)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ModuleNotFoundError("No module named 'mujoco'", name="mujoco"), "not installed.*invid.against"),
        (
            ImportError("cannot import name '_x' from 'mujoco'", name="mujoco"),
            "does not load.*force-reinstall mujoco",
        ),
        (
            ImportError("libmujoco.so.4: cannot open shared object", name="mujoco._structs"),
            "force-reinstall mujoco",
        ),
    ],
)
def test_an_engine_that_does_not_load_is_said_with_the_way(tmp_path, monkeypatch, error, said):
    def fails(name):
        raise error

    path = tmp_path / "a.xml"
    path.write_text("<mujoco/>")
    monkeypatch.setattr("invid.simulators.open.import_module", fails)
    with pytest.raises(InputError, match=said):
        open_simulator(path, ["A1"])
