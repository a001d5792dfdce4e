"""What no cause of the catalogue explains becomes a law: found, simulated, saved, then a cause by name."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import invid
from invid.cli.app import run
from invid.model.diagnosis_document import Verdict

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.generator import make


def test_a_hidden_drag_is_a_law_over_velocity_then_a_file_and_is_named_in_the_next_recording(
    tmp_path: Path,
) -> None:
    first, truth = make("power_drag", seed=980001, target_db=30.0, motors=1)
    hidden = truth.effects[0]
    diagnosis = invid.diagnose(first)
    assert diagnosis.verdict is Verdict.PARTLY_EXPLAINED, diagnosis.sentences
    (found,) = diagnosis.findings
    assert (found.cause, found.axis, found.element) == ("empirical_law", hidden.axis, hidden.element)
    table = found.effect.table
    assert table is not None
    assert table.over == "velocity"
    at, std = np.array(table.at), np.array(table.std)
    true = hidden.parameters["coefficient"] * np.sign(at) * np.abs(at) ** hidden.parameters["power"]
    beside = np.array(table.value) - true  # a damper takes a straight line of it
    beside -= at * (at @ beside) / (at @ at)
    assert (np.abs(beside) < 4.0 * std + 0.02 * np.abs(true).max()).all()
    (residual,) = diagnosis.residual
    assert residual.after < 1.3 * residual.noise_floor
    assert residual.before > 3.0 * residual.noise_floor

    document = tmp_path / "diagnosis.json"
    diagnosis.save(document)
    again = invid.load_diagnosis(document)
    assert again.findings == diagnosis.findings
    beside_it = invid.diagnose(first, model=again.model)
    assert beside_it.verdict is Verdict.CONSISTENT, beside_it.sentences

    own = tmp_path / "own.py"
    assert run(["effects", "new", "churned_oil", "--from", str(document), "-o", str(own)]) == 0
    number = int(str(hidden.element).split()[1])
    second, _ = make("power_drag", (0, number), hidden.parameters, seed=980001, motors=1, noise=0.002)
    named = invid.diagnose(second, effects=[own])
    assert [(f.cause, f.element) for f in named.findings] == [("churned_oil", hidden.element)]
