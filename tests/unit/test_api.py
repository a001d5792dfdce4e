"""``import invid``: the job in Python as the contract shows it, judged on what was hidden."""

import subprocess
import sys
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
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


def test_whoever_talks_to_a_bus_starts_without_tables_pictures_and_control() -> None:
    code = (
        "import sys, invid_service.serving, invid_service.jobs.worker, invid_drivers.realtime; "
        "from invid.cli.app import run; [run([c, '--help']) for c in ('measure', 'check', 'init')]; "
        "print(*sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"pandas", "asammdf", "matplotlib", "control", "polars", "scipy.signal", "scipy.stats"}
    assert not heavy & set(done.stderr.split())


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
