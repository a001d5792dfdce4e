"""The model of a run in the formats of other tools, through REST."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest
import scipy.io
from service_doubles import Director, running, wait_for

API = "/api/v1"


def finished(client: object) -> str:
    answer = client.post(f"{API}/cells/cell/identifications", json={"mode": "full", "arm": True})  # type: ignore[attr-defined]
    location: str = answer.headers["Location"]
    wait_for(client, location, "awaiting_accept")  # type: ignore[arg-type]
    return location


def test_a_runs_model_comes_as_a_mat_file_with_what_it_lacks_beside_it(tmp_path: Path) -> None:
    with running(tmp_path, Director()) as (client, _):
        location = finished(client)
        answer = client.get(f"{location}/export", params={"to": "statespace"})
        assert answer.status_code == 200, answer.text
        mat = scipy.io.loadmat(io.BytesIO(answer.content), simplify_cells=True)
        assert mat["A"].shape == (18, 18)
        assert list(mat["inputs"]) == ["A1.torque", "A2.torque", "A3.torque"]
        assert answer.headers["content-disposition"].endswith('.mat"')
        beside = client.get(answer.headers["link"].split(">")[0].removeprefix("<")).json()
        assert beside["simulated"] is True
        assert beside["losses"] == []
        assert len(beside["parameters"]["covariance"]) == len(beside["parameters"]["names"]) == 24


@pytest.mark.parametrize("to", ["mjcf", "urdf", "fmu"])
def test_the_other_formats_come_as_what_they_are(to: str, tmp_path: Path) -> None:
    pytest.importorskip({"mjcf": "mujoco", "fmu": "pythonfmu3"}.get(to, "invid"))
    with running(tmp_path, Director()) as (client, _):
        answer = client.get(f"{finished(client)}/export", params={"to": to})
        assert answer.status_code == 200, answer.text
        assert answer.content.startswith({"mjcf": b"<mujoco", "urdf": b"<?xml", "fmu": b"PK"}[to])


def test_what_cannot_be_exported_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running(tmp_path, Director()) as (client, _):
        location = finished(client)
        assert client.get(f"{location}/export", params={"to": "simulink"}).status_code == 422
        assert client.get(f"{location}/export").status_code == 422
        unknown = client.get(f"{API}/identifications/nothing/export", params={"to": "mjcf"})
        assert unknown.json()["type"] == "urn:invid:problem:identification-not-found"
        (tmp_path / "bin").mkdir()
        (tmp_path / "bin" / "python").write_text(
            "#!/bin/sh\necho 'invid: --to mjcf needs mujoco' >&2\nexit 2\n"
        )
        (tmp_path / "bin" / "python").chmod(0o755)
        monkeypatch.setattr(sys, "executable", str(tmp_path / "bin" / "python"))
        lacking = client.get(f"{location}/export", params={"to": "mjcf"})
        assert lacking.status_code == 501
        assert lacking.json()["detail"] == "--to mjcf needs mujoco"


def test_a_run_without_a_model_has_nothing_to_export(tmp_path: Path) -> None:
    director = Director()
    director.failure = {"code": "weak", "text": "too weak", "fix": "shake harder"}
    with running(tmp_path, director) as (client, _):
        answer = client.post(f"{API}/cells/cell/identifications", json={"mode": "full", "arm": True})
        wait_for(client, answer.headers["Location"], "failed")
        got = client.get(f"{answer.headers['Location']}/export", params={"to": "statespace"})
        assert got.json()["type"] == "urn:invid:problem:artefact-not-found"
