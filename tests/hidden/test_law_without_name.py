"""What no cause of the catalogue explains becomes a law: found, simulated, saved, then a cause by name."""

from pathlib import Path

import numpy as np

import invid
from hidden.generator import TrueEffect, make
from invid.cli.app import run
from invid.model.diagnosis_document import Verdict
from invid.model.law_table import LawTable
from invid.report.data import figure_data


def law_found(recording: invid.Recording, hidden: TrueEffect) -> tuple[invid.Diagnosis, LawTable]:
    """The diagnosis whose one finding is a law at the hidden place, at the noise; and its table."""
    diagnosis = invid.diagnose(recording)
    assert diagnosis.verdict is Verdict.PARTLY_EXPLAINED, diagnosis.sentences
    (found,) = diagnosis.findings
    assert (found.cause, found.axis, found.element) == ("empirical_law", hidden.axis, hidden.element)
    table = found.effect.table
    assert table is not None
    (residual,) = diagnosis.residual
    assert residual.after < 1.3 * residual.noise_floor
    assert residual.before > 3.0 * residual.noise_floor
    return diagnosis, table


def read_again(diagnosis: invid.Diagnosis, recording: invid.Recording, document: Path) -> invid.Diagnosis:
    """The same from its file; beside it the recording is consistent."""
    diagnosis.save(document)
    again = invid.load_diagnosis(document)
    assert again.findings == diagnosis.findings
    beside_it = invid.diagnose(recording, model=again.model)
    assert beside_it.verdict is Verdict.CONSISTENT, beside_it.sentences
    return again


def assert_named_next(folder: Path, name: str, hidden: TrueEffect, seed: int) -> None:
    """The law becomes an effect file, and that a name in the next recording."""
    own = folder / "own.py"
    assert run(["effects", "new", name, "--from", str(folder / "diagnosis.json"), "-o", str(own)]) == 0
    number = int(str(hidden.element).split()[1])
    second, _ = make(hidden.cause, (0, number), hidden.parameters, seed=seed, motors=1, noise=0.002)
    named = invid.diagnose(second, effects=[own])
    assert [(f.cause, f.element) for f in named.findings] == [(name, hidden.element)]


def test_a_hidden_drag_is_a_law_over_velocity_then_a_file_and_is_named_in_the_next_recording(
    tmp_path: Path,
) -> None:
    first, truth = make("power_drag", seed=980001, target_db=30.0, motors=1)
    hidden = truth.effects[0]
    diagnosis, table = law_found(first, hidden)
    assert table.over == "velocity"
    at, std = np.array(table.at), np.array(table.std)
    true = hidden.parameters["coefficient"] * np.sign(at) * np.abs(at) ** hidden.parameters["power"]
    beside = np.array(table.value) - true  # a damper takes a straight line of it
    beside -= at * (at @ beside) / (at @ at)
    assert (np.abs(beside) < 4.0 * std + 0.02 * np.abs(true).max()).all()
    read_again(diagnosis, first, tmp_path / "diagnosis.json")
    assert_named_next(tmp_path, "churned_oil", hidden, 980001)


def test_a_hidden_drag_that_depends_on_position_is_a_law_over_both_drawn_and_named_in_the_next_recording(
    tmp_path: Path,
) -> None:
    first, truth = make("position_damping", seed=980011, target_db=25.0, motors=1)
    hidden = truth.effects[0]
    diagnosis, table = law_found(first, hidden)
    assert table.quantities == ("velocity", "position")
    assert diagnosis.unexplained is not None
    assert {"velocity-dependent", "position-dependent"} <= set(diagnosis.unexplained.character)
    v, q = (x.ravel() for x in np.meshgrid(table.at, table.across_at, indexing="ij"))
    beside = np.column_stack((np.ones(v.size), v, q))  # offset, damper and a spring to ground are not told
    true = hidden.parameters["coefficient"] * q * v
    left = np.array(table.value) - true
    left -= beside @ np.linalg.lstsq(beside, left, rcond=None)[0]
    near = (np.abs(v) < 0.5 * v.max()) & (np.abs(q) < 0.5 * np.abs(q).max())
    assert np.abs(left[near]).max() < 0.1 * np.abs(true).max()
    again = read_again(diagnosis, first, tmp_path / "diagnosis.json")
    (view,) = figure_data(first, again.model, again)["views"]
    for side in view["sides"]:  # as both quantities are at the instants of the points
        assert np.std(np.subtract(side["y"], side["fit"]["y"])) < 0.3 * np.std(side["y"])
    assert "it depends on the position too" in view["note"]

    assert_named_next(tmp_path, "worn_guide", hidden, 980011)
