"""Complete the OpenAPI document: names that a generated client likes, problems, keys, examples."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI

from invid_service.problems import RETRY_AFTER, ProblemDocument

_RUN = "20261125T142221-0a1b2c3d"
ACCEPTED: dict[int | str, dict[str, Any]] = {
    202: {
        "description": "It goes on by itself; follow Location",
        "headers": {
            "Location": {
                "schema": {"type": "string", "format": "uri-reference"},
                "description": "Address of the identification",
            },
            **RETRY_AFTER,
        },
    }
}
"""Of a call that starts a run."""

EXAMPLES: dict[str, Any] = {
    "Readiness": {
        "can_start": False,
        "reasons": [
            {
                "code": "bus_missing",
                "text": "can0 is not there",
                "fix": "plug the CAN adapter in, then bring the link up",
            }
        ],
        "notes": [],
        "simulated": False,
    },
    "CellNow": {
        "cell": "robot",
        "state": "running",
        "run": _RUN,
        "since": "2026-11-25T14:22:31.120000Z",
        "phase": "experiment 1 of 2",
        "progress": 0.42,
        "eta_s": 61.5,
        "motion_left_s": 20.1,
        "error": None,
        "grade": None,
        "simulated": False,
    },
    "ErrorInfo": {
        "code": "safety-stop",
        "text": "axis A1: position 0.52 rad beyond its window",
        "fix": "look at the robot, clear the cause that is named, then start again",
    },
    "Identification": {
        "id": _RUN,
        "cell": "robot",
        "robot": "robot",
        "mode": "full",
        "amplitude": "planned",
        "separates": None,
        "analyses": None,
        "verifies": None,
        "changed": None,
        "axes": ["A1", "A2"],
        "state": "failed",
        "simulated": False,
        "progress": 0.42,
        "phase": "failed",
        "axis": None,
        "frequency": None,
        "eta_s": None,
        "motion_left_s": None,
        "most_s": None,
        "cause": None,
        "found": [],
        "known": None,
        "recorded": True,
        "tuned": False,
        "error": {
            "code": "bus",
            "text": "can0: the adapter is gone",
            "fix": "check the CAN adapter, its cable and its termination, then start again",
        },
        "stopped": None,
        "created": "2026-11-25T14:22:21Z",
        "started": "2026-11-25T14:22:31Z",
        "ended": "2026-11-25T14:22:44Z",
        "requested_by": "plc",
        "plan": None,
        "measurement": None,
        "decision": None,
        "summary": None,
        "untrusted": None,
        "separating": None,
        "links": {
            "self": f"/api/v1/identifications/{_RUN}",
            "recording": f"/api/v1/identifications/{_RUN}/recording",
        },
    },
    "StopAnswer": {
        "cell": "robot",
        "stopping": True,
        "moved": True,
        "identification": _RUN,
        "simulated": False,
        "note": "this stops motion through the drives' protocol; it is not a safety function",
    },
    "Version": {
        "name": "invid",
        "version": "0.2.0",
        "api": "v1",
        "formats": {"invid-recording": 1, "invid-model": 1, "invid-diagnosis": 1},
    },
    "ProblemDocument": {
        "type": "urn:invid:problem:run-in-progress",
        "title": "Another identification is in progress on this cell",
        "status": 409,
        "detail": "identification 20261125T142221-0a1b2c3d is running",
        "instance": "/api/v1/cells/robot/identifications",
        "identification": _RUN,
        "location": f"/api/v1/identifications/{_RUN}",
        "state": "running",
        "simulated": True,
    },
}
"""By name of the schema; a test holds each against it."""


def complete_schema(app: FastAPI) -> None:
    """Put problems in place of FastAPI's own validation error, and add how keys travel and examples."""
    plain = app.openapi

    def schema() -> dict[str, Any]:
        document = plain()
        schemas = document.setdefault("components", {}).setdefault("schemas", {})
        problem = ProblemDocument.model_json_schema(ref_template="#/components/schemas/{model}")
        schemas.update(problem.pop("$defs", {}))
        schemas["ProblemDocument"] = problem
        for unused in ("HTTPValidationError", "ValidationError"):
            schemas.pop(unused, None)
        for name, example in EXAMPLES.items():
            schemas[name].setdefault("examples", [example])
        document["components"]["securitySchemes"] = {
            "key": {"type": "http", "scheme": "bearer"},
            "keyHeader": {"type": "apiKey", "in": "header", "name": "X-API-Key"},
        }
        # The empty one: bound to loopback the service asks for no key.
        document["security"] = [{"key": []}, {"keyHeader": []}, {}]
        return document

    app.openapi = schema  # type: ignore[method-assign]
