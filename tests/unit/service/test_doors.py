"""One question has one answer, whichever door it comes in by: command, Python, REST and the page."""

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from service_doubles import CELL, Director, model_document, running, until, wait_for

import invid
from invid.cli.app import run
from invid.comparison.answers import judge_screening
from invid.comparison.compare import compare
from invid.config import load_config
from invid.errors import InputError, InvidError
from invid.model.diagnosis_document import diagnosis_from_json
from invid.model.document import model_from_json
from invid_drivers.readiness import ask
from invid_drivers.simulated.unix_bus import UnixHub
from invid_service.jobs.measurement import measure
from invid_service.jobs.protocol import Job

CELLS = "/api/v1/cells"
VIRTUAL = "{interface: invid-virtual, channel: test, cycle_s: 0.001}"


@pytest.fixture(params=["a drive that is dead", "a bus that cannot be opened"])
def broken(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The config of a cell with hardware behind it that cannot be measured."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    hub = UnixHub(str(tmp_path / "wire.sock"))
    bus = f"{{interface: invid-unix, channel: {tmp_path}/wire.sock, cycle_s: 0.001}}"
    if request.param == "a bus that cannot be opened":
        bus = f"{{interface: slcan, channel: {tmp_path}/no-adapter, cycle_s: 0.001}}"
    config = tmp_path / "cell.yaml"
    config.write_text(CELL.split("simulation:")[0].replace(VIRTUAL, bus))
    yield config
    hub.shutdown()


class DeafLine:
    """The line of a runner whose service says nothing; what it tells is kept."""

    def __init__(self) -> None:
        self.told, self.armed, self.stop = list[Any](), threading.Event(), threading.Event()

    def tell(self, message: Any) -> None:
        self.told.append(message)


def test_a_cell_that_cannot_be_measured_is_ready_at_no_door(
    broken: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["check", str(broken)]) == 5
    said = capsys.readouterr().err
    asked = ask(load_config(broken))
    assert not asked.can_start
    assert str(asked.refusal) in said
    line: Any = DeafLine()
    job = Job(
        id="1", kind="measure", mode="full", requested_by="x", folder=tmp_path, simulated=False,
        config=load_config(broken).model_dump(mode="json"), memory_bytes=1, stop_grace_s=1.0,
    )  # fmt: skip
    with pytest.raises(InvidError, match=r"."):
        measure(job, line)
    assert line.told == [], "nothing to arm is shown"
    with running(tmp_path) as (client, director):
        before = client.get(f"{CELLS}/cell/readiness").json()
        assert [n["code"] for n in before["notes"]] == ["drives_not_asked"]
        until(lambda: client.get("/api/v1/state").json()["cells"][0]["status"] == "unknown")
        checked = client.post(f"{CELLS}/cell/check").json()
        assert not checked["can_start"]
        after = client.get(f"{CELLS}/cell/readiness").json()
        assert after["reasons"] == checked["reasons"]
        assert after["reasons"][0]["code"] == "check_refused"
        assert after["reasons"][0]["seen"] is not None
        until(lambda: client.get("/api/v1/state").json()["cells"][0]["status"] == "not_ready")
        refused = client.post(f"{CELLS}/cell/identifications", json={"mode": "full", "arm": True})
        assert refused.status_code == 409
        assert [r["text"] for r in refused.json()["reasons"]] == [r["text"] for r in checked["reasons"]]
        assert director.workers == []


@pytest.fixture
def documents(tmp_path: Path) -> Path:
    """A model, a diagnosis that extends it by friction, and what is neither."""
    model = model_document()
    friction = {
        "cause": "coulomb_friction", "axis": "A1", "element": "mass 1",
        "parameters": {"torque": {"value": 2.0, "std": 0.05, "unit": "N·m"}},
    }  # fmt: skip
    extended = {**model, "effects": [friction]}
    diagnosis = {
        "format": "invid-diagnosis", "format_version": 1, "verdict": "explained", "residual": [],
        "explained_fraction": 1.0, "findings": [], "unexplained": None, "model": extended, "warnings": [],
    }  # fmt: skip
    for name, document in (("model", model), ("diagnosis", diagnosis), ("other", {"format": "invid-tuning"})):
        (tmp_path / f"{name}.json").write_text(json.dumps(document))
    (tmp_path / "rec.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    return tmp_path


@pytest.mark.parametrize("name", ["model", "diagnosis"])
def test_a_model_or_a_diagnosis_is_taken_at_every_door(documents: Path, name: str) -> None:
    path = documents / f"{name}.json"
    model = invid.load_model(path)
    assert len(model.effects) == (name == "diagnosis")
    out = documents / "out.mat"
    assert run(["export", str(path), "--to", "statespace", "-o", str(out)]) == 0
    assert (
        json.loads((documents / "out.mat.json").read_text())["model"]["effects"]
        == json.loads(json.dumps(json.loads(path.read_text()).get("model", {}).get("effects", [])))
        or model.effects
    )
    assert run(["compare", str(documents / "model.json"), str(path)]) == 0
    loaded = invid.load_diagnosis(path) if name == "diagnosis" else model
    assert invid.compare(loaded, model).told
    invid.export(loaded, "statespace", out)


@pytest.mark.parametrize("name", ["other.json", "rec.h5"])
@pytest.mark.parametrize(
    "command",
    [
        ["export", "FILE", "--to", "statespace", "-o", "OUT"],
        ["compare", "FILE", "FILE"],
        ["tune", "FILE", "-o", "OUT"],
    ],
)
def test_what_is_neither_is_refused_by_what_it_is(
    documents: Path, name: str, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = [{"FILE": str(documents / name), "OUT": str(documents / "o")}.get(w, w) for w in command]
    assert run(words) == 2
    said = capsys.readouterr().err
    assert ("invid-tuning" if name == "other.json" else "a recording") in said
    with pytest.raises(InputError, match=r"invid-tuning|a recording"):
        invid.load_model(documents / name)


def friction(cause: str, **sizes: float) -> dict[str, Any]:
    """An effect of a model at the motor of A1."""
    parameters = {name: {"value": v, "std": 0.01 * v, "unit": None} for name, v in sizes.items()}
    return {"cause": cause, "axis": "A1", "element": "mass 1", "other_axis": None, "parameters": parameters}


KNOWN = friction("viscous_friction", coefficient=0.2)
OTHER_LAW = friction("coulomb_friction", torque=0.5)
GAIN = {"held_out": {"before": 1.0, "after": 0.1}, "fraction": 0.9}
PLAY = {**friction("backlash", gap=0.001), "element": "spring 1"}


@pytest.mark.parametrize(
    ("found", "heavier", "verdict", "changed"),
    [
        ([], 1.0, "unchanged", []),
        ([KNOWN], 1.0, "unchanged", []),
        ([OTHER_LAW], 1.0, "unchanged", []),
        ([PLAY], 1.0, "cannot tell", []),
        ([KNOWN], 1.1, "changed", ["A2"]),
    ],
)
def test_a_short_check_has_one_verdict_in_python_and_by_rest(
    tmp_path: Path, found: list[dict[str, Any]], heavier: float, verdict: str, changed: list[str]
) -> None:
    accepted = {**model_document(), "effects": [KNOWN], "fit": {"verdict": "explained"}}
    measured = {**model_document(scale_mass=heavier), "effects": [KNOWN]}
    told = {
        "format": "invid-diagnosis", "format_version": 1, "residual": [], "explained_fraction": 0.99,
        "verdict": "explained" if found else "consistent", "unexplained": None, "warnings": [],
        "model": measured,
        "findings": [{**f, "confidence": 0.9, "gain": GAIN, "alternatives": []} for f in found],
    }  # fmt: skip
    old, diagnosis = model_from_json(accepted), diagnosis_from_json(told)
    python = judge_screening(diagnosis, old, compare(old, diagnosis.model))
    assert (python.verdict, list(python.changed)) == (verdict, changed)
    director = Director()
    director.model = lambda: accepted
    with running(tmp_path, director) as (client, _):

        def run_to(state: str, mode: str) -> str:
            start = client.post(f"{CELLS}/cell/identifications", json={"mode": mode, "arm": True})
            wait_for(client, start.headers["Location"], state)
            return str(start.headers["Location"])

        first = run_to("awaiting_accept", "full")
        assert client.post(f"{first}/actions", json={"type": "accept"}).status_code == 200
        director.model, director.findings = lambda: measured, told["findings"]  # type: ignore[assignment]
        director.diagnosis, director.verdict = lambda: told, told["verdict"]  # type: ignore[assignment]
        summary = client.get(run_to("succeeded", "screen")).json()["summary"]
        assert (summary["screening"]["verdict"], summary["screening"]["changed"]) == (verdict, changed)
        assert summary["findings"] == []
        assert python.diagnosis is not None
        assert summary["headline"] == python.diagnosis.headline
