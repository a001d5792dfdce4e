"""A cell with hardware behind it: readiness of its bus, no simulation to change, simulated on request."""

import json
import re
from datetime import UTC, datetime
from pathlib import Path

import pytest
from service_doubles import CELL, START, model_document, running, wait_for

from invid.config import CellConfig
from invid_drivers.simulated import truth
from invid_service.store.store import RunRecord, State, StoredModel

HARDWARE = CELL.split("simulation:")[0].replace(
    "{interface: invid-virtual, channel: test, cycle_s: 0.001}",
    "{interface: socketcan, channel: can-none, cycle_s: 0.001}",
)


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    (tmp_path / "cell.yaml").write_text(HARDWARE)
    return tmp_path


def test_a_missing_can_interface_is_a_reason_with_a_fix(cell: Path) -> None:
    with running(cell) as (client, director):
        ready = client.get("/api/v1/cells/cell/readiness").json()
        assert ready["simulated"] is False
        assert [r["code"] for r in ready["reasons"]] == ["bus_missing"]
        assert "ip link set can-none up" in ready["reasons"][0]["fix"]
        refused = client.post(START, json={"mode": "full", "arm": True})
        assert refused.status_code == 409
        assert refused.json()["reasons"] == ready["reasons"]
        assert director.workers == []


def test_mode_simulate_moves_no_hardware_and_uses_the_accepted_model(cell: Path) -> None:
    with running(cell) as (client, director):
        refused = client.post(START, json={"mode": "simulate", "arm": True})
        assert [r["code"] for r in refused.json()["reasons"]] == ["no_model"]
        store = client.app.state.service.store  # type: ignore[attr-defined]
        now = datetime.now(UTC)
        run = RunRecord("m1", "cell", "test robot", "full", ("A1",), False, State.SUCCEEDED, now, "local")
        store.add_run(run)
        document = model_document(scale_mass=1.5)
        at = {"cause": "viscous_friction", "axis": "A1", "element": "mass 1", "other_axis": None}
        law = {
            "at": [-1.0, 0.0, 1.0],
            "value": [-2.0, 0.0, 2.0],
            "unit": "N·m",
            "covariance": [[0.0] * 3] * 3,
        }
        number = {"value": 0.1, "std": 0.01, "unit": "N·m·s/rad"}
        document["effects"] = [
            {**at, "parameters": {"coefficient": number}},
            {**at, "cause": "empirical_law", "parameters": {"over": {"value": "velocity"}, "table": law}},
        ]
        store.add_model(StoredModel("m1", "cell", now, "full", json.dumps(document)))
        store.approve("cell", "m1", by="local", how="accept", now=now)
        started = client.post(START, json={"mode": "simulate", "arm": True})
        assert started.status_code == 202
        done = wait_for(client, started.headers["Location"], "succeeded")
        assert done["simulated"] is True
        config = CellConfig.model_validate(director.workers[0].job.config)
        assert config.bus.interface == "invid-virtual"
        assert truth(config).masses[1].tolist() == [4.0, 5.0, 9.0]
        # No simulated drive has a law without a name.
        said = director.workers[0].job.config["simulation"]["effects"]
        assert said == [{**at, "parameters": {"coefficient": 0.1}}]
        assert client.get("/api/v1/cells/cell/model").json()["id"] == "m1"
        page = client.get("/").text
        assert re.search(r'<span id="simulated"[^>]* hidden>SIMULATED', page)
        words = re.compile(r'<script type="application/json" id="texts">.*?</script>', re.S)
        assert words.sub("", page).count("SIMULATED") == 1
