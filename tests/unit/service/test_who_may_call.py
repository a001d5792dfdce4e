"""Who may call, from where, and with what: keys, scopes, foreign pages, oversized and malformed requests."""

import io
import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import pytest
from service_doubles import START, Director, bearer, kind, running, settings_in, start, until, wait_for

from invid.cli.app import run
from invid.errors import ConfigError
from invid_service.app import create_app
from invid_service.keys import Keys, add_key, revoke_key
from invid_service.recordings.declared import look
from invid_service.service import build, utc_now
from invid_service.settings import Settings


@pytest.fixture
def keys(tmp_path: Path) -> dict[str, str]:
    path = tmp_path / "keys.json"
    made = {s: add_key(path, s, [s]) for s in ("read", "run", "accept", "admin")}
    made["old"] = add_key(path, "old", ["admin"], expires=datetime.now(UTC) - timedelta(days=1))
    assert not any(token in path.read_text() for token in made.values())
    assert path.stat().st_mode & 0o077 == 0
    return made


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "robot.local"])
def test_a_bind_beyond_loopback_without_a_key_is_refused(tmp_path: Path, host: str) -> None:
    with pytest.raises(ConfigError, match="no key"):
        create_app(settings_in(tmp_path, host=host))


def test_keys_open_what_their_scopes_say_and_nothing_else(tmp_path: Path, keys: dict[str, str]) -> None:
    given = {"host": "0.0.0.0", "key_file": tmp_path / "keys.json"}
    with running(tmp_path, **given) as (client, _):
        assert kind(client.get("/api/v1/cells")) == "key-missing"
        assert client.get("/api/v1/health/live").status_code == 200
        assert client.get("/").status_code == 200
        assert client.get("/api/v1/cells", headers=bearer(keys["read"])).status_code == 200
        assert client.get("/api/v1/cells", headers={"X-API-Key": keys["read"]}).status_code == 200
        body = {"mode": "full", "arm": True}
        assert kind(client.post(START, json=body, headers=bearer(keys["read"]))) == "scope-missing"
        assert kind(client.post(START, json=body)) == "key-missing"
        started = client.post(START, json=body, headers=bearer(keys["run"]))
        location = started.headers["Location"]
        client.headers.update(bearer(keys["admin"]))
        wait_for(client, location, "awaiting_accept")
        actions = f"{location}/actions"
        assert (
            kind(client.post(actions, json={"type": "accept"}, headers=bearer(keys["run"])))
            == "scope-missing"
        )
        assert (
            kind(client.post(actions, json={"type": "cancel"}, headers=bearer(keys["accept"])))
            == "scope-missing"
        )
        accepted = client.post(actions, json={"type": "accept"}, headers=bearer(keys["accept"]))
        assert accepted.json()["decision"]["by"] == "accept"
        assert kind(client.get("/api/v1/audit", headers=bearer(keys["run"]))) == "scope-missing"
        assert [e["caller"] for e in client.get("/api/v1/audit").json()] == ["run", "accept"]


def test_wrong_expired_and_misplaced_keys_are_refused(tmp_path: Path, keys: dict[str, str]) -> None:
    for host in ("127.0.0.1", "0.0.0.0"):
        with running(tmp_path, host=host, key_file=tmp_path / "keys.json") as (client, _):
            path = "/api/v1/cells"
            for headers in ({}, {"X-Forwarded-For": "127.0.0.1"}, {"X-Forwarded-For": "10.0.0.7"}):
                assert kind(client.get(path, headers=headers)) == "key-missing"
            for token in ("x", "invid_0_0", keys["read"][:-1], keys["read"] + "x", "invid_" + "é" * 10):
                headers = [(b"authorization", b"Bearer " + token.encode())]
                assert kind(client.get(path, headers=headers)) == "key-invalid"  # type: ignore[arg-type]
            assert kind(client.get(path, headers={"Authorization": f"Basic {keys['read']}"})) == "key-invalid"
            expired = client.get(path, headers=bearer(keys["old"]))
            assert kind(expired) == "key-invalid"
            assert "expired" in expired.json()["detail"]
            assert expired.headers["WWW-Authenticate"] == "Bearer"
            if host == "0.0.0.0":
                assert kind(client.get(path, params={"key": keys["read"]})) == "key-missing"


def test_a_stop_asks_for_no_key_and_a_web_site_of_others_cannot_ask_for_it(
    tmp_path: Path, keys: dict[str, str]
) -> None:
    with running(tmp_path, host="0.0.0.0", key_file=tmp_path / "keys.json") as (client, _):
        for stop in ("/api/v1/cells/cell/stop", "/api/v1/stop"):
            for headers in ({}, bearer(keys["read"]), bearer(keys["old"]), bearer("invid_x_y")):
                assert client.post(stop, headers=headers).status_code == 200
            foreign = client.post(stop, headers={"Origin": "https://evil.example"})
            assert kind(foreign) == "foreign-origin"
        assert kind(client.get("/api/v1/state")) == "key-missing"
        audit = client.app.state.service.audit  # type: ignore[attr-defined]
        until(lambda: len(audit.tail(100)) >= 2)
        # Whoever has no key fills no disk with stops of what stands still.
        assert {line["caller"] for line in audit.tail(100)} == {"read"}


def test_behind_a_proxy_that_changes_the_host_our_page_stops_and_calls_and_others_still_do_not(
    tmp_path: Path, keys: dict[str, str]
) -> None:
    with running(tmp_path, key_file=tmp_path / "keys.json", trusted_proxies=["127.0.0.1"]) as (client, _):
        changed = {"Host": "127.0.0.1:8000", "Origin": "https://cell.plant.example", "Via": "1.1 proxy"}
        ours = {**changed, "X-Requested-With": "invid"}
        for stop in ("/api/v1/cells/cell/stop", "/api/v1/stop"):
            assert client.post(stop, headers=ours).status_code == 200
            assert kind(client.post(stop, headers=changed)) == "foreign-origin"
        body = {"mode": "full", "arm": False}
        assert client.post(START, json=body, headers={**ours, **bearer(keys["run"])}).status_code == 202


def test_a_service_without_keys_knows_no_name_but_those_of_this_machine(tmp_path: Path) -> None:
    with running(tmp_path) as (client, _):
        for host in ("testserver", "evil.example", "127.0.0.1.evil.example"):
            assert kind(client.get("/api/v1/cells", headers={"Host": host})) == "foreign-origin"
            assert client.post("/api/v1/stop", headers={"Host": host}).status_code == 200
        for host in ("127.0.0.1", "127.0.0.1:8000", "localhost:8000", "[::1]:8000"):
            assert client.get("/api/v1/cells", headers={"Host": host}).status_code == 200


def test_a_web_site_in_the_technicians_browser_cannot_move_the_robot(tmp_path: Path) -> None:
    with running(tmp_path) as (client, director):
        body = {"mode": "full", "arm": True}
        foreign = client.post(START, json=body, headers={"Origin": "https://evil.example"})
        assert kind(foreign) == "foreign-origin"
        rebound = client.post(START, json=body, headers={"Host": "evil.example"})
        assert kind(rebound) == "foreign-origin"
        plain = client.post(
            START, content='{"mode":"full","arm":true}', headers={"Content-Type": "text/plain"}
        )
        assert plain.status_code == 415
        assert director.workers == []


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"mode": "fast"},
        {"mode": "full", "axes": []},
        {"mode": "full", "axes": ["A9"]},
        {"mode": "full", "arm": "true"},
        {"mode": "full", "amplitude": 10},
        [],
        "full",
    ],
)
def test_a_start_with_anything_unknown_in_it_is_refused(tmp_path: Path, body: object) -> None:
    with running(tmp_path) as (client, director):
        assert kind(client.post(START, json=body)) == "invalid-request"
        assert director.workers == []


def test_an_upload_announced_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with running(tmp_path, max_upload_bytes=1000) as (client, _):
        headers = {"Content-Type": "application/x-hdf5", "Content-Length": str(2 * 1024**3)}
        refused = client.post("/api/v1/recordings", content=b"x", headers=headers)
        assert kind(refused) == "too-large"
        lying = client.post("/api/v1/cells/cell/stop", content=b"x", headers={"Content-Length": "-5"})
        assert kind(lying) == "bad-request"


@pytest.mark.parametrize("media", ["application/x-hdf5", "multipart/form-data"])
def test_an_upload_that_grows_beyond_the_limit_is_cut_off_and_leaves_nothing(
    tmp_path: Path, media: str
) -> None:
    def chunks() -> Iterator[bytes]:
        yield b"\x89HDF\r\n\x1a\n"
        for _ in range(100):
            yield b"\0" * 10_000

    with running(tmp_path, max_upload_bytes=50_000) as (client, director):
        if media == "application/x-hdf5":
            answer = client.post("/api/v1/recordings", content=chunks(), headers={"Content-Type": media})
        else:
            answer = client.post("/api/v1/recordings", files={"file": io.BytesIO(b"".join(chunks()))})
        assert kind(answer) == "too-large"
        assert director.workers == []
        assert list((tmp_path / "data" / "work").iterdir()) == []


def hdf5(path: Path, *, rows: int = 100, chunk: int | None = None, links: int = 1) -> Path:
    """A file that claims to be a recording: datasets declared, next to nothing written."""
    with h5py.File(path, "w") as file:
        file.attrs["format"] = "invid-recording"
        for k in range(links):
            node = file.create_group(f"experiments/{k:03d}")
            if k:
                node["torque"] = file["experiments/000/torque"]
            else:
                shape = (rows, 1)
                data = node.create_dataset(
                    "torque", shape, "f8", chunks=(chunk or rows, 1), maxshape=(None, 1), compression="gzip"
                )
                data.id.set_extent(shape)
    return path


@pytest.mark.parametrize(
    ("claim", "expected", "said"),
    [
        ({"rows": 2_000_000_000, "chunk": 1_000_000}, "too-large", "unpack to 16000 MB"),
        # 0.7 MB that unpacked to 1.4 GB was analysed for minutes; what is refused is the ratio, too.
        ({"rows": 12_500_000, "chunk": 1_000_000}, "too-large", "no measured data"),
        ({"rows": 10, "chunk": 400_000_000}, "too-large", "unpack to 3200 MB"),
        ({"rows": 5_000_000, "chunk": 5_000_000, "links": 50}, "too-large", "unpack to 2000 MB"),
    ],
)
def test_a_file_that_unpacks_to_far_more_than_it_is_gets_refused_before_it_is_unpacked(
    tmp_path: Path, claim: dict[str, int], expected: str, said: str
) -> None:
    bomb = hdf5(tmp_path / "bomb.h5", **claim).read_bytes()
    assert len(bomb) < 1_000_000
    with running(tmp_path) as (client, director):
        answer = client.post(
            "/api/v1/recordings", content=bomb, headers={"Content-Type": "application/x-hdf5"}
        )
        assert kind(answer) == expected
        assert said in answer.json()["detail"]
        assert director.workers == []
        assert list((tmp_path / "data" / "work").iterdir()) == []
        assert client.get("/api/v1/identifications").json()["identifications"] == []


@pytest.mark.parametrize("way", ["group", "experiment", "dataset", "round about", "virtual", "raw"])
def test_a_file_that_takes_its_data_from_other_files_of_the_machine_is_refused(
    tmp_path: Path, way: str
) -> None:
    other = hdf5(tmp_path / "private.h5")
    with h5py.File(tmp_path / "sent.h5", "w") as file:
        file.attrs["format"] = "invid-recording"
        match way:
            case "group":
                file["experiments"] = h5py.ExternalLink(other, "/experiments")
            case "experiment":
                file["experiments/000"] = h5py.ExternalLink(other, "/experiments/000")
            case "dataset":
                file["experiments/000/torque"] = h5py.ExternalLink(other, "/experiments/000/torque")
            case "round about":
                file["x"] = h5py.ExternalLink(other, "/")
                file["experiments/000"] = h5py.SoftLink("/x/experiments/000")
            case "virtual":
                layout = h5py.VirtualLayout((100, 1), "f8")
                layout[:] = h5py.VirtualSource(other, "/experiments/000/torque", (100, 1))
                file.create_virtual_dataset("experiments/000/torque", layout)
            case _:
                file.create_dataset("experiments/000/torque", (10, 1), "f8", external=[(other, 0, 80)])
    assert "takes its data from other files" in look(tmp_path / "sent.h5")["problem"]
    assert "unpacked" in look(other)


def test_an_internal_error_is_a_problem_without_its_secrets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(tmp_path) as (client, _):
        service = client.app.state.service  # type: ignore[attr-defined]

        def broken(*_: object, **__: object) -> None:
            raise RuntimeError("secret path /root/x")

        monkeypatch.setattr(service.store, "runs", broken)
        answer = client.get("/api/v1/identifications")
        assert kind(answer) == "internal-error"
        assert "secret" not in answer.text


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
            return bool(until(lambda: client.get(CELLS, headers=bearer(key)).status_code == status))

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
