"""The store on a real PostgreSQL: Debian's server, started for these tests on a socket of its own."""

import os
import pwd
import shutil
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from invid_service.jobs.states import State
from invid_service.store.database import open_engine, upgrade
from invid_service.store.store import (
    CellBusyError,
    KeyReusedError,
    RunRecord,
    Store,
    StoredEvent,
    StoredModel,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "service"))
from service_doubles import running, wait_for

SERVERS = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
pytestmark = [
    pytest.mark.skipif(
        not SERVERS,
        reason="POSTGRESQL IS MISSING: the store is tested on SQLite only; apt-get install postgresql",
    ),
    pytest.mark.service,
]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """URL of a fresh server that listens on no port."""
    folder = tmp_path_factory.mktemp("postgresql")
    data, programs = folder / "data", SERVERS[-1].parent
    as_user: dict[str, object] = {}
    if os.getuid() == 0:  # PostgreSQL refuses to run as root
        account = pwd.getpwnam("postgres")
        for parent in [folder, *folder.parents]:
            if parent.owner() == "root" and parent != Path("/") and str(parent).startswith("/tmp/"):
                parent.chmod(parent.stat().st_mode | 0o011)
        shutil.chown(folder, "postgres")
        as_user = {"user": account.pw_uid, "group": account.pw_gid, "extra_groups": []}
    quiet = {"stdout": subprocess.DEVNULL, "cwd": folder, **as_user}
    initdb = [programs / "initdb", "-D", data, "-U", "invid", "-A", "trust", "--no-sync"]
    subprocess.run(initdb, check=True, timeout=120, **quiet)  # type: ignore[call-overload]
    options = f"-k {folder} -c listen_addresses='' -c fsync=off"
    control = [programs / "pg_ctl", "-D", data, "-l", folder / "log", "-w"]
    subprocess.run([*control, "-o", options, "start"], check=True, timeout=60, **quiet)  # type: ignore[call-overload]
    try:
        yield f"postgresql+psycopg://invid@/postgres?host={folder}"
    finally:
        subprocess.run([*control, "-m", "immediate", "stop"], timeout=60, **quiet)  # type: ignore[call-overload]


@pytest.mark.panel
@pytest.mark.campaign
def test_a_whole_run_is_stored_accepted_compared_and_survives_a_restart(server: str, tmp_path: Path) -> None:
    with running(tmp_path, database_url=server) as (client, _):
        locations = []
        for _n in range(2):
            answer = client.post(
                "/api/v1/cells/cell/identifications",
                json={"mode": "full", "arm": True},
                headers={"Idempotency-Key": f"k{_n}"},
            )
            locations.append(answer.headers["Location"])
            wait_for(client, locations[-1], "awaiting_accept")
            assert client.post(f"{locations[-1]}/actions", json={"type": "accept"}).status_code == 200
        assert client.get("/api/v1/cells/cell/changes").json()["sentence"].startswith("Nothing changed")
    with running(tmp_path, database_url=server) as (client, _):
        assert client.get(locations[0]).json()["state"] == "succeeded"
        assert len(client.get("/api/v1/cells/cell/models").json()["history"]) == 2
        assert "event: state" in client.get(f"{locations[0]}/events").text


def test_the_database_keeps_the_promises_of_the_store(server: str) -> None:
    engine = open_engine(server)
    upgrade(engine)
    store = Store(engine)
    now = datetime.now(UTC)

    def record(identity: str, state: State = State.QUEUED) -> RunRecord:
        return RunRecord(identity, "pg", "robot", "full", ("A1",), False, state, now, "local")

    store.add_run(record("pg-1"), idempotency_key="k", body_sha256="a" * 64)
    assert store.find_idempotent("pg", "k", "a" * 64) == store.run("pg-1")
    with pytest.raises(KeyReusedError):
        store.find_idempotent("pg", "k", "b" * 64)
    with pytest.raises(CellBusyError):
        store.add_run(record("pg-4"))
    store.save_state(record("pg-1", State.RUNNING), StoredEvent(2**41, "state", {"state": "running"}))
    (cut,) = [
        r for r in store.interrupt_unfinished(now, lambda run: {"code": "interrupted"}) if r.cell == "pg"
    ]
    assert cut.state is State.INTERRUPTED
    assert cut.created == now
    assert next(e.id for e in store.events("pg-1")) == 2**41
    store.add_model(StoredModel("pg-1", "pg", now, "full", "{}"))
    store.approve("pg", "pg-1", by="x", how="accept", now=now)
    assert [a.model for a in store.approvals("pg")] == ["pg-1"]
    store.close()
