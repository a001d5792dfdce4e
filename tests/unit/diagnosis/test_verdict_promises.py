"""What the words of a diagnosis promise holds in every document, of elastic and of rigid machines."""

import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import two_masses
from hidden.generator import make
from large_motion import recording as recording_of
from large_motion import simulate as large_motion
from test_consequence_grades import diagnosis as document_of
from test_consequence_grades import recording as plain_recording
from test_consequence_grades import term

from invid.cli.app import run
from invid.diagnosis.diagnose import diagnose
from invid.diagnosis.outcome import Cause, Outcome, assemble_diagnosis, finding_of
from invid.model.diagnosis_document import (
    Alternative,
    Verdict,
    diagnosis_to_json,
)
from invid.model.document import Estimate
from invid.numerics.arrays import frozen_float
from invid.recording.hdf5 import write_recording
from invid.recording.model import Experiment, Recording, Role


def broken(document: dict, recording: Recording) -> list[str]:
    """The promises that a document breaks; CONTRACT.md, read again here."""
    out = []
    residual, share = document["residual"], document["explained_fraction"]
    rated = np.inf if recording.rated_torque is None else recording.rated_torque
    left = [max(r["after"] ** 2 - r["noise_floor"] ** 2, 0.0) ** 0.5 for r in residual]
    is_small = bool(np.isfinite(rated).all()) and all(np.array(left) < 0.002 * rated)
    if document["verdict"] == "explained" and not is_small:
        if share is not None and share < 0.9:
            out.append(f"explained with {share}")
        out += [
            f"explained with {r['axis']} at {r['after'] / r['noise_floor']:.3g} floors"
            for r in residual
            if r["after"] > 1.2 * r["noise_floor"] * (1 + 1e-9)
        ]
    for finding in document["findings"]:
        said = [w for w in document["warnings"] if finding["cause"].replace("_", " ") in w]
        unknown = [n for n, p in finding["parameters"].items() if p["std"] is None]
        if unknown and not said:
            out.append(f"{finding['cause']}: {unknown} are not known and no warning says what would tell")
        place = ("cause", "axis", "element", "other_axis")
        if [a for a in finding["alternatives"] if all(a.get(k) == finding.get(k) for k in place)]:
            out.append(f"{finding['cause']} is its own alternative")
        if finding["alternatives"] and finding["confidence"] > 0.89:
            out.append(f"{finding['cause']} at {finding['confidence']} with alternatives")
    if document["verdict"] in ("consistent", "unexplained") and document["findings"]:
        out.append(f"{document['verdict']} with findings")
    if document["verdict"] in ("partly_explained", "unexplained") and document["unexplained"] is None:
        out.append(f"{document['verdict']} and nothing said of what is left")
    held = recording.with_role(Role.VALIDATE) or recording.experiments
    torque = sum(float(np.nansum(np.square(e.torque))) for e in held) / sum(e.samples for e in held)
    missed = sum(max(r["after"] ** 2 - r["noise_floor"] ** 2, 0.0) for r in residual)
    if torque > 0 and np.sqrt(missed / torque) > 0.5:
        if document["model"]["fit"].get("trustworthy", True):
            out.append("more than half of the torque missed, and trusted")
        if not document["warnings"] or "misses" not in document["warnings"][0]:
            out.append("more than half of the torque missed, and not said first")
    return out


@pytest.mark.parametrize(
    ("share", "floors", "contested", "named", "missing", "complete"),
    list(product((None, 0.5, 0.89, 0.9, 1.0), (1.0, 1.2, 1.25, 3.8), *[(False, True)] * 4)),
)
def test_no_document_says_more_than_its_numbers_carry(
    share: float | None, floors: float, contested: bool, named: bool, missing: bool, complete: bool
) -> None:
    rivals = (Alternative("viscous_friction", "A1", "mass 1", 0.1),) if contested else ()
    start = document_of(term("coulomb_friction", torque=0.4), after=floors * 0.05, rivals=rivals)
    recording = plain_recording(rated=False)
    result = assemble_diagnosis(
        recording,
        start.residual,
        start.findings if named else (),
        start.model,
        Outcome(missing=missing, complete=complete, explained=share),
    )
    if named:
        kept = complete and (share is None or share >= 0.9) and floors <= 1.2
        assert result.verdict is (Verdict.EXPLAINED if kept else Verdict.PARTLY_EXPLAINED)
    else:
        assert result.verdict is (Verdict.UNEXPLAINED if missing else Verdict.CONSISTENT)
    assert broken(diagnosis_to_json(result), recording) == []
    assert all(f.confidence <= 0.89 for f in result.findings if f.alternatives)


@pytest.mark.parametrize("own", [False, True])
def test_nobody_is_certain_where_something_is_left_or_competes(own: bool) -> None:
    effect, rival = term("coulomb_friction", torque=0.4), Alternative("viscous_friction", "A1", "mass 1", 0.1)
    alone = Cause(effect, 1.0, 0.05, 1.0, 0.999)
    for cause, at_noise, most in (
        (alone, True, 0.999),
        (alone, False, 0.89),
        (replace(alone, alternatives=(rival,)), True, 0.89),
        (replace(alone, doubts=("It may be another.",)), True, 0.89),
        (replace(alone, size_is_significant=False), True, 0.5),
    ):
        found = finding_of(cause, 1.0, (1,), ("A1",), at_noise=at_noise, own=own)
        assert found.confidence == pytest.approx(most)
        assert (found.separating_experiment is None) == (not cause.alternatives)
    # Little is explained: a cause that stands on all of the evidence is less sure, one on its own is not.
    little = finding_of(alone, 0.9, (1,), ("A1",), at_noise=True, own=own).confidence
    assert little == pytest.approx(0.999 if own else 0.55, abs=1e-3)


@pytest.mark.parametrize(("after", "small"), [(0.15, True), (0.19, True), (0.21, False), (0.3, False)])
def test_what_is_left_below_two_thousandths_of_rated_torque_is_explained_and_said(
    after: float, small: bool
) -> None:
    start, recording = document_of(term("coulomb_friction", torque=0.4), after=after), plain_recording()
    result = assemble_diagnosis(
        recording,
        start.residual,
        start.findings,
        start.model,
        Outcome(missing=True, complete=False, explained=0.7),
    )
    assert result.verdict is (Verdict.EXPLAINED if small else Verdict.PARTLY_EXPLAINED)
    assert (result.unexplained is None) == small
    assert any("What is left is small: at most 0.1" in s for s in result.sentences) == small


def test_a_size_that_the_data_do_not_tell_comes_with_what_would() -> None:
    start = document_of(term("stribeck_friction", static=0.4, coulomb=0.2, velocity=1.0))
    (finding,) = start.findings
    open_speed = {**finding.effect.parameters, "velocity": Estimate(1.0, None, "rad/s")}
    found = replace(finding, effect=replace(finding.effect, parameters=open_speed))
    result = assemble_diagnosis(
        plain_recording(),
        start.residual,
        [found],
        start.model,
        Outcome(missing=True, complete=True, explained=1.0),
    )
    assert broken(diagnosis_to_json(result), plain_recording()) == []
    assert any("do not tell its velocity; slow constant-velocity moves" in w for w in result.warnings)
    assert result.model.warnings == result.warnings


def test_a_document_that_broke_them_would_be_found() -> None:
    start = document_of(term("coulomb_friction", torque=0.4))
    good = diagnosis_to_json(
        assemble_diagnosis(
            plain_recording(rated=False),
            start.residual,
            start.findings,
            start.model,
            Outcome(missing=True, complete=True, explained=1.0),
        )
    )
    assert broken(good, plain_recording(rated=False)) == []
    for change in (
        {"explained_fraction": 0.65},
        {"residual": [{"axis": "A1", "before": 1.0, "after": 0.19, "noise_floor": 0.05}]},
        {
            "residual": [{"axis": "A1", "before": 9.0, "after": 6.0, "noise_floor": 0.05}],
            "verdict": "consistent",
        },
    ):
        assert broken({**good, **change}, plain_recording(rated=False)), change


ELASTIC = (
    ("coulomb_friction", 11), ("cubic_stiffness", 12), ("backlash", 13), ("gravity", 14), ("power_drag", 15),
    ("end_stop", 16), (None, 17),
)  # fmt: skip


@pytest.mark.campaign
@pytest.mark.parametrize(("cause", "seed"), ELASTIC)
def test_diagnoses_of_elastic_machines_keep_them(cause: str | None, seed: int) -> None:
    recording, _ = make(cause, seed=seed, motors=1, target_db=None if cause is None else 25)
    assert broken(diagnosis_to_json(diagnose(recording)), recording) == []


RIGID = {
    "nothing": {},
    "friction": {"dry": (1.0, 1.0), "wet": (0.6, 0.6)},
    "by direction": {"dry": (1.5, 0.8), "wet": (0.3, 0.9)},
    "weight": {"extra": lambda q, v, t: 2.0 * np.sin(q + 0.4)},
    "no name": {"extra": lambda q, v, t: 1.5 * np.sin(9.0 * t)},
    "beside no name": {"dry": (1.0, 1.0), "extra": lambda q, v, t: 0.8 * np.tanh(3.0 * q) * v},
    "hardly any noise": {"dry": (1.0, 1.0), "noise": 1e-5},
}


@pytest.mark.campaign
@pytest.mark.parametrize("case", RIGID)
def test_diagnoses_of_rigid_machines_keep_them(case: str) -> None:
    recording = recording_of(large_motion(np.random.default_rng(5), seconds=12.0, **RIGID[case]))
    assert broken(diagnosis_to_json(diagnose(recording)), recording) == []


@pytest.mark.panel
@pytest.mark.campaign
def test_where_more_than_half_of_the_torque_is_missed_the_command_ends_with_three(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A torque channel that is not the motor's: drawn by chance beside the motion."""
    rng = np.random.default_rng(3)
    moved = large_motion(rng, seconds=12.0)
    wander = np.cumsum(rng.normal(size=moved.torque.shape), axis=0)
    torque = frozen_float(moved.torque + moved.torque.std() / wander.std() * 3.0 * wander)
    recording = recording_of(replace(moved, torque=torque))
    write_recording(recording, tmp_path / "rec.h5")
    status = run(["diagnose", str(tmp_path / "rec.h5"), "--json"])
    document = json.loads(capsys.readouterr().out)
    assert broken(document, recording) == []
    assert sum(r["after"] ** 2 for r in document["residual"]) > 0.25 * float(np.mean(torque**2))
    assert status == 3
    assert "misses" in document["warnings"][0]


@pytest.mark.campaign
def test_the_same_holds_for_chains_and_for_the_identification(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The torque of each record runs backwards."""
    recording, _ = make(None, seed=17, motors=1, target_db=None)
    backwards = tuple(replace(e, torque=e.torque[::-1].copy()) for e in recording.experiments)
    recording = replace(recording, experiments=backwards)
    write_recording(recording, tmp_path / "rec.h5")
    assert run(["identify", str(tmp_path / "rec.h5"), "--masses", "1", "--json"]) == 3
    capsys.readouterr()
    assert run(["diagnose", str(tmp_path / "rec.h5"), "--masses", "1", "--json"]) == 3
    document = json.loads(capsys.readouterr().out)
    assert broken(document, recording) == []
    assert "misses" in document["warnings"][0]


def test_nothing_is_called_consistent_on_a_linear_fit_that_cannot_be_trusted() -> None:
    """It said "the linear model itself cannot be trusted" and "nothing is missing" in one document."""

    def cut(e: Experiment) -> Experiment:
        columns = ("time", "position", "torque", "torque_demand")
        return replace(e, **{name: getattr(e, name)[: 2 * two_masses.PERIOD // 3] for name in columns})

    parts = (
        cut(two_masses.from_rest(1, Role.IDENTIFY, "000")),
        cut(two_masses.from_rest(2, Role.VALIDATE, "001")),
    )
    found = diagnose(two_masses.recording(*parts))
    assert not found.model.fit["trustworthy"]
    assert found.verdict is Verdict.UNEXPLAINED
    assert not any("nothing is missing" in said for said in found.sentences)
    assert found.unexplained is not None
    assert found.unexplained.frequencies_hz == ()
