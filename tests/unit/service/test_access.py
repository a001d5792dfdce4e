"""Who may call, from where, and what a misspelt question is answered."""

from __future__ import annotations

import json
import shutil
import sqlite3
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from service_doubles import Director, running, wait_for

from invid.cli.app import run
from invid.errors import ConfigError
from invid_service.keys import Keys, add_key, revoke_key
from invid_service.service import build, utc_now
from invid_service.settings import Settings

CELLS = "/api/v1/cells"
START = "/api/v1/cells/cell/identifications"
STOP = "/api/v1/cells/cell/stop"


def kind(answer: Any) -> str:
    return str(answer.json()["type"]).removeprefix("urn:invid:problem:")


def bearer(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"}


# --- loopback and proxies --------------------------------------------------------------------------
def test_with_keys_configured_loopback_is_asked_for_one_too(tmp_path: Path) -> None:
    key = add_key(tmp_path / "keys.json", "plc", ["read", "run"])
    with running(tmp_path, key_file=tmp_path / "keys.json") as (client, director):
        for headers in ({}, {"X-Forwarded-For": "127.0.0.1"}, {"X-Forwarded-For": "10.0.0.7"}):
            assert kind(client.get(CELLS, headers=headers)) == "key-missing"
            assert kind(client.post(START, json={"mode": "full"}, headers=headers)) == "key-missing"
        assert director.workers == []
        assert client.get(CELLS, headers=bearer(key)).status_code == 200


def test_with_keys_the_public_host_name_of_a_proxy_is_no_reason_to_refuse(tmp_path: Path) -> None:
    key = add_key(tmp_path / "keys.json", "plc", ["read", "run"])
    with running(tmp_path, key_file=tmp_path / "keys.json") as (client, _):
        headers = {**bearer(key), "Host": "robots.example", "Origin": "https://robots.example"}
        assert client.get(CELLS, headers=headers).status_code == 200
        assert client.post(START, json={"mode": "full"}, headers=headers).status_code == 202
        elsewhere = {**headers, "Origin": "https://evil.example"}
        assert kind(client.post(START, json={"mode": "full"}, headers=elsewhere)) == "foreign-origin"


@pytest.mark.parametrize("header", ["X-Forwarded-For", "Forwarded", "X-Real-IP", "Via", "X-Forwarded-Host"])
def test_without_keys_nobody_comes_in_through_a_proxy(tmp_path: Path, header: str) -> None:
    with running(tmp_path) as (client, director):
        answer = client.post(START, json={"mode": "full", "arm": True}, headers={header: "10.0.0.7"})
        assert kind(answer) == "foreign-origin"
        assert "--key-file" in answer.json()["detail"]
        assert director.workers == []
        assert client.get(CELLS).status_code == 200


def test_a_trusted_proxy_without_keys_is_refused_at_the_start(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data", trusted_proxies=["127.0.0.1"])
    with pytest.raises(ConfigError, match="no key is configured"):
        build(settings, Director().launch, utc_now)


@pytest.mark.parametrize("cut", [True, False])
def test_under_a_root_path_page_calls_and_links_agree_whether_or_not_the_proxy_cuts_it(
    tmp_path: Path, cut: bool
) -> None:
    with running(tmp_path, root_path="/robots/invid") as (client, _):
        front = "" if cut else "/robots/invid"
        page = client.get(f"{front}/").text
        assert 'src="/robots/invid/static/page.js"' in page
        assert client.get(f"{front}/static/page.js").status_code == 200
        answer = client.post(f"{front}{START}", json={"mode": "full", "arm": True})
        location = answer.headers["Location"]
        assert location.startswith("/robots/invid/api/v1/identifications/")
        links = answer.json()["links"].values()
        assert all(link.startswith("/robots/invid/api/v1/") for link in links)
        assert wait_for(client, location, "awaiting_accept")


# --- keys without a restart ------------------------------------------------------------------------
def test_a_key_added_or_revoked_counts_without_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "keys.json"
    first = add_key(path, "first", ["read"])
    with running(tmp_path, key_file=path) as (client, _):

        def becomes(status: int, key: str) -> bool:
            deadline = time.monotonic() + 10
            while time.monotonic() < deadline:
                if client.get(CELLS, headers=bearer(key)).status_code == status:
                    return True
                time.sleep(0.05)
            return False

        second = add_key(path, "second", ["read"])
        assert becomes(200, second)
        revoke_key(path, "first")
        assert becomes(401, first)
        assert client.get(CELLS, headers=bearer(second)).status_code == 200
        revoke_key(path, "second")  # the last one: the service is closed, not open
        assert becomes(401, second)
        assert kind(client.get(CELLS)) == "key-missing"


def test_a_key_file_that_breaks_leaves_the_keys_in_force(tmp_path: Path) -> None:
    path = tmp_path / "keys.json"
    key = add_key(path, "plc", ["read"])
    keys = Keys(path)
    path.write_text("{ not json")
    assert not keys.reload()
    assert keys.caller(key, utc_now()).name == "plc"


def test_keys_are_listed_revoked_and_end_by_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "keys.json"

    def keys(*arguments: str, status: int = 0) -> str:
        assert run(["keys", *arguments, "--key-file", str(path)]) == status
        said = capsys.readouterr()
        return said.out if status == 0 else said.err

    token = keys("add", "plc:read,run", "--days", "30").strip()
    assert token.startswith("invid_")
    listed = json.loads(keys("list", "--json"))["keys"]
    assert [(k["name"], k["scopes"], k["expired"]) for k in listed] == [("plc", ["read", "run"], False)]
    assert token.split("_", 2)[2] not in path.read_text()
    assert path.stat().st_mode & 0o777 == 0o600
    keys("revoke", listed[0]["id"])
    assert json.loads(keys("list", "--json"))["keys"] == []
    assert "neither id nor name" in keys("revoke", "nobody", status=2)


# --- questions -------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "path", [f"{CELLS}?cel=a", "/api/v1/identifications?sate=failed", f"{CELLS}/cell/changes?form=x"]
)
def test_a_parameter_that_a_call_does_not_have_is_refused_with_those_it_has(
    tmp_path: Path, path: str
) -> None:
    with running(tmp_path) as (client, _):
        answer = client.get(path)
        assert answer.status_code == 422
        assert path.split("?")[1].split("=")[0] in answer.json()["detail"]


def test_a_stop_is_not_refused_for_a_parameter(tmp_path: Path) -> None:
    with running(tmp_path) as (client, _):
        assert client.post(f"{STOP}?why=fire").status_code == 200


def test_the_list_of_identifications_is_paged_and_filtered(tmp_path: Path) -> None:
    with running(tmp_path) as (client, director):
        made = []
        for k in range(5):
            if k == 3:
                director.failure = {"code": "drive", "text": "a drive failed", "fix": "look at it"}
            location = client.post(START, json={"mode": "full", "arm": True}).headers["Location"]
            state = wait_for(client, location, "awaiting_accept", "failed")["state"]
            if state == "awaiting_accept":
                client.post(f"{location}/actions", json={"type": "reject"})
            made.append(location.rsplit("/", 1)[1])
        found, path = [], "/api/v1/identifications?limit=2&cell=cell"
        while path is not None:
            answer = client.get(path).json()
            found += [r["id"] for r in answer["identifications"]]
            path = answer["next"]
        assert found == made[::-1]
        failed = client.get("/api/v1/identifications?state=failed").json()["identifications"]
        assert [r["id"] for r in failed] == made[:2:-1]
        third = client.get(f"/api/v1/identifications/{made[2]}").json()["created"]
        params = {"since": third}
        later = client.get("/api/v1/identifications", params=params).json()["identifications"]
        assert [r["id"] for r in later] == made[:1:-1]
        earlier = client.get("/api/v1/identifications", params={"until": third}).json()["identifications"]
        assert [r["id"] for r in earlier] == made[1::-1]
        assert kind(client.get("/api/v1/identifications?cursor=nothing")) == "invalid-request"
        assert kind(client.get("/api/v1/identifications?state=gone")) == "invalid-request"


# --- results that are not to be trusted --------------------------------------------------------------
@pytest.mark.parametrize(("mode", "verdict"), [("test", "consistent"), ("full", "unexplained")])
def test_an_untrusted_result_is_accepted_only_with_a_reason_which_is_kept(
    tmp_path: Path, mode: str, verdict: str
) -> None:
    with running(tmp_path) as (client, director):
        director.verdict = verdict
        location = client.post(START, json={"mode": mode, "arm": True}).headers["Location"]
        assert wait_for(client, location, "awaiting_accept")["untrusted"]
        refused = client.post(f"{location}/actions", json={"type": "accept"})
        assert (refused.status_code, kind(refused)) == (409, "override-needed")
        assert client.get(f"{CELLS}/cell/model").status_code == 404
        answer = client.post(f"{location}/actions", json={"type": "accept", "override": "the line waits"})
        assert answer.json()["state"] == "succeeded"
        assert answer.json()["decision"]["override"] == "the line waits"
        audited = client.get("/api/v1/audit").json()
        assert any(
            line["action"] == "accept" and line.get("override") == "the line waits" for line in audited
        )
        assert client.get(f"{CELLS}/cell/model").status_code == 200


def test_a_trusted_result_needs_no_reason(tmp_path: Path) -> None:
    with running(tmp_path) as (client, _):
        location = client.post(START, json={"mode": "full", "arm": True}).headers["Location"]
        assert wait_for(client, location, "awaiting_accept")["untrusted"] is None
        assert client.post(f"{location}/actions", json={"type": "accept"}).json()["state"] == "succeeded"


def test_every_event_of_a_simulated_cell_says_so(tmp_path: Path) -> None:
    with running(tmp_path) as (client, _):
        location = client.post(START, json={"mode": "full", "arm": True}).headers["Location"]
        wait_for(client, location, "awaiting_accept")
        client.post(f"{location}/actions", json={"type": "reject"})
        lines = client.get(f"{location}/events").text.splitlines()
        bodies = [json.loads(line[6:]) for line in lines if line.startswith("data: ")]
        assert bodies
        assert all(body.get("simulated") is True for body in bodies), bodies


def test_a_missing_database_driver_names_the_way_out(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data", database_url="postgresql+asyncpg2://u@h/d")
    with pytest.raises(ConfigError, match="database_url"):
        build(settings, Director().launch, utc_now)


@pytest.mark.campaign
def test_a_copy_taken_while_the_service_runs_can_be_served(tmp_path: Path) -> None:
    with running(tmp_path) as (client, _):
        location = client.post(START, json={"mode": "full", "arm": True}).headers["Location"]
        wait_for(client, location, "awaiting_accept")
        client.post(f"{location}/actions", json={"type": "accept"})
        kept = client.get(f"{CELLS}/cell/model").json()
        fresh = tmp_path / "fresh" / "data"
        fresh.mkdir(parents=True)
        # what `sqlite3 store.sqlite ".backup …"` does
        with (
            closing(sqlite3.connect(tmp_path / "data" / "store.sqlite")) as source,
            closing(sqlite3.connect(fresh / "store.sqlite")) as target,
        ):
            source.backup(target)
        shutil.copytree(tmp_path / "data" / "files", fresh / "files")
        client.post(START, json={"mode": "full", "arm": True})  # comes after the copy
    with running(tmp_path / "fresh", cells=[tmp_path / "cell.yaml"]) as (client, _):
        assert client.get(f"{CELLS}/cell/model").json() == kept
        assert client.get(f"{location}/report").text.startswith("<html")
        assert len(client.get("/api/v1/identifications").json()["identifications"]) == 1
