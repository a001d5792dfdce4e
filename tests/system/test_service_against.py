"""A recording and a wrong simulator of its machine sent to a real ``invid serve``."""

from __future__ import annotations

from pathlib import Path

import pytest
from machines.mujoco_cells import drawn, measured, urdf, users, write, wrong
from service_process import serving

from invid.simulators.open import open_simulator

pytestmark = pytest.mark.service


@pytest.mark.campaign
def test_a_wrong_simulator_is_judged_and_its_corrected_copy_fetched(tmp_path: Path) -> None:
    cell = drawn(3, kinds=(), motion="multisine", sizes=(1,))
    write(cell, measured(cell), tmp_path / "rec.h5")
    recording = (tmp_path / "rec.h5").read_bytes()
    with serving(tmp_path, cell=None) as service:
        for text, suffix in ((users(wrong(cell, 0.3)), ".xml"), (urdf(wrong(cell, 0.3)), ".urdf")):
            files = {"file": ("r.h5", recording), "simulator": (f"mine{suffix}", text.encode())}
            answer = service.client.post("/api/v1/recordings", files=files)
            done = service.wait(answer.headers["Location"], "succeeded", timeout=120)
            diagnosis = service.client.get(done["links"]["diagnosis"]).json()
            against = diagnosis["against"]
            assert against["right"] is False
            assert against["held_out"]["after"] < 1.3 < 20.0 < against["held_out"]["before"]
            assert [p["name"] for p in against["parameters"]] == ["R1 mass 1"]
            assert str(tmp_path) not in str(diagnosis)
            copy = tmp_path / f"corrected{suffix}"
            copy.write_bytes(service.client.get(done["links"]["corrected"]).content)
            claimed = open_simulator(copy, cell.axes).claimed()
            assert claimed is not None
            assert claimed.chains.masses[0] == pytest.approx(cell.inertia[0], rel=0.01)
        # A simulator of another machine fails the run, and says why.
        files = {"file": ("r.h5", recording), "simulator": ("mine.xml", b"<mujoco><worldbody/></mujoco>")}
        answer = service.client.post("/api/v1/recordings", files=files)
        error = service.wait(answer.headers["Location"], "failed", timeout=120)["error"]
        assert "drives 0 joints" in error["text"]
        assert str(tmp_path) not in error["text"]
