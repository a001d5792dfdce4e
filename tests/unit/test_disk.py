"""A full disk: the message names the file, the room left and the way out; what was there stays."""

import errno
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from invid.cli.app import run
from invid.config import load_config
from invid.disk import not_written
from invid.errors import DiskFullError, InputError
from invid.model.document import save_text
from invid_drivers.measurement import measure_to_file
from invid_drivers.simulated import CASE_STUDY
from invid_service.jobs.worker import error_info


def test_a_result_on_a_full_disk_leaves_the_old_one_and_says_room_and_way_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = tmp_path / "model.json"
    save_text(model, "old")

    def half(self: Path, content: bytes) -> int:
        with self.open("wb") as file:
            file.write(content[:1])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", half)
    with pytest.raises(DiskFullError) as caught:
        save_text(model, "new")
    said = str(caught.value)
    free = shutil.disk_usage(tmp_path).free / 2**20
    assert said.startswith(f"{model}: cannot be written: No space left on device, ")
    assert float(said.split(", ")[1].split(" MiB")[0]) == pytest.approx(free, rel=0.2)
    assert said.endswith("make room there, or write to another disk")
    assert [p.name for p in tmp_path.iterdir()] == ["model.json"]
    assert model.read_text() == "old"


def test_a_command_that_meets_a_full_disk_says_so_and_is_no_internal_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "run.h5")

    monkeypatch.setattr("invid.cli.compare.load_model", full)
    assert run(["compare", "a.json", "b.json"]) == 2
    assert "run.h5: cannot be written: No space left" in capsys.readouterr().err


def test_another_reason_is_not_called_a_full_disk(tmp_path: Path) -> None:
    error = not_written(tmp_path / "m.json", PermissionError(errno.EACCES, "Permission denied"))
    assert type(error) is InputError
    assert "free" not in str(error)


def test_a_measurement_that_the_disk_does_not_hold_is_refused_before_anything_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "invid.recording.writer.shutil.disk_usage", lambda _: SimpleNamespace(free=10 << 20)
    )  # fmt: skip
    told: list[Any] = []
    with pytest.raises(
        DiskFullError, match=r"rec\.h5: .* may need \d+ MiB, 10\.0 MiB are free.*nothing moved"
    ):
        measure_to_file(load_config(CASE_STUDY), tmp_path / "rec.h5", progress=told.append)
    assert told == []


def test_the_service_tells_a_full_disk_apart_from_a_bad_recording() -> None:
    raw = OSError(errno.ENOSPC, "No space left on device")
    for error in (not_written(Path("/data/work/1/recording.h5"), raw), raw):
        told = error_info(error)
        assert told.code == "disk-full"
        assert "MiB are free" in told.text
        assert "make room" in told.fix
        assert "check the file" not in told.fix
