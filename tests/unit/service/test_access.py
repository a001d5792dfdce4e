"""Who may call, from where, and what a misspelt question is answered."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest
from service_doubles import START, Director, bearer, kind, running, start, wait_for

from invid.cli.app import run
from invid.errors import ConfigError
from invid_service.keys import Keys, add_key, revoke_key
from invid_service.service import build, utc_now
from invid_service.settings import Settings

CELLS = "/api/v1/cells"
STOP = "/api/v1/cells/cell/stop"


# --- loopback and proxies --------------------------------------------------------------------------


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


# --- results that are not to be trusted --------------------------------------------------------------
@pytest.mark.parametrize(("mode", "verdict"), [("test", "consistent"), ("full", "unexplained")])
def test_an_untrusted_result_is_accepted_only_with_a_reason_which_is_kept(
    tmp_path: Path, mode: str, verdict: str
) -> None:
    with running(tmp_path) as (client, director):
        director.verdict = verdict
        location = start(client, mode=mode)
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


def test_a_key_file_that_breaks_leaves_the_keys_in_force(tmp_path: Path) -> None:
    path = tmp_path / "keys.json"
    key = add_key(path, "plc", ["read"])
    keys = Keys(path)
    path.write_text("{ not json")
    assert not keys.reload()
    assert keys.caller(key, utc_now()).name == "plc"
