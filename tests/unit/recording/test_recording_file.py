"""The HDF5 recording: written while measuring, killed, damaged, written by others."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from invid.cli.app import run
from invid.errors import RecordingError
from invid.recording import (
    Kind,
    Outcome,
    Recording,
    RecordingWriter,
    read_recording,
    write_recording,
)
from invid.recording.spool import Spool


def foreign(path: Path, *, n: int = 50, axes: int = 2) -> Path:
    """A file with the required attributes alone, written as another program would."""
    with h5py.File(path, "w") as f:
        f.attrs["format"] = np.bytes_("invid-recording")
        f.attrs["format_version"] = np.int32(1)
        f.attrs["created"] = "2026-01-31T12:00:00Z"
        f.attrs["robot"] = "other"
        f.attrs["axes"] = np.array([f"A{i + 1}" for i in range(axes)], dtype=h5py.string_dtype())
        f.attrs["position_unit"] = "rad"
        f.attrs["torque_unit"] = "N·m"
        f.create_group("someone/else")
        e = f.create_group("experiments/000")
        e.attrs["kind"], e.attrs["role"] = "other", "identify"
        e.attrs["excited_axis"], e.attrs["period_samples"] = np.int64(-1), np.uint8(0)
        e.attrs["hold_gain"] = np.array([[0.0, np.nan][:axes]])
        e.attrs["frequencies_hz"] = h5py.Empty("f8")
        e.attrs["sample_rate_hz"] = np.float32(100.0)
        e["time"] = np.arange(n) / 100.0
        e["position"] = np.random.default_rng(1).standard_normal((n, axes)).astype(np.float32)
        e["torque"] = np.arange(n * axes, dtype=np.int16).reshape(n, axes)
    return path


def test_a_file_by_another_writer_with_only_the_required_attributes_is_read(tmp_path):
    recording = read_recording(foreign(tmp_path / "r.h5"))
    assert recording.axes == ("A1", "A2")
    assert recording.experiments[0].torque[3, 1] == 7.0
    assert np.isnan(recording.experiments[0].hold_gain[1])
    write_recording(recording, tmp_path / "again.h5")
    again = read_recording(tmp_path / "again.h5")
    assert np.array_equal(again.experiments[0].position, recording.experiments[0].position)


def _nan(e):
    e["position"][7, 1] = np.nan


def _backwards(e):
    e["time"][9] = e["time"][3]


def _no_torque(e):
    del e["torque"]


def _transposed(e):
    values = e["torque"][()].T
    del e["torque"]
    e["torque"] = values


def _link(e):
    del e["torque"]
    e["torque"] = h5py.ExternalLink("/etc/passwd", "/x")


def _bomb(e):
    del e["time"]
    e.create_dataset("time", shape=(10**12,), dtype="f8", chunks=(1024,), compression="gzip")


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (_nan, "'position' of axis A2 is nan at sample 7"),
        (_backwards, "'time' runs backwards at sample 9"),
        (_no_torque, "dataset 'torque' is missing"),
        (_transposed, "transposed"),
        (_link, "link into another file"),
        (_bomb, "more numbers than"),
        (lambda e: e.attrs.__setitem__("period_samples", -3), "'period_samples' is -3"),
        (lambda e: e.attrs.__setitem__("excited_axis", 2), "'excited_axis' is 2"),
        (lambda e: e.attrs.__delitem__("role"), "'role' is missing"),
        (lambda e: e.attrs.__setitem__("kind", "dance"), "'kind' is 'dance'"),
        (lambda e: e.file.attrs.__setitem__("format_version", 7), "'format_version' is 7"),
    ],
)
def test_a_violation_is_one_sentence_that_says_what_and_where(tmp_path, spoil, said):
    path = foreign(tmp_path / "r.h5")
    with h5py.File(path, "r+") as f:
        spoil(f["experiments/000"])
    with pytest.raises(RecordingError, match=said) as caught:
        read_recording(path)
    assert "\n" not in str(caught.value)


def test_flipped_bytes_and_cut_files_raise_nothing_but_recording_errors(tmp_path):
    whole = foreign(tmp_path / "r.h5").read_bytes()
    rng = np.random.default_rng(3)
    refused = 0
    for trial in range(300):
        raw = bytearray(whole)
        for _ in range(int(rng.integers(1, 6))):
            raw[int(rng.integers(raw.__len__()))] = int(rng.integers(256))
        data = bytes(raw) if trial % 3 else bytes(raw[: int(rng.integers(len(raw)))])
        path = tmp_path / f"f{trial}.h5"
        path.write_bytes(data)
        try:
            read_recording(path)
        except RecordingError:
            refused += 1
    assert refused > 90


_WRITER = """
import sys, time, numpy as np
from invid.recording import Kind, Recording, RecordingWriter
head = Recording(robot="r", axes=("A1",), position_unit="rad", torque_unit="N·m",
                 created="2026-01-01T00:00:00Z", experiments=())
with RecordingWriter(sys.argv[1], head) as w:
    w.begin(kind=Kind.OTHER, excited_axis=0, sample_rate_hz=1000.0, demand=False, status=False)
    start, k = time.monotonic(), 0
    while True:
        now = time.monotonic() - start
        while k < now * 1000:
            w.append(k / 1000, [float(k)], [1.0])
            k += 1
        print(k, flush=True)
        time.sleep(0.005)
"""


def test_a_measurement_killed_in_the_middle_loses_at_most_the_last_second(tmp_path):
    path = tmp_path / "r.h5"
    process = subprocess.Popen(
        [sys.executable, "-c", _WRITER, str(path)], stdout=subprocess.PIPE, text=True, env=os.environ
    )
    assert process.stdout is not None
    written, end = 0, time.monotonic() + 60
    while written < 3400 and time.monotonic() < end:
        written = int(process.stdout.readline())
    process.send_signal(signal.SIGKILL)
    process.wait()
    with pytest.raises(RecordingError, match=r"what it measured so far is in .*r\.h5\.rows"):
        read_recording(path)
    assert run(["import", str(tmp_path / "r.h5.rows"), "-o", str(path)]) == 0
    recording = read_recording(path)
    assert recording.outcome is Outcome.FAILED
    kept = recording.experiments[0].samples
    assert written >= 3400
    assert kept >= written - 1000  # it may have gone on between its last word and its end
    assert np.array_equal(recording.experiments[0].position[:, 0], np.arange(kept))


_FULL = """
import resource, sys, numpy as np
from invid.errors import RecordingError
from invid.recording import Kind, Outcome, Recording, RecordingWriter
head = Recording(robot="r", axes=("A1",), position_unit="rad", torque_unit="N·m",
                 created="2026-01-01T00:00:00Z", experiments=())
w = RecordingWriter(sys.argv[1], head)
w.begin(kind=Kind.OTHER, excited_axis=0, sample_rate_hz=1000.0, demand=False, status=False)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000,) * 2)
noise = np.random.default_rng(1).standard_normal((10000, 1)).round(int(sys.argv[2]))
try:
    for k in range(0, 10000, 100):
        w.append(np.arange(k, k + 100) / 1000, noise[k : k + 100], noise[k : k + 100])
except RecordingError as error:
    print(error)
if sys.argv[3] == "1":
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 100_000))
try:
    w.close(Outcome.FAILED)
except RecordingError as error:
    print(error)
"""


@pytest.mark.parametrize(("worse", "where"), [("1", "r.h5.rows"), ("0", "r.h5")])
def test_a_disk_that_takes_no_more_ends_the_writing_in_order_and_what_it_took_is_readable(
    tmp_path, worse, where
):
    """The kernel refuses any file beyond a limit; where it is lower still at the end, the rows remain."""
    path = tmp_path / "r.h5"
    process = subprocess.run(
        [sys.executable, "-c", _FULL, str(path), "3", worse], capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr  # no segmentation fault at the end
    assert "cannot be written: File too large; the recording so far is kept" in process.stdout
    recording = read_recording(tmp_path / where)
    kept = recording.experiments[0].samples
    assert 75_000 < 24 * kept < 100_000
    assert path.exists() is (where == "r.h5")
    assert ("what was measured is in" in process.stdout) is (where != "r.h5")
    if where == "r.h5":
        assert recording.outcome is Outcome.FAILED


_WHOLE = """
import resource, sys, numpy as np
from invid.errors import RecordingError
from invid.recording import read_recording, write_recording
recording = read_recording(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
try:
    write_recording(recording, sys.argv[1])
except RecordingError as error:
    print(error)
"""


def test_a_disk_that_does_not_take_a_recording_ends_in_one_sentence_and_leaves_the_old_file(tmp_path):
    """libhdf5 on such a disk took the process with it (segmentation fault)."""
    path = tmp_path / "r.h5"
    noise = np.random.default_rng(1).standard_normal((20000, 1))
    header = Recording(robot="r", axes=("A1",), position_unit="rad", torque_unit="N·m",
        created="2026-01-01T00:00:00Z", experiments=())  # fmt: skip
    with RecordingWriter(path, header) as writer:
        for _ in range(2):
            writer.begin(
                kind=Kind.OTHER, excited_axis=0, sample_rate_hz=1000.0, demand=False, status=False
            )  # fmt: skip
            writer.append(np.arange(20000) / 1000, noise, noise)
    before = path.read_bytes()
    for limit in (50, len(before) // 2):
        process = subprocess.run(
            [sys.executable, "-c", _WHOLE, str(path), str(limit)], capture_output=True, text=True, check=False
        )
        assert (process.returncode, process.stderr) == (0, "")
        assert process.stdout == f"{path}: cannot be written: File too large\n"
        assert path.read_bytes() == before
        assert list(tmp_path.iterdir()) == [path]


def test_rows_cut_anywhere_are_read_up_to_the_cut_and_never_raise_anything_else(tmp_path):
    spool = Spool(tmp_path / "r.h5", {"format": "invid-recording", "format_version": 1,
        "created": "2026-01-01", "robot": "r", "axes": '["A1"]',
        "position_unit": "rad", "torque_unit": "N·m"})  # fmt: skip
    attributes = {"kind": "other", "role": "identify", "excited_axis": 0, "period_samples": 0,
        "hold_gain": np.zeros(1), "frequencies_hz": np.zeros(0), "sample_rate_hz": 100.0}  # fmt: skip
    spool.begin("000", ["time", "position", "torque"], attributes)
    ends = []
    for k in range(5):
        spool.rows([np.arange(10 * k, 10 * k + 10) / 100, np.ones((10, 1)), np.ones((10, 1))])
        ends.append(spool.size)
    spool.close()
    whole = spool.path.read_bytes()
    rng = np.random.default_rng(2)
    path = tmp_path / "cut.rows"
    for cut in rng.integers(0, len(whole), 60):
        path.write_bytes(whole[:cut])
        frames = sum(cut >= end for end in ends)
        if frames:
            assert read_recording(path).experiments[0].samples == 10 * frames
        else:
            with pytest.raises(RecordingError):
                read_recording(path)
    for _ in range(60):
        raw = bytearray(whole)
        raw[int(rng.integers(len(raw)))] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(raw))
        with contextlib.suppress(RecordingError):
            read_recording(path)


def test_a_power_cut_costs_six_seconds_of_rows_and_no_experiment_that_has_ended(tmp_path, monkeypatch):
    """What the disk was asked to keep for good is all that is sure to be there afterwards."""
    sure = [0]

    def keep(handle):
        sure[0] = os.fstat(handle).st_size

    monkeypatch.setattr(os, "fdatasync", keep)
    head = Recording(robot="r", axes=("A1",), position_unit="rad", torque_unit="N·m",
                     created="2026-01-01T00:00:00Z", experiments=())  # fmt: skip
    rows, cut = tmp_path / "r.h5.rows", tmp_path / "cut.rows"
    writer = RecordingWriter(tmp_path / "r.h5", head)
    for k in range(2):
        writer.begin(kind=Kind.OTHER, excited_axis=0, sample_rate_hz=100.0, demand=False, status=False)
        for n in range(0, 1700, 25):  # a quarter of a second at once, as the recorder
            writer.append(20.0 * k + np.arange(n, n + 25) / 100, np.ones((25, 1)), np.ones((25, 1)))
            cut.write_bytes(rows.read_bytes()[: sure[0]])
            kept = read_recording(cut).experiments[k].samples if n >= 600 else 0
            assert n + 25 - kept <= 600
        writer.end()
        cut.write_bytes(rows.read_bytes()[: sure[0]])
        assert [e.samples for e in read_recording(cut).experiments] == [1700] * (k + 1)
