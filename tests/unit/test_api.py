"""``import invid``: the job in Python as the contract shows it, judged on what was hidden."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.generator import Truth, make

import invid
from invid.model.diagnosis_document import diagnosis_to_json
from invid.model.document import model_to_json

HEAVY = ("numpy", "scipy", "numba", "h5py", "matplotlib", "pydantic", "typer", "yaml")


@pytest.fixture(scope="module")
def case() -> tuple[invid.Recording, Truth]:
    return make("coulomb_friction", (0, 1), seed=5, motors=1, masses=(2,), target_db=30.0, moves=False)


@pytest.fixture(scope="module")
def diagnosis(case: tuple[invid.Recording, Truth]) -> invid.Diagnosis:
    return invid.diagnose(case[0])


def test_the_job_from_a_file_to_the_named_cause_and_back_to_files(
    case: tuple[invid.Recording, Truth], tmp_path: Path
) -> None:
    made, truth = case
    invid.write_recording(made, tmp_path / "rec.h5")
    recording = invid.read_recording(str(tmp_path / "rec.h5"))
    model = invid.identify(recording, masses=[2])
    diagnosis = invid.diagnose(recording, model=model)
    assert diagnosis.verdict == "explained"
    finding = diagnosis.findings[0]
    assert (finding.cause, finding.axis, finding.element) == (
        "coulomb_friction",
        truth.effects[0].axis,
        "mass 1",
    )
    size, true = finding.parameters["torque"], truth.effects[0].parameters["torque"]
    assert size.std is not None
    assert abs(size.value - true) < min(4 * size.std, 0.05 * true)
    answer = invid.simulate(diagnosis.model, recording)
    for simulated, measured in zip(answer.experiments, recording.experiments, strict=True):
        assert np.std(simulated.position - measured.position) < 0.005 * np.std(measured.position)
    changes = invid.compare(model, diagnosis.model)
    assert [c.status for c in changes.effects if "coulomb_friction" in c.name] == ["unchanged"]
    model.save(tmp_path / "model.json")
    diagnosis.save(str(tmp_path / "diagnosis.json"))
    assert _plain(model_to_json(invid.load_model(tmp_path / "model.json"))) == _plain(model_to_json(model))
    loaded = invid.load_diagnosis(tmp_path / "diagnosis.json")
    assert _plain(diagnosis_to_json(loaded)) == _plain(diagnosis_to_json(diagnosis))
    assert loaded.findings[0].parameters["torque"] == size


def _plain(document: Any) -> Any:
    """As JSON has it: tuples are lists."""
    if isinstance(document, dict):
        return {k: _plain(v) for k, v in document.items()}
    return [_plain(v) for v in document] if isinstance(document, list | tuple) else document


def test_results_refuse_to_be_changed(diagnosis: invid.Diagnosis) -> None:
    with pytest.raises(FrozenInstanceError):
        diagnosis.verdict = "consistent"  # type: ignore[misc, assignment]
    with pytest.raises(TypeError, match="immutable"):
        diagnosis.details["null_test"] = 1  # type: ignore[index]
    with pytest.raises(TypeError, match="immutable"):
        diagnosis.model.fit.update(trustworthy=True)  # type: ignore[attr-defined]
    with pytest.raises(TypeError, match="immutable"):
        diagnosis.findings[0].parameters.pop("torque")  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="read-only"):
        diagnosis.model.chains.masses[0][0] = 1.0


@pytest.mark.campaign
def test_several_recordings_of_one_machine_are_diagnosed_together(
    case: tuple[invid.Recording, Truth],
) -> None:
    """Each half of the experiments alone knows less than both: the standard deviation says so."""
    recording, truth = case
    halves = [
        replace(recording, experiments=tuple(_part(e, k) for e in recording.experiments), source=f"part {k}")
        for k in (0, 1)
    ]
    alone, both = invid.diagnose(halves[0]), invid.diagnose(halves)
    assert len(both.findings) == 1
    size = both.findings[0].parameters["torque"]
    single = alone.findings[0].parameters["torque"]
    assert both.findings[0].cause == truth.effects[0].cause
    assert size.std is not None
    assert single.std is not None
    assert size.std < 0.9 * single.std
    assert abs(size.value - truth.effects[0].parameters["torque"]) < 4 * size.std


def _part(e: invid.Experiment, half: int) -> invid.Experiment:
    """One half of the periods of an experiment."""
    count = e.periods // 2 * e.period_samples
    rows = slice(half * count, (half + 1) * count)
    columns = ("time", "position", "torque", "torque_demand", "status")
    return replace(e, **{c: None if getattr(e, c) is None else getattr(e, c)[rows] for c in columns})


def test_recordings_of_different_machines_are_refused_in_words(case: tuple[invid.Recording, Truth]) -> None:
    recording = case[0]
    other = replace(recording, axes=("B1",), source="other.h5")
    with pytest.raises(invid.InputError, match=r"other\.h5: axes \['B1'\].*not the same robot"):
        invid.diagnose([recording, other])
    coarse = replace(recording, encoder_resolution=np.array([0.01]), source="coarse.h5")
    with pytest.raises(invid.InputError, match=r"encoder_resolution is .*0\.01.*not the same machine"):
        invid.diagnose([replace(recording, encoder_resolution=np.array([0.001])), coarse])
    with pytest.raises(invid.InputError, match="no recording was given"):
        invid.diagnose([])


def test_a_model_and_masses_together_are_refused(
    case: tuple[invid.Recording, Truth], diagnosis: invid.Diagnosis
) -> None:
    with pytest.raises(invid.InputError, match="give one of the two"):
        invid.diagnose(case[0], model=diagnosis.model, masses=[2])


def test_what_is_no_diagnosis_is_said(tmp_path: Path, diagnosis: invid.Diagnosis) -> None:
    diagnosis.model.save(tmp_path / "model.json")
    with pytest.raises(invid.InputError, match=r"model\.json: no diagnosis: format is 'invid-model'"):
        invid.load_diagnosis(tmp_path / "model.json")
    diagnosis.save(tmp_path / "d.json")
    text = (tmp_path / "d.json").read_text(encoding="utf-8")
    (tmp_path / "d.json").write_text(
        text.replace('"confidence": ', '"confidence": "no", "x": '), encoding="utf-8"
    )
    with pytest.raises(invid.InputError, match=r"d\.json: findings: 0\.confidence.*found 'no'"):
        invid.load_diagnosis(tmp_path / "d.json")
    with pytest.raises(invid.InputError, match="no such file"):
        invid.load_diagnosis(tmp_path / "none.json")


def test_a_table_with_plain_names_is_imported_and_what_was_assumed_is_a_warning(tmp_path: Path) -> None:
    time = np.arange(400) / 200.0
    rows = np.column_stack((time, np.sin(time), np.cos(time)))
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="time,position,torque", comments="")
    with pytest.warns(UserWarning, match="no map was given"):
        recording = invid.import_recording(tmp_path / "log.csv", created="2026-11-21T10:00:00Z")
    assert recording.experiments[0].position.shape == (400, 1)
    assert recording.created == "2026-11-21T10:00:00Z"
    with pytest.raises(TypeError, match="immutable"):
        recording.attributes["x"] = 1
    with pytest.raises(invid.InputError, match=r"none\.yaml: cannot be read: No such file"):
        invid.import_recording(tmp_path / "log.csv", tmp_path / "none.yaml")


def test_arguments_of_the_wrong_kind_are_said_with_the_way_out(
    case: tuple[invid.Recording, Truth], diagnosis: invid.Diagnosis, tmp_path: Path
) -> None:
    recording, model, anything = case[0], diagnosis.model, cast("Any", invid)
    calls: list[tuple[str, Callable[[], object]]] = [
        (r"path is None; give the path", lambda: anything.read_recording(None)),
        (r"path is None; give the path", lambda: anything.load_model(None)),
        (r"path is 3; give the path", lambda: anything.load_diagnosis(3)),
        (r"recording is 'r\.h5'; give .*read_recording", lambda: anything.write_recording("r.h5", "x.h5")),
        (r"path is None", lambda: anything.write_recording(recording, None)),
        (r"source is 5; give the path", lambda: anything.import_recording(5)),
        (r"source is None", lambda: anything.import_recording([tmp_path, None])),
        (r"map is of type dict; give the path", lambda: anything.import_recording("log.csv", {})),
        (r"created is 'today'; give an ISO", lambda: anything.import_recording("log.csv", created="today")),
        (r"recording is 'r\.h5'; give .*read_recording", lambda: anything.identify("r.h5")),
        (r"recording is '.*r\.h5'; give .*read_recording", lambda: anything.identify(tmp_path / "r.h5")),
        (r"recording 2 is 'r\.h5'", lambda: anything.identify([recording, "r.h5"])),
        (r"method is 'nonsense'; give 'refined' or", lambda: anything.identify(recording, method="nonsense")),
        *(
            (r"masses is .*give one whole number ≥ 1", lambda m=m: anything.identify(recording, masses=m))
            for m in ("three", "2", 2, [0], [-2], [2, 2], [2.5], ["2"], [True], [], np.array([2.0]))
        ),
        (r"budget is '5'; give a number", lambda: anything.identify(recording, budget="5")),
        (r"budget is nan; give a number", lambda: anything.identify(recording, budget=float("nan"))),
        (r"budget is 0; give a number", lambda: anything.diagnose(recording, budget=0)),
        (r"progress is 'yes'; give a function", lambda: anything.identify(recording, progress="yes")),
        (r"effects is 'drag\.py'; give a list", lambda: anything.diagnose(recording, effects="drag.py")),
        (r"effects is 5; each must be", lambda: anything.diagnose(recording, effects=[5])),
        (r"recording is None; give", lambda: anything.diagnose(None)),
        (r"masses is 'three'", lambda: anything.diagnose(recording, masses="three")),
        (r"model is 'm\.json'; give .*load_model", lambda: anything.diagnose(recording, model="m.json")),
        (r"model is a diagnosis; .*diagnosis\.model", lambda: anything.diagnose(recording, model=diagnosis)),
        (r"model is a diagnosis", lambda: anything.simulate(diagnosis, recording)),
        (r"recording is of type list; give", lambda: anything.simulate(model, [recording])),
        (r"rng is 5; give a generator", lambda: anything.simulate(model, recording, rng=5)),
        (r"only is '000'; give a list of keys", lambda: anything.simulate(model, recording, only="000")),
        (r"only is \['9'\]; give a list of keys", lambda: anything.simulate(model, recording, only=["9"])),
        (r"old is 'm\.json'; give .*load_model", lambda: anything.compare("m.json", model)),
        (r"new is a diagnosis", lambda: anything.compare(model, diagnosis)),
        (r"tolerance is '1'; give a number", lambda: anything.compare(model, model, tolerance="1")),
        (r"alpha is None; give a number", lambda: anything.compare(model, model, alpha=None)),
        (r"model is 'm\.json'", lambda: anything.export("m.json", "urdf", tmp_path / "m.urdf")),
        (r"paper", lambda: anything.export(model, "paper", tmp_path / "m.x")),
        (r"to is \['urdf'\]", lambda: anything.export(model, ["urdf"], tmp_path / "m.urdf")),
        (r"path is None", lambda: anything.export(model, "urdf", None)),
    ]
    for said, call in calls:
        with pytest.raises(invid.InvidError, match=said):
            call()


def test_the_import_loads_nothing_heavy() -> None:
    code = "import sys, invid; print(*{m.split('.')[0] for m in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(HEAVY) & set(done.stdout.split())


def test_the_list_of_commands_loads_no_command() -> None:
    code = "import sys; from invid.cli.app import run; run(['--help']); print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(HEAVY) - {"typer"} & {m.split(".")[0] for m in done.stderr.split()}
    said = {
        row.split()[0]: row.split()[1:] for row in done.stdout.splitlines() if row[:2] == "  " and row[2:]
    }
    assert all(len(said[command]) > 3 for command in ("measure", "identify", "serve"))
    assert said["serve"] != said["keys"]


def test_an_identification_loads_only_what_loads_fast_of_scipy(
    case: tuple[invid.Recording, Truth], tmp_path: Path
) -> None:
    invid.write_recording(case[0], tmp_path / "rec.h5")
    code = "import sys, invid; invid.identify(invid.read_recording('rec.h5')); print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert not {"scipy.signal", "scipy.stats"} & set(done.stdout.split())


def test_every_public_name_is_there_and_documented() -> None:
    for name in invid.__all__:
        assert getattr(invid, name).__doc__, name
    assert invid.__version__
    with pytest.raises(AttributeError, match="no attribute 'measure'"):
        invid.measure  # noqa: B018
