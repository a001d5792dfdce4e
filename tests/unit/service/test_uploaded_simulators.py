"""A simulator uploaded beside a recording: data alone, and what would read or run anything is refused."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import pytest
from service_doubles import Director, ScriptedWorker, kind, model_document, running, wait_for
from test_who_may_call import hdf5

from invid_service.jobs.protocol import Job
from invid_service.problems import Problem
from invid_service.recordings.simulator import LARGEST, checked_simulator

MESH = '<visual><geometry><mesh filename="/etc/passwd"/></geometry></visual>'
URDF = f'<robot name="r"><link name="b">{MESH}</link></robot>'
MJCF = "<mujoco><worldbody/><actuator/></mujoco>"


def zipped() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        file.writestr("modelDescription.xml", "<fmiModelDescription/>")
    return out.getvalue()


def in_mujoco(inner: str) -> bytes:
    return f"<mujoco>{inner}<worldbody/></mujoco>".encode()


REFUSED = [
    (in_mujoco('<include file="{secret}"/>'), "<include> is not taken"),
    (in_mujoco("<default><include file='{secret}'/></default>"), "<include> is not taken"),
    (in_mujoco('<asset><mesh file="{secret}"/></asset>'), "no other file is read"),
    (in_mujoco('<compiler meshdir="/etc"/><asset><mesh name="m" file="passwd"/></asset>'), "no other file"),
    (in_mujoco('<asset><hfield name="h" file="{secret}"/></asset>'), "no other file is read"),
    (in_mujoco('<asset><texture type="cube" fileright="{secret}"/></asset>'), "no other file is read"),
    (in_mujoco('<asset><model name="m" file="{secret}"/></asset>'), "no other file is read"),
    (in_mujoco('<extension><plugin plugin="a.b"/></extension>'), "no plugin"),
    (b'<!DOCTYPE m [<!ENTITY x SYSTEM "file:///etc/passwd">]><mujoco model="&x;"/>', "DOCTYPE"),
    (in_mujoco("<body>" * 5000 + "</body>" * 5000), "deep in one another"),
    (b"<mujoco", "no XML"),
    (b"<html/>", "its root is <html>"),
    (b"\x7fELF", "no XML"),
    (b'{"format": "something"}', "format"),
    (b'{"format": ', "cannot be read"),
    (b"[" * 100_000, "no XML"),
    (zipped(), "native code, which the service does not run"),
]


@pytest.mark.parametrize(("content", "said"), REFUSED, ids=range(len(REFUSED)))
def test_what_reads_other_files_or_runs_code_is_refused_with_the_reason(content: bytes, said: str) -> None:
    with pytest.raises(Problem, match=said) as raised:
        checked_simulator(content.replace(b"{secret}", b"/etc/passwd"))
    assert (raised.value.kind, raised.value.status) == ("invalid-simulator", 422)


def posted(client: Any, folder: Path, simulator: bytes, name: str = "robot.xml") -> Any:
    recording = hdf5(folder / "good.h5").read_bytes()
    return client.post(
        "/api/v1/recordings", files={"file": ("r.h5", recording), "simulator": (name, simulator)}
    )


def test_a_refused_simulator_starts_nothing_and_leaves_nothing(tmp_path: Path) -> None:
    with running(tmp_path) as (client, director):
        assert kind(posted(client, tmp_path, zipped(), "robot.fmu")) == "invalid-simulator"
        large = posted(client, tmp_path, b" " * (LARGEST + 1))
        assert (kind(large), large.json()["limit"]) == ("too-large", LARGEST)
        answer = client.post(
            "/api/v1/recordings",
            files={"file": hdf5(tmp_path / "good.h5").read_bytes()},
            data={"simulator": MJCF},
        )
        assert kind(answer) == "invalid-request"
        assert director.workers == []
        assert list((tmp_path / "data" / "work").iterdir()) == []
        assert client.get("/api/v1/identifications").json()["identifications"] == []


@pytest.mark.parametrize(
    ("content", "suffix"),
    [(MJCF, ".xml"), (URDF, ".urdf"), (json.dumps(model_document()), ".json")],
    ids=["mjcf", "urdf", "model"],
)
def test_a_simulator_goes_to_the_analysis_and_its_copy_comes_back_under_a_name_of_its_format(
    content: str, suffix: str, tmp_path: Path
) -> None:
    class Correcting(Director):
        async def launch(self, job: Job) -> ScriptedWorker:
            worker = await super().launch(job)
            assert job.simulator is not None
            (job.folder / "corrected").write_bytes((job.folder / job.simulator).read_bytes())
            return worker

    with running(tmp_path, Correcting()) as (client, director):
        answer = posted(client, tmp_path, content.encode(), "../../evil.xml")
        assert answer.status_code == 202
        done = wait_for(client, answer.headers["Location"], "succeeded", "failed")
        assert director.workers[0].job.simulator == f"simulator{suffix}"
        copy = client.get(done["links"]["corrected"])
        assert copy.status_code == 200
        assert copy.headers["content-disposition"].endswith(f'{done["id"]}-corrected{suffix}"')
        assert b"passwd" in copy.content or suffix != ".urdf"  # kept as text, read by nobody
        assert not list(tmp_path.rglob("*evil*"))
