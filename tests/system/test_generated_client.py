"""A client generated from the committed OpenAPI document does a whole run by its own methods."""

import importlib
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from service_process import serving

from invid.recording import read_recording

DOCUMENT = Path(__file__).parents[2] / "docs" / "reference" / "openapi.json"
SETTINGS = {
    "content_type_overrides": {
        "application/x-hdf5": "application/octet-stream",
        "application/x-hdf": "application/octet-stream",
        "application/zip": "application/octet-stream",
        "image/svg+xml": "text/html",
    }
}
"""Of the generator: media types that it does not know, and what to take them for."""

pytestmark = [pytest.mark.campaign, pytest.mark.service]


@pytest.fixture
def generated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Name of the package that the generator wrote."""
    own = Path(sys.prefix, "generator", "bin")  # by `make campaign`
    generator = shutil.which("openapi-python-client", path=f"{own}{os.pathsep}{os.environ['PATH']}")
    if generator is None:
        pytest.skip("openapi-python-client is not installed: make .venv/generator/bin/openapi-python-client")
    settings = tmp_path / "settings.json"
    settings.write_text(json.dumps({**SETTINGS, "post_hooks": []}), encoding="utf-8")
    command = [generator, "generate", "--path", str(DOCUMENT), "--config", str(settings)]
    made = subprocess.run(
        [*command, "--output-path", str(tmp_path / "client")], capture_output=True, text=True, check=False
    )
    said = made.stdout + made.stderr
    assert made.returncode == 0, said
    assert "WARNING" not in said, said  # a call that it cannot express is missing in the client
    monkeypatch.syspath_prepend(tmp_path / "client")
    return next(p.parent.name for p in (tmp_path / "client").glob("*/client.py"))


def test_a_generated_client_runs_fetches_uploads_and_accepts(tmp_path: Path, generated: str) -> None:
    def call(area: str, operation: str) -> Any:
        return importlib.import_module(f"{generated}.api.{area}.{operation}").sync

    models = importlib.import_module(f"{generated}.models")
    types = importlib.import_module(f"{generated}.types")
    with serving(tmp_path) as service:
        client = importlib.import_module(f"{generated}.client").Client(base_url=service.url, timeout=30.0)

        def ended(run: Any, *states: str) -> Any:
            end = time.monotonic() + 90.0
            while str(run.state) not in states:
                assert time.monotonic() < end, run
                assert str(run.state) not in ("failed", "stopped", "cancelled", "interrupted"), run
                time.sleep(0.2)
                run = call("identifications", "get_identification")(run.id, client=client)
            return run

        (cell,) = call("cells", "list_cells")(client=client).cells
        assert call("cells", "get_readiness")(cell.id, client=client).can_start
        body = models.StartBody(mode=models.StartBodyMode.FULL, arm=True)
        start = call("identifications", "start_identification")
        run = start(cell.id, client=client, body=body, idempotency_key="generated-1")
        assert start(cell.id, client=client, body=body, idempotency_key="generated-1").id == run.id
        run = ended(run, "awaiting_accept")
        model = call("identifications", "get_identified_model")(run.id, client=client).to_dict()
        assert model["format"] == "invid-model"
        recorded = call("identifications", "get_recording")(run.id, client=client)
        file = tmp_path / "fetched.h5"
        file.write_bytes(recorded.payload.read())
        assert read_recording(file).axes == ("A1",)

        given = types.File(payload=file.read_bytes())
        worked_out = call("recordings", "upload_recording")(client=client, body=given, cell=cell.id)
        assert ended(worked_out, "succeeded").mode == "upload"

        accept = models.ActionBody(type_=models.ActionBodyType.ACCEPT)
        done = call("identifications", "act_on_identification")(run.id, client=client, body=accept)
        assert str(done.state) == "succeeded"
        problem = call("cells", "get_cell")("elsewhere", client=client)
        assert problem.type_ == "urn:invid:problem:cell-not-found"
        assert not call("cells", "stop_cell")(cell.id, client=client).moved
