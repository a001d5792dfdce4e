"""The interface as committed is the interface as served.

To write it anew after an intended change: ``python tests/unit/service/test_openapi.py``.
"""

import json
import tempfile
from pathlib import Path
from typing import Any

from service_doubles import Director, settings_in

from invid_service.app import create_app
from invid_service.problems import STATUSES

COMMITTED = Path(__file__).parents[3] / "docs" / "reference" / "openapi.json"
CONTRACT = {
    ("get", "/api/v1/cells"),
    ("get", "/api/v1/cells/{cell}"),
    ("get", "/api/v1/cells/{cell}/readiness"),
    ("post", "/api/v1/cells/{cell}/check"),
    ("post", "/api/v1/cells/{cell}/identifications"),
    ("get", "/api/v1/identifications"),
    ("get", "/api/v1/identifications/{identification}"),
    ("get", "/api/v1/identifications/{identification}/events"),
    ("get", "/api/v1/identifications/{identification}/recording"),
    ("get", "/api/v1/identifications/{identification}/model"),
    ("get", "/api/v1/identifications/{identification}/diagnosis"),
    ("get", "/api/v1/identifications/{identification}/report"),
    ("post", "/api/v1/identifications/{identification}/actions"),
    ("post", "/api/v1/cells/{cell}/stop"),
    ("get", "/api/v1/cells/{cell}/state"),
    ("post", "/api/v1/stop"),
    ("get", "/api/v1/state"),
    ("post", "/api/v1/recordings"),
    ("get", "/api/v1/cells/{cell}/model"),
    ("get", "/api/v1/cells/{cell}/models"),
    ("post", "/api/v1/cells/{cell}/models/{model}/restore"),
    ("get", "/api/v1/cells/{cell}/changes"),
    ("get", "/api/v1/cells/{cell}/series"),
    ("post", "/api/v1/models/tune"),
    ("get", "/api/v1/health/live"),
    ("get", "/api/v1/health/ready"),
    ("get", "/api/v1/metrics"),
    ("get", "/api/v1/version"),
}


def document(folder: Path) -> dict[str, Any]:
    """The served document; the program's version is not part of the interface."""
    app = create_app(settings_in(folder), launcher=Director().launch)
    app.state.service.lock.release()
    found: dict[str, Any] = json.loads(json.dumps(app.openapi()))
    found["info"]["version"] = "v1"
    return found


def test_the_committed_openapi_document_is_the_served_one(tmp_path: Path) -> None:
    assert document(tmp_path) == json.loads(COMMITTED.read_text(encoding="utf-8"))


def test_every_call_of_the_contract_is_served(tmp_path: Path) -> None:
    served = {(m, path) for path, methods in document(tmp_path)["paths"].items() for m in methods}
    assert served >= CONTRACT


def test_every_call_says_which_problems_it_may_answer_with(tmp_path: Path) -> None:
    for path, methods in document(tmp_path)["paths"].items():
        for method, operation in methods.items():
            problems = {s for s, r in operation["responses"].items() if int(s) >= 400}
            assert {"401", "404", "500"} <= problems, (method, path)
            for status in problems:
                assert list(operation["responses"][status]["content"]) == ["application/problem+json"]


def test_stop_says_that_it_is_no_safety_function(tmp_path: Path) -> None:
    paths = document(tmp_path)["paths"]
    for path in ("/api/v1/cells/{cell}/stop", "/api/v1/stop"):
        said = " ".join(paths[path]["post"]["description"].replace("*", "").split())
        assert "not a safety function" in said


def test_problem_types_are_stable() -> None:
    # Ids that were once given out: they may be added to, never renamed.
    assert {
        "bad-request",
        "key-missing",
        "key-invalid",
        "scope-missing",
        "foreign-origin",
        "not-found",
        "cell-not-found",
        "identification-not-found",
        "model-not-found",
        "artefact-not-found",
        "method-not-allowed",
        "run-in-progress",
        "not-ready",
        "wrong-state",
        "not-simulated",
        "no-comparison",
        "artefact-expired",
        "too-large",
        "unsupported-media-type",
        "invalid-request",
        "invalid-recording",
        "idempotency-key-reused",
        "upload-stalled",
        "internal-error",
        "store-unavailable",
        "disk-full",
    } <= STATUSES.keys()


def test_the_cookbook_names_every_problem_type() -> None:
    text = (COMMITTED.parents[1] / "how-to" / "rest.md").read_text(encoding="utf-8")
    assert [kind for kind in STATUSES if f"`{kind}`" not in text] == []


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        COMMITTED.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(document(Path(folder)), indent=2, ensure_ascii=False)
        COMMITTED.write_text(text + "\n", encoding="utf-8")
