"""Identifications through the REST interface, with a scripted runner."""

import json
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from service_doubles import (
    CELL,
    START,
    Director,
    accepted,
    act,
    model_document,
    running,
    settings_in,
    start,
    started,
    until,
    wait_for,
)
from sqlalchemy.exc import OperationalError

from invid.config import load_config
from invid.errors import ConfigError
from invid_drivers.cia402.bus import STOPPED_S
from invid_drivers.protocol import LastSeen, Stop
from invid_drivers.readiness import ask
from invid_drivers.relay import STOP_S
from invid_service.app import create_app
from invid_service.settings import Settings
from invid_service.store.database import open_engine

STOP = "/api/v1/cells/cell/stop"


def problem(answer: Any, status: int, kind: str) -> dict[str, Any]:
    """The problem document of an answer, its invariants checked."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    document: dict[str, Any] = answer.json()
    assert document["type"] == f"urn:invid:problem:{kind}"
    assert document["status"] == status
    assert document["title"]
    assert document["detail"]
    return document


def test_a_run_goes_through_every_state_of_the_contract_in_order(tmp_path: Path) -> None:
    with running(tmp_path) as (client, _):
        location = start(client, arm=False)
        assert wait_for(client, location, "awaiting_arm")["plan"]["duration_s"] == 10.0
        assert act(client, location, "arm").status_code == 200
        waiting = wait_for(client, location, "awaiting_accept")
        assert waiting["progress"] == 1.0
        assert act(client, location, "accept").json()["state"] == "succeeded"
        events = client.get(f"{location}/events").text
    states = [
        json.loads(line[6:])["state"]
        for block in events.split("\n\n")
        if "event: state" in block
        for line in block.splitlines()
        if line.startswith("data: ")
    ]
    assert states == ["checking", "awaiting_arm", "running", "analysing", "awaiting_accept", "succeeded"]


def test_nothing_moves_before_it_is_armed(tmp_path: Path) -> None:
    with running(tmp_path) as (client, director):
        location = started(client, "awaiting_arm", arm=False)
        time.sleep(0.2)
        assert client.get(location).json()["state"] == "awaiting_arm"
        assert director.workers[0].said == []


def test_a_button_pressed_twice_arms_once_and_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(tmp_path, Director(held_in="analysing")) as (client, _):
        location = started(client, "awaiting_arm", arm=False)
        store = client.app.state.service.store  # type: ignore[attr-defined]
        save = store.save_state

        def slow(*given: Any) -> None:
            time.sleep(0.3)
            save(*given)

        monkeypatch.setattr(store, "save_state", slow)
        with ThreadPoolExecutor(3) as hands:
            answers = list(hands.map(lambda _: act(client, location, "arm"), range(3)))
        assert [(a.status_code, a.json()["state"]) for a in answers] == [(200, "running")] * 3
        client.post(STOP)


def test_a_test_run_asks_for_at_most_a_tenth_of_the_torque(tmp_path: Path) -> None:
    with running(tmp_path) as (client, director):
        started(client, mode="test")
        started(client, mode="full")
    assert director.workers[0].job.amplitude_scale <= 0.1
    assert director.workers[1].job.amplitude_scale == 1.0


@pytest.mark.campaign
def test_every_body_of_a_simulated_cell_says_so(tmp_path: Path) -> None:
    with running(tmp_path) as (client, _):
        location = accepted(client)
        for path in (
            "/api/v1/cells",
            "/api/v1/cells/cell",
            "/api/v1/cells/cell/readiness",
            "/api/v1/cells/cell/model",
            "/api/v1/cells/cell/models",
            "/api/v1/identifications",
            location,
            f"{location}/model",
            f"{location}/diagnosis",
        ):
            assert client.get(path).json()["simulated"] is True, path
        assert client.post(STOP).json()["simulated"] is True
        for answer in (
            client.post(START, json={"mode": "wild"}),
            client.post(START, content=b"{"),
            client.get("/api/v1/cells/cell/series"),
            client.get("/api/v1/cells/cell/changes", params={"nonsense": 1}),
            act(client, location, "dance"),
        ):
            assert answer.status_code in (404, 422), answer.text
            assert answer.json().get("simulated") is True, answer.text
        for path in ("/api/v1/cells/other", "/api/v1/identifications/other"):
            assert "simulated" not in client.get(path).json()
        # The router answers before anybody is asked for a key, and tells nothing of a cell.
        for answer in (client.get("/api/v1/cells/cell/nowhere"), client.put("/api/v1/cells/cell/model")):
            assert answer.status_code in (404, 405)
            assert "simulated" not in answer.json()


def test_a_second_start_is_refused_and_names_the_run_in_progress(tmp_path: Path) -> None:
    with running(tmp_path, Director(held_in="running")) as (client, _):
        location = start(client)
        document = problem(client.post(START, json={"mode": "full"}), 409, "run-in-progress")
        assert document["identification"] == location.rsplit("/", 1)[1]
        assert document["reasons"][0]["code"] == "run_in_progress"


SLOW = "safety: {heartbeat_s: 2.0}\n"
INERTIA = {"    rated_torque_Nm: 50\n": "    rated_torque_Nm: 50\n    inertia_kgm2: 0.5\n"}


@pytest.mark.parametrize(("safety", "ready"), [("", True), (SLOW, False)])
def test_what_the_check_would_refuse_is_not_ready_on_the_page_nor_for_a_start_and_what_is_ready_passes(
    tmp_path: Path, safety: str, ready: bool
) -> None:
    text = CELL + safety
    for old, new in INERTIA.items():
        text = text.replace(old, new)
    (tmp_path / "cell.yaml").write_text(text)
    config = load_config(tmp_path / "cell.yaml")
    try:
        ask(config).require()
        refusal = ""
    except ConfigError as error:
        refusal = str(error)
    assert (refusal == "") is ready
    with running(tmp_path) as (client, director):
        found = client.get("/api/v1/cells/cell/readiness").json()
        assert found["can_start"] is ready
        until(
            lambda: (
                client.get("/api/v1/state").json()["cells"][0]["status"]
                == ("ready" if ready else "not_ready")
            )
        )
        if ready:
            assert client.post(START, json={"mode": "full"}).status_code == 202
            return
        (reason,) = found["reasons"]
        assert reason["code"] == "check_refused"
        assert f"{reason['text']}; {reason['fix']}" == refusal
        assert "shorten safety.heartbeat_s to 0." in reason["fix"]
        refused = problem(client.post(START, json={"mode": "full"}), 409, "not-ready")
        assert refused["reasons"] == found["reasons"]
        assert not director.workers


def test_the_same_idempotency_key_gives_the_same_run_and_another_body_is_refused(tmp_path: Path) -> None:
    with running(tmp_path) as (client, director):
        headers = {"Idempotency-Key": "plc-7"}
        body = {"mode": "full", "arm": True}
        first = client.post(START, json=body, headers=headers)
        again = client.post(START, json=body, headers=headers)
        assert again.status_code == 202
        assert again.headers["Location"] == first.headers["Location"]
        wait_for(client, first.headers["Location"], "awaiting_accept")
        late = client.post(START, json=body, headers=headers)
        assert late.headers["Location"] == first.headers["Location"]
        other = client.post(START, json={"mode": "test", "arm": True}, headers=headers)
        problem(other, 422, "idempotency-key-reused")
        assert len(director.workers) == 1


@pytest.mark.parametrize("state", ["awaiting_arm", "running", "analysing"])
def test_a_stop_ends_the_run_as_stopped_whatever_it_does(tmp_path: Path, state: str) -> None:
    director = Director()
    (director.analyse if state == "analysing" else director.go).clear()
    with running(tmp_path, director) as (client, _):
        location = start(client, arm=state != "awaiting_arm")
        wait_for(client, location, state)
        answer = client.post(STOP)
        assert answer.status_code == 200
        assert answer.json()["identification"] == location.rsplit("/", 1)[1]
        ended = wait_for(client, location, "stopped")
        assert ended["error"]["code"] == "stopped"
        if state != "awaiting_arm":
            assert client.get(f"{location}/recording").status_code == 200
        assert client.get("/api/v1/cells/cell/readiness").json()["can_start"] is True


def test_a_runner_that_does_not_hear_the_stop_is_killed(tmp_path: Path) -> None:
    with running(tmp_path, Director(held_in="running", deaf=True), stop_grace_s=0.2) as (client, director):
        location = started(client, "running")
        client.post(STOP)
        failed = wait_for(client, location, "failed")  # nobody saw its axes at rest
        assert director.workers[0].killed.is_set()
        assert failed["error"]["code"] == "not-stopped"
        assert "make sure that every axis stands" in failed["error"]["fix"]


@pytest.mark.parametrize("killed", [False, True])
def test_after_a_stop_whose_runner_is_lost_every_axis_is_unknown_and_nobody_says_stopped(
    tmp_path: Path, killed: bool
) -> None:
    director = Director(held_in="running")
    director.die, director.deaf = True, killed
    director.axes = (LastSeen("A1", "operation enabled", 0.0),)
    with running(tmp_path, director, stop_grace_s=0.2 if killed else 5.0) as (client, _):
        location = started(client, "running")
        assert client.post(STOP).json()["unknown"] is False  # it is being stopped yet
        failed = wait_for(client, location, "failed")
        assert failed["error"]["code"] == ("not-stopped" if killed else "runner-died")
        assert "Nobody saw its axes at rest: unknown, look" in failed["error"]["text"]
        assert "axis A1 was last seen operation enabled" in failed["error"]["text"]
        assert "axis A2 was not seen under power" in failed["error"]["text"]
        assert failed["error"]["axes"][0] == {"axis": "A1", "state": "operation enabled", "at": 0.0}
        assert failed["error"]["axes"][1] == {"axis": "A2", "state": None, "at": None}
        assert failed["stopped"]["action"]["code"] == "look"
        answer = client.post(STOP).json()
        assert (answer["stopping"], answer["unknown"]) == (False, True)
        director.die = director.deaf = False
        director.go.set()
        started(client)
        assert client.post(STOP).json()["unknown"] is False


def test_a_stop_reaches_the_runner_while_the_store_is_locked_and_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(tmp_path, Director(held_in="running")) as (client, director):
        location = started(client, "running")
        service = client.app.state.service  # type: ignore[attr-defined]

        def locked(*_: Any, **__: Any) -> None:
            time.sleep(1.0)
            raise OperationalError("locked", None, Exception("database is locked"))

        def full(*_: Any, **__: Any) -> None:
            time.sleep(3.0)
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(service.store, "save_state", locked)
        monkeypatch.setattr(service.store, "run", locked)
        monkeypatch.setattr(service.audit, "write", full)
        began = time.monotonic()
        assert client.post(STOP).status_code == 200
        assert time.monotonic() - began < 2.0
        until(director.workers[0].stopped.is_set, 2.0)
        monkeypatch.undo()
        wait_for(client, location, "stopped")


def test_cancel_is_idempotent_and_ended_states_never_change(tmp_path: Path) -> None:
    with running(tmp_path, Director(held_in="running")) as (client, _):
        location = started(client, "running")
        for _ in range(3):
            assert act(client, location, "cancel").json()["state"] == "cancelled"
        for kind in ("arm", "accept", "reject"):
            problem(act(client, location, kind), 409, "wrong-state")
        client.post(STOP)
        assert client.get(location).json()["state"] == "cancelled"


def test_a_runner_that_dies_makes_the_run_fail_and_frees_the_cell(tmp_path: Path) -> None:
    with running(tmp_path, Director(die=True)) as (client, director):
        location = start(client)
        failed = wait_for(client, location, "failed")
        assert failed["error"]["code"] == "runner-died"
        director.die = False
        started(client)


def test_a_run_nobody_arms_is_cancelled_after_its_time(tmp_path: Path) -> None:
    with running(tmp_path, arm_timeout_s=0.2) as (client, _):
        cancelled = wait_for(client, start(client, arm=False), "cancelled")
        assert cancelled["error"]["code"] == "timeout"


@pytest.mark.campaign
def test_accepted_models_form_a_history_and_can_be_restored(tmp_path: Path) -> None:
    with running(tmp_path) as (client, director):
        problem(client.get("/api/v1/cells/cell/model"), 404, "model-not-found")
        first = accepted(client)
        director.model = lambda: model_document(scale_mass=1.2)
        second = accepted(client)
        assert act(client, second, "accept").status_code == 200
        current = client.get("/api/v1/cells/cell/model").json()
        assert current["branches"][1]["masses"][2]["value"] == pytest.approx(7.2)
        old = first.rsplit("/", 1)[1]
        restored = client.post(f"/api/v1/cells/cell/models/{old}/restore").json()
        assert [h["how"] for h in restored["history"]] == ["restore", "accept", "accept"]
        assert client.get("/api/v1/cells/cell/model").json()["id"] == old


@pytest.mark.campaign
def test_changes_name_the_tool_and_nothing_else(tmp_path: Path) -> None:
    with running(tmp_path) as (client, director):
        problem(client.get("/api/v1/cells/cell/changes"), 409, "no-comparison")
        for scale in (1.0, 1.2):
            director.model = lambda scale=scale: model_document(scale_mass=scale)  # type: ignore[misc]
            accepted(client)
        changes = client.get("/api/v1/cells/cell/changes").json()
        assert changes["simulated"] is True
        assert [p["parameter"] for p in changes["parameters"] if p["status"] == "changed"] == ["A2.mass.3"]
        assert changes["sentence"].startswith("New load on A2: +")
        assert "looks like a tool change. Nothing else changed." in changes["sentence"]
        problem(client.get("/api/v1/cells/cell/changes?from=nothing"), 404, "model-not-found")


@pytest.mark.campaign
def test_the_default_changes_average_accepted_runs_and_two_named_models_only_where_asked(
    tmp_path: Path,
) -> None:
    with running(tmp_path) as (client, director):
        ids = []
        for scale in (1.0, 1.0, 1.0, 1.2, 1.2):
            director.model = lambda scale=scale: model_document(scale_mass=scale)  # type: ignore[misc]
            location = accepted(client)
            ids.append(location.rsplit("/", 1)[1])
            if len(ids) == 4:
                changes = client.get("/api/v1/cells/cell/changes").json()
                assert (changes["from"], changes["to"]) == (ids[2], ids[3])
                assert changes["averaged"] == {"from": ids[:3], "to": [ids[3]]}
                assert "means: the old values of 3 runs" in changes["sentence"]
                assert all(p["detectable_percent"] > 0 for p in changes["parameters"] if p["difference_std"])
        named = f"/api/v1/cells/cell/changes?from={ids[2]}&to={ids[4]}"
        assert client.get(named).json()["averaged"] == {"from": [ids[2]], "to": [ids[4]]}
        both = client.get(f"{named}&averaged=true").json()
        assert both["averaged"] == {"from": ids[:3], "to": ids[3:]}
        # Behind the change lies another state: it is not averaged with what came before.
        assert client.get("/api/v1/cells/cell/changes").json()["averaged"]["from"] == [ids[3]]


def test_every_request_that_can_move_the_robot_is_in_the_audit_log(tmp_path: Path) -> None:
    with running(tmp_path) as (client, _):
        location = started(client, "awaiting_arm", arm=False)
        act(client, location, "arm")
        wait_for(client, location, "awaiting_accept")
        act(client, location, "accept")
        client.post(STOP)
        until(lambda: len(client.get("/api/v1/audit").json()) >= 4, 30.0)
        lines = client.get("/api/v1/audit").json()
    assert [line["action"] for line in lines] == ["start", "arm", "accept", "stop"]
    assert {line["caller"] for line in lines} == {"local"}
    assert lines[0]["mode"] == "full"


def test_an_audit_log_that_cannot_be_written_lets_nothing_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(tmp_path) as (client, director):
        service = client.app.state.service  # type: ignore[attr-defined]

        def full(*_: Any, **__: Any) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(service.audit, "write", full)
        refused = client.post(START, json={"mode": "full", "arm": True})
        problem(refused, 507, "disk-full")
        for said in ("audit.jsonl", "No space left", "MiB are free", "retention_days"):
            assert said in refused.json()["detail"]

        def forbidden(*_: Any, **__: Any) -> None:
            raise OSError(13, "Permission denied")

        monkeypatch.setattr(service.audit, "write", forbidden)
        problem(client.post(START, json={"mode": "full", "arm": True}), 503, "store-unavailable")
        monkeypatch.undo()
        assert director.workers == []
        started(client)


def test_a_store_whose_disk_is_full_says_so_and_not_that_it_is_slow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = open_engine(f"sqlite:///{tmp_path / 'small.sqlite'}")
    with engine.connect() as connection:
        connection.exec_driver_sql("PRAGMA max_page_count = 4")  # as a disk that holds no more
        connection.exec_driver_sql("CREATE TABLE t (x)")
        with pytest.raises(OperationalError) as full:
            connection.exec_driver_sql(f"INSERT INTO t VALUES ('{'x' * 20_000}')")

    def refuse(*_: Any, **__: Any) -> None:
        raise full.value

    with running(tmp_path) as (client, _):
        service = client.app.state.service  # type: ignore[attr-defined]
        monkeypatch.setattr(service.store, "add_run", refuse)
        answer = client.post(START, json={"mode": "full", "arm": True})
        problem(answer, 503, "store-unavailable")
        assert "its disk is full" in answer.json()["detail"]
        assert "make room on the disk" in answer.json()["detail"]


def test_a_motion_of_which_nothing_is_heard_is_stopped(tmp_path: Path) -> None:
    with running(tmp_path, Director(held_in="running"), motion_silence_s=0.3) as (client, director):
        location = start(client)
        ended = wait_for(client, location, "cancelled", timeout=5.0)
        assert director.workers[0].said[-1] == Stop()
        assert not director.workers[0].killed.is_set() or ended["error"]["code"] == "timeout"
        assert "running" in ended["error"]["text"]


def test_the_grace_of_a_stop_is_longer_than_the_way_out_and_hardware_gets_no_shorter_one(
    tmp_path: Path,
) -> None:
    assert Settings().stop_grace_s > STOP_S > STOPPED_S
    (tmp_path / "cell.yaml").write_text(CELL.replace("invid-virtual", "socketcan"))
    with pytest.raises(ConfigError, match="stop_grace_s"):
        create_app(settings_in(tmp_path, stop_grace_s=3.0), launcher=Director().launch)
