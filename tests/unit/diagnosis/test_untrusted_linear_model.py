"""A diagnosis on a linear model that is wrong says so first, and names nothing."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from hidden.generator import make

from invid.cli.app import run
from invid.diagnosis.diagnose import diagnose
from invid.model.diagnosis_document import Verdict
from invid.recording import Recording, write_recording

SEED = 11


@pytest.fixture(scope="module")
def recording() -> Recording:
    """One axis, two masses or more, without any effect."""
    return make(None, seed=SEED, motors=1, masses=(3,))[0]


@pytest.mark.campaign
@pytest.mark.parametrize("masses", [1, 2])
def test_too_few_masses_are_said_first_and_nothing_is_named_with_confidence(recording, masses) -> None:
    d = diagnose(recording, masses=(masses,))
    if d.findings:  # a mode too few is an extra mode, which explains nearly all
        assert [f.effect.cause for f in d.findings] == ["extra_mode"]
        assert d.residual[0].after < 0.05 * d.residual[0].before
        return
    assert d.verdict is Verdict.UNEXPLAINED
    assert "cannot be trusted" in d.sentences[0]
    assert d.warnings[0] == d.sentences[0]
    assert not d.model.fit["trustworthy"]


@pytest.mark.campaign
def test_the_command_leaves_with_3_and_one_document_when_the_model_is_wrong(
    recording, tmp_path, capsys
) -> None:
    path = tmp_path / "rec.h5"
    write_recording(recording, path)
    assert run(["diagnose", str(path), "--masses", "1", "--json"]) == 3
    out = json.loads(capsys.readouterr().out)
    assert out["findings"] == []
    assert "cannot be trusted" in out["warnings"][0]


@pytest.mark.campaign
def test_a_record_shorter_than_its_period_is_no_ground_for_a_name(recording) -> None:
    rows = slice(0, recording.experiments[0].period_samples // 4)
    cut = tuple(
        replace(
            e,
            time=e.time[rows],
            position=e.position[rows],
            torque=e.torque[rows],
            torque_demand=None if e.torque_demand is None else e.torque_demand[rows],
            status=None,
        )
        for e in recording.experiments
    )
    d = diagnose(replace(recording, experiments=cut))
    assert not d.findings
    if d.verdict is not Verdict.CONSISTENT:
        assert "of one period" in d.sentences[0]
        assert not d.model.fit["trustworthy"]
