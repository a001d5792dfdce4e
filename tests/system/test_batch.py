"""``invid batch``: on this machine, on a real Dask cluster of two workers, with processes killed."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_contract_surface import write_recording

import invid
from invid.batch.analysis import COLUMNS, Options, Results, analyse_apart
from invid.cli import app
from invid.model.diagnosis_document import diagnosis_to_json
from invid.model.document import dump_json, model_to_json
from invid.processes import Helper

# One worker makes the recordings and the results to compare with once.
pytestmark = pytest.mark.xdist_group("batch")

GOOD = ("cell 1/week 01.h5", "cell 1/week 02.h5", "cell 2/week 01.h5", "cell 2/week 02.hdf5")
BAD = ("cell 1/cut.h5", "no recording.h5")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("recordings")
    for k, name in enumerate(GOOD):
        (root / name).parent.mkdir(exist_ok=True)
        write_recording(root / name, np.arange(5 + k, 400, 7 + k), 5.0, 0.01)
    (root / BAD[0]).write_bytes((root / GOOD[0]).read_bytes()[:3000])
    (root / BAD[1]).write_text("nothing of the kind")
    return root


def batch(*arguments: str | Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "invid", "batch", *map(str, arguments)]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell that started the tests in the background has told its children to ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def run(*arguments: str | Path) -> tuple[int, str, str]:
    process = batch(*arguments)
    out, err = process.communicate(timeout=500)
    return process.returncode, out, err


@pytest.fixture(scope="module")
def local(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    results = tmp_path_factory.mktemp("local")
    status, out, err = run(folder, "-o", results, "--workers", "2", "--json")
    assert status == 0, err
    document = json.loads(out)
    assert (document["done"], document["failed"], document["kept"]) == (4, 2, 0)
    return results


def documents(results: Path) -> dict[str, bytes]:
    """Everything a batch leaves, by its path."""
    return {
        p.relative_to(results).as_posix(): p.read_bytes()
        for p in results.rglob("*")
        if p.is_file() and p.name != ".lock"
    }


def rows(results: Path) -> dict[str, dict[str, str]]:
    with (results / "index.csv").open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        found = {row["recording"]: row for row in reader}
        assert tuple(reader.fieldnames or ()) == COLUMNS
    return found


@pytest.mark.campaign
def test_every_recording_has_its_row_and_the_documents_of_the_single_commands(
    folder: Path, local: Path
) -> None:
    found = rows(local)
    assert set(found) == {*GOOD, *BAD}
    for name in GOOD:
        recording = replace(invid.read_recording(folder / name), source=name)
        model = invid.identify(recording)
        diagnosis = invid.diagnose(recording, model=model)
        place = local / name.removesuffix(".h5")
        assert (place / "model.json").read_text() == dump_json(model_to_json(model))
        assert (place / "diagnosis.json").read_text() == dump_json(diagnosis_to_json(diagnosis))
        row = found[name]
        assert (row["status"], row["exit_status"], row["error"]) == ("done", "0", "")
        assert (row["verdict"], row["headline"]) == (str(diagnosis.verdict), diagnosis.headline)
    for name in BAD:
        assert (found[name]["status"], found[name]["exit_status"]) == ("failed", "2")
        assert found[name]["error"].startswith(name)


def test_a_second_run_does_only_what_is_not_there_as_it_would_be(
    folder: Path, local: Path, tmp_path: Path
) -> None:
    before = documents(local)
    for path, content in before.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(content)
    (tmp_path / "cell 1/week 01/model.json").write_text("{}")  # damaged
    (tmp_path / "cell 2/week 01/outcome.json").unlink()  # stopped before the end
    status, out, err = run(folder, "-o", tmp_path, "--json")
    assert status == 0, err
    assert json.loads(out)["kept"] == 4
    assert documents(tmp_path) == before
    # Another version, another question or another recording is none of it.
    store = Results(tmp_path, Options(masses=(2,)))
    assert store.kept(GOOD[0], "") is None


def children(pid: int) -> list[int]:
    path = Path(f"/proc/{pid}/task/{pid}/children")
    own = [int(x) for x in path.read_text().split()] if path.exists() else []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        own += [int(x) for x in task.read_text().split()]
    return sorted(set(own))


def first_done(process: subprocess.Popen[str]) -> str:
    """What stood on stderr up to the first good recording."""
    seen = ""
    while "consistent" not in seen:
        line = process.stderr.readline()  # type: ignore[union-attr]
        assert line, seen
        seen += line
    return seen


def test_a_worker_killed_under_way_loses_nothing(folder: Path, local: Path, tmp_path: Path) -> None:
    process = batch(folder, "-o", tmp_path, "--workers", "1")
    first_done(process)
    (helper,) = children(process.pid)
    os.kill(helper, signal.SIGKILL)
    _, err = process.communicate(timeout=500)
    assert process.returncode == 0, err
    assert documents(tmp_path) == documents(local)


def test_a_recording_whose_process_always_dies_is_listed_and_tried_again_next_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "python").write_text("#!/bin/sh\necho x >> " + str(tmp_path / "tries") + "\nkill -9 $$\n")
    (tmp_path / "python").chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    helper = Helper()
    outcome = analyse_apart(helper, tmp_path / "r.h5", "r.h5", Options())
    helper.close()
    assert (tmp_path / "tries").read_text() == "x\nx\n"
    assert (outcome.status, outcome.exit_status) == ("failed", "")
    assert "by SIGKILL" in outcome.error
    with Results(tmp_path / "results", Options()) as store:
        store.store(outcome, "sum")
        assert store.kept("r.h5", "sum") is None


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("nothing", "-o", "x"), "is no folder"),
        ((".", "-o", "x"), "no recording (.h5, .hdf5, .rows) lies below it"),
        (("{folder}", "-o", "/proc/x"), "cannot be written"),
        (("{folder}", "-o", "x", "--workers", "0"), "--workers"),
        (("{folder}", "-o", "x", "--masses", "two"), "--masses two"),
        (("{folder}", "-o", "x", "--scheduler", "tcp://127.0.0.1:1"), "no Dask scheduler answers"),
    ],
)
def test_bad_requests_end_with_one_message(
    arguments: tuple[str, ...],
    says: str,
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    if "--scheduler" in arguments:
        pytest.importorskip("distributed")
    status = app.run(["batch", *(a.format(folder=folder) for a in arguments)])
    err = capsys.readouterr().err
    assert status == 2, err
    assert says in err
    assert "Traceback" not in err


def test_two_batches_do_not_write_the_same_results(folder: Path, tmp_path: Path) -> None:
    with Results(tmp_path, Options()):
        status, _, err = run(folder, "-o", tmp_path)
    assert status == 2
    assert "another batch writes there" in err


Cluster = tuple[str, list[subprocess.Popen[bytes]]]


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """A scheduler's address; two workers on loopback and the scheduler, each a process group of its own."""
    pytest.importorskip("distributed")
    where = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    common = ["--scheduler-file", str(where), "--no-dashboard"]
    scheduler = subprocess.Popen(
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", *common], start_new_session=True, **quiet
    )
    workers = []
    try:
        deadline = time.monotonic() + 120
        while not where.exists() and time.monotonic() < deadline:
            time.sleep(0.2)
        for k in range(2):
            given = ["--nthreads", "1", "--host", "127.0.0.1", "--local-directory", str(tmp_path / f"w{k}")]
            workers.append(
                subprocess.Popen([*dask, "worker", *common, *given], start_new_session=True, **quiet)
            )
        address = json.loads(where.read_text())["address"]
        from distributed import Client

        with Client(address, timeout=60) as client:
            client.wait_for_workers(2, timeout=120)
        yield address, [*workers, scheduler]
    finally:
        for process in (*workers, scheduler):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@pytest.mark.campaign
def test_a_cluster_gives_the_same_bit_for_bit_and_a_worker_killed_under_way_loses_nothing(
    folder: Path, local: Path, tmp_path: Path, cluster: Cluster
) -> None:
    address, processes = cluster
    results = tmp_path / "results"
    process = batch(folder, "-o", results, "--scheduler", address)
    seen = first_done(process)
    os.killpg(processes[0].pid, signal.SIGKILL)
    out, err = process.communicate(timeout=500)
    assert process.returncode == 0, seen + out + err
    assert documents(results) == documents(local)
