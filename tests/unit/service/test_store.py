"""The store: migrations, files, restarts, older releases, retention."""

import hashlib
import shutil
import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from service_doubles import running, settings_in

from invid.errors import ConfigError
from invid.model.document import model_from_json
from invid.recording import read_recording
from invid_service.app import create_app
from invid_service.jobs.states import State
from invid_service.store.blobs import Blobs
from invid_service.store.database import open_engine, upgrade
from invid_service.store.lock import DataLock
from invid_service.store.store import RunRecord, Store
from invid_service.store.tables import METADATA

V1 = Path(__file__).parents[2] / "data" / "store-v1"
ACCEPTED, FAILED = "20261101T080000-00000001", "20261101T090000-00000002"
WAITING, CUT_OFF = "20261101T100000-00000003", "20261101T110000-00000004"


def record(identity: str, state: State, cell: str | None = "cell") -> RunRecord:
    now = datetime.now(UTC)
    return RunRecord(identity, cell, "robot", "full", ("A1",), True, state, now, "local")


def test_the_migrations_make_exactly_the_tables_of_today(tmp_path: Path) -> None:
    engine = open_engine(f"sqlite:///{tmp_path / 'store.sqlite'}")
    upgrade(engine)
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, METADATA) == []
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "wal"


def test_a_store_of_an_older_release_still_opens(tmp_path: Path) -> None:
    shutil.copytree(V1, tmp_path, dirs_exist_ok=True)
    with running(tmp_path) as (client, _):
        runs = {r["id"]: r for r in client.get("/api/v1/identifications").json()["identifications"]}
        assert runs[ACCEPTED]["state"] == "succeeded"
        assert runs[FAILED]["error"]["text"] == "A2 does not answer"
        assert runs[CUT_OFF]["state"] == "interrupted"
        model = client.get("/api/v1/cells/cell/model").json()
        assert model["id"] == ACCEPTED
        assert model_from_json(model).chains.masses[1].tolist() == [4.0, 5.0, 6.0]
        for kind in ("recording", "model", "diagnosis", "report"):
            answer = client.get(f"/api/v1/identifications/{ACCEPTED}/{kind}")
            assert answer.status_code == 200
        file = tmp_path / "old.h5"
        file.write_bytes(client.get(f"/api/v1/identifications/{ACCEPTED}/recording").content)
        assert read_recording(file).experiments[0].samples == 200
        done = client.post(f"/api/v1/identifications/{WAITING}/actions", json={"type": "accept"})
        assert done.json()["state"] == "succeeded"
        changes = client.get("/api/v1/cells/cell/changes").json()
        assert [p["parameter"] for p in changes["parameters"] if p["status"] == "changed"] == ["A2.mass.3"]


def test_a_store_is_copied_before_a_migration_and_the_copy_is_the_way_back(tmp_path: Path) -> None:
    shutil.copytree(V1, tmp_path, dirs_exist_ok=True)
    store = tmp_path / "data" / "store.sqlite"
    before = rows_of(store)
    with running(tmp_path) as (client, _):
        client.post(f"/api/v1/identifications/{WAITING}/actions", json={"type": "accept"})
    (copy,) = store.parent.glob("store-schema-0001-*.sqlite")
    assert rows_of(copy) == before != rows_of(store)
    with running(tmp_path):  # nothing to migrate, nothing to copy
        assert list(store.parent.glob("store-schema-*")) == [copy]
    # Back, as the page on upgrades says.
    for beside in ("-wal", "-shm"):
        store.with_name(store.name + beside).unlink(missing_ok=True)
    shutil.copy(copy, store)
    assert rows_of(store) == before
    with running(tmp_path) as (client, _):
        assert client.get(f"/api/v1/identifications/{WAITING}").json()["state"] == "awaiting_accept"


def rows_of(store: Path) -> dict[str, list[Any]]:
    """Every row of every table."""
    with closing(sqlite3.connect(store)) as connection:
        tables = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")
        return {name: connection.execute(f"SELECT * FROM {name}").fetchall() for (name,) in tables.fetchall()}


def test_a_store_of_a_newer_release_is_refused_with_the_way_back(tmp_path: Path) -> None:
    with running(tmp_path):
        pass
    store = tmp_path / "data" / "store.sqlite"
    with closing(sqlite3.connect(store)) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    with pytest.raises(ConfigError, match=r"newer invid made it \(schema 9999.*put back the copy"):
        create_app(settings_in(tmp_path))


@pytest.mark.parametrize("state", ["awaiting_arm", "running", "analysing"])
def test_a_restart_interrupts_what_it_cut_off_and_never_runs_it_again(tmp_path: Path, state: str) -> None:
    engine = open_engine(f"sqlite:///{tmp_path / 'data' / 'store.sqlite'}")
    (tmp_path / "data").mkdir()
    upgrade(engine)
    store = Store(engine)
    store.add_run(record("20261121T000000-0000000a", State.QUEUED))
    store.save_state(record("20261121T000000-0000000a", State(state)), None)
    store.close()
    with running(tmp_path) as (client, director):
        location = "/api/v1/identifications/20261121T000000-0000000a"
        body = client.get(location).json()
        assert body["state"] == "interrupted"
        assert body["error"]["code"] == "interrupted"
        assert '"state":"interrupted"' in client.get(f"{location}/events").text
        assert director.workers == []
        assert client.get("/api/v1/cells/cell/readiness").json()["can_start"] is True


def test_a_second_service_on_the_same_data_folder_is_refused(tmp_path: Path) -> None:
    lock = DataLock(tmp_path / "data")
    with pytest.raises(ConfigError, match="another invid service"):
        create_app(settings_in(tmp_path))
    lock.release()
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(ConfigError, match=r"cannot be written.*--data-dir"):
        DataLock(tmp_path / "file" / "data")


def test_stored_files_are_whole_checksummed_and_inside_the_store(tmp_path: Path) -> None:
    blobs = Blobs(tmp_path / "files")
    source = tmp_path / "model.json"
    source.write_text("{}")
    blob = blobs.put("run", "model", source)
    path = blobs.path(blob.path)
    assert hashlib.sha256(path.read_bytes()).hexdigest() == blob.sha256
    assert not list(tmp_path.rglob("*.part"))
    with pytest.raises(ValueError, match="outside"):
        blobs.path("../../etc/passwd")


@pytest.mark.parametrize("url", ["nonsense", "sqlite:////nowhere/at/all.sqlite", "nodb://x/y"])
def test_a_database_that_cannot_be_opened_is_one_sentence(tmp_path: Path, url: str) -> None:
    with pytest.raises(ConfigError, match=r"database_url|store"):
        create_app(settings_in(tmp_path, database_url=url))
