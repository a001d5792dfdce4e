"""``invid measure --separate``: experiments follow from what competes and stay within the limits."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hidden.generator import make

from invid.cli.app import run
from invid.cli.diagnose import diagnosis_text
from invid.config import load_config
from invid.errors import InputError
from invid.model.diagnosis_document import Alternative, Diagnosis, Finding, Verdict
from invid.model.document import ChainStd, EffectTerm, Model
from invid.planning import make_plan
from invid.planning.separating_experiments import to_separate
from invid.recording.concatenation import concatenate_recordings
from invid.recording.model import Role

CONFIG = Path(__file__).resolve().parents[3] / "configs" / "case-study.yaml"


def diagnosis(cause: str, *rivals: str, axis: str = "A2") -> dict:
    return {
        "format": "invid-diagnosis",
        "format_version": 1,
        "findings": [
            {
                "cause": cause,
                "axis": axis,
                "alternatives": [{"cause": r, "axis": axis} for r in rivals],
                "separating_experiment": {"kind": "multisine", "axis": axis, "separates": [cause, *rivals]},
            }
        ],
    }


@pytest.mark.parametrize(
    ("cause", "rival"),
    [
        ("coulomb_friction", "stribeck_friction"),
        ("gravity", "torque_offset"),
        ("cubic_stiffness", "backlash"),
        ("torque_delay", "torque_lag"),
        ("payload_change", "parameter_drift"),
        ("extra_mode", "coupling_stiffness"),
    ],
)
def test_every_family_gives_a_plan_that_the_limits_allow(cause: str, rival: str) -> None:
    config = load_config(CONFIG)
    separation = to_separate(diagnosis(cause, rival), config)
    plan = make_plan(separation.config)  # refuses what leaves the limits
    assert separation.sentences
    assert any(e.role is Role.VALIDATE for e in plan.experiments)
    assert any(e.role is Role.IDENTIFY for e in plan.experiments)
    for e in plan.experiments:
        limits = [a.limits.torque for a in config.axes]
        assert (np.abs(e.torque).max(axis=0) <= limits).all()


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"format": "invid-model"}, "invid-diagnosis"),
        ({"format": "invid-diagnosis", "findings": []}, "nothing to separate"),
        (diagnosis("coulomb_friction", "stribeck_friction", axis="B7"), "B7"),
        (diagnosis("torque_gain", "torque_gain"), "known weight"),
    ],
)
def test_what_cannot_be_separated_is_said(document: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        to_separate(document, load_config(CONFIG))


@pytest.mark.campaign
def test_the_command_plans_it_dry_in_one_document(tmp_path, capsys) -> None:
    path = tmp_path / "d.json"
    path.write_text(json.dumps(diagnosis("coulomb_friction", "stribeck_friction")))
    assert run(["measure", "--separate", str(path), str(CONFIG), "--dry-run", "--json"]) == 0
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    kinds = {e["kind"] for e in document["experiments"]}
    assert kinds == {"multisine", "constant_velocity"}
    assert "amplitudes" in printed.err


def test_two_recordings_of_one_robot_are_diagnosed_as_one() -> None:
    recording, _ = make("coulomb_friction", seed=11, motors=1, target_db=20)
    half = len(recording.experiments) // 2 or 1
    first = replace(recording, experiments=recording.experiments[:half])
    second = replace(recording, experiments=recording.experiments[half:])
    both = concatenate_recordings([first, second])
    assert [e.key for e in both.experiments] == [f"{k:03d}" for k in range(len(recording.experiments))]
    starts = [float(e.time[0]) for e in both.experiments]
    ends = [float(e.time[-1]) for e in both.experiments]
    assert all(a > b for a, b in zip(starts[half:], ends[:half], strict=False))
    with pytest.raises(InputError, match="not the same robot"):
        concatenate_recordings([recording, replace(recording, axes=("other",))])


@pytest.mark.parametrize(
    ("planned", "rival", "offered"),
    [
        ({"text": "repeat it with another payload"}, "viscous_friction", True),  # of a rigid robot
        ({"description": "move it", "separates": ["gravity", "torque_offset"]}, "torque_offset", True),
        ({"description": "hang a weight on it", "separates": ["torque_gain"]}, "torque_gain", False),
    ],
)
def test_the_terminal_offers_only_experiments_that_run(planned: dict, rival: str, offered: bool) -> None:
    """A finding of a rigid robot lists no causes beside its experiment: reading them ended the command."""
    chains = make(seed=3, motors=1)[1].chains
    model = Model(robot="cell", method="by hand", chains=chains, std=ChainStd.unknown(chains))
    said = diagnosis_text(
        Diagnosis(
            verdict=Verdict.PARTLY_EXPLAINED,
            residual=(),
            explained_fraction=None,
            findings=(
                Finding(
                    effect=EffectTerm("gravity", "A1", {}),
                    confidence=0.5,
                    before=1.0,
                    after=0.1,
                    fraction=0.9,
                    alternatives=(Alternative(rival, "A1", None, 0.1),),
                    separating_experiment=planned,
                ),
            ),
            unexplained=None,
            model=model,
        )
    )
    assert (planned.get("description") or planned["text"]) in said
    assert ("--separate" in said) == offered
