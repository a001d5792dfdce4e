"""Whatever clock a log has: the motion it gives is the one that was, or a sentence that cures it.

The plant is simulated here, exactly over held torque; the stamps are then written as loggers write them.
"""

from __future__ import annotations

import json
import re
import struct
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from invid.cli.app import run
from invid.recording.clock import count_slots
from invid.recording.hdf5 import read_recording
from invid.recording.model import Experiment
from invid.signals.timebase import resample_uniformly

STEP = 1e-3
PERIOD = 2048
TRUTH = {"m1": 0.7, "m2": 2.0, "k": 1000.0, "c": 0.6, "d": 0.5}
COUNT = 2 * np.pi / 2**19


@cache
def motion(periods: int) -> tuple[np.ndarray, np.ndarray]:
    """Position [rad] and torque [N·m] of the motor, with the encoder's counts and the drive's steps."""
    m1, m2, k, c, d = TRUTH.values()
    a = np.array(
        [
            [0, 0, 1, 0],
            [0, 0, 0, 1],
            [-k / m1, k / m1, -(c + d) / m1, c / m1],
            [k / m2, -k / m2, c / m2, -(c + d) / m2],
        ]
    )
    b = np.array([[0.0], [0.0], [1 / m1], [0.0]])
    whole = expm(np.block([[a, b], [np.zeros((1, 5))]]) * STEP)
    rng = np.random.default_rng(7)
    lines = np.arange(1, 80)
    phase = rng.uniform(0, 2 * np.pi, lines.size)
    t = np.arange(PERIOD) / PERIOD
    wave = np.cos(2 * np.pi * lines[:, None] * t + phase[:, None]).sum(axis=0)
    torque = np.round(wave / 0.05) * 0.05
    state, position = np.zeros(5), np.zeros(periods * PERIOD)
    for n in range(periods * PERIOD):
        state[4] = torque[n % PERIOD]
        position[n] = state[0]
        state = whole @ state
    position = np.round((position + rng.normal(0, 0.3 * COUNT, position.size)) / COUNT) * COUNT
    # What is logged with a position is the torque's mean around it, as a drive's filter has it.
    logged = np.tile(torque, periods)
    return position, logged


@dataclass(frozen=True)
class Log:
    """A log's stamps, and which rows of the motion were not lost."""

    kind: str
    jitter: float
    loss: float
    gap: bool
    late: int
    seed: int
    bus: bool = False
    """A candump log in place of a table, for the kinds of stamps that one has."""


KINDS = {
    "seconds": "s", "2^32 µs": "us", "a minute": "s", "2^16 ms": "ms", "zone": "s", "no zone": "s", "half "
    "days": "s",
    "constant": "s", "two a tick": "s", "differences": "s",
}  # fmt: skip


FACTORS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


def stamps(log: Log, count: int) -> tuple[list[str], np.ndarray]:
    """Stamps as text, and the rows that they belong to."""
    rng = np.random.default_rng(log.seed)
    keep = rng.random(count) >= log.loss
    keep[0] = True
    if log.gap:
        keep[count // 2 : count // 2 + 90] = False
    rows = np.flatnonzero(keep)
    t = rows * STEP + rng.uniform(-log.jitter, log.jitter, rows.size) * STEP
    if log.late:
        t[rng.integers(5, rows.size - 5, log.late)] += 0.9 * STEP
    return written(log.kind, t), rows


def written(kind: str, t: np.ndarray) -> list[str]:
    start = datetime(2026, 2, 3, 12, 59, 59, tzinfo=timezone(timedelta(hours=1)))
    if kind == "seconds":
        return [f"{v:.6f}" for v in 5.0 + t]
    if kind == "2^32 µs":
        return [f"{v:.0f}" for v in np.mod(np.round(1e6 * t) + 2**32 - 900_000, 2**32)]
    if kind == "a minute":
        return [f"{v:.6f}" for v in np.mod(59.2 + t, 60.0)]
    if kind == "2^16 ms":
        return [f"{v:.3f}" for v in np.mod(65_000 + 1e3 * t, 2**16)]
    if kind in ("zone", "no zone", "half days"):
        form = {
            "zone": "%Y-%m-%dT%H:%M:%S.%f%z",
            "no zone": "%d.%m.%Y %H:%M:%S.%f",
            "half days": "%I:%M:%S.%f %p",
        }[kind]
        return [f"{start + timedelta(microseconds=round(1e6 * float(v))):{form}}" for v in t]
    if kind == "constant":
        return ["0.000"] * t.size
    if kind == "two a tick":
        return [f"{np.floor((v + 1e-9) / (2 * STEP)) * 2 * STEP:.3f}" for v in t]
    return [f"{v:.6f}" for v in np.diff(t, prepend=t[0] - STEP)]


def imported(folder: Path, log: Log, periods: int, capsys) -> tuple[Experiment, np.ndarray, str]:
    """The experiment, the rows of the motion that it was made of, and the sentence that was followed."""
    text, rows = stamps(log, periods * PERIOD)
    position, torque = motion(periods)
    name = "log.log" if log.bus else "log.csv"
    axis = {
        "name": "A1",
        "masses": 2,
        "position": {"column": "position", "unit": "rad"},
        "torque": {"column": "torque", "unit": "Nm", "meaning": "applied"},
    }
    if log.bus:
        text = [f"{float(s) * FACTORS[KINDS[log.kind]]:.6f}" for s in text]
        data = [
            struct.pack("<hi", round(torque[r] / 0.05), round(position[r] / COUNT)).hex().upper()
            for r in rows
        ]
        lines = [f"({s}) can0 181#{d}" for s, d in zip(text, data, strict=True)]
        axis["position"] |= {"unit": "counts", "per_count": COUNT}
        axis["torque"] |= {"unit": "permille"}
        axis["rated_torque"] = 50
    else:
        lines = [f"{s},{position[r]:.9f},{torque[r]:.4f}" for s, r in zip(text, rows, strict=True)]
        lines.insert(0, "stamp,position,torque")
    (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    entry = {"kind": "multisine", "excited_axis": 0, "period_samples": PERIOD}
    chart = {
        "format": "invid-import-map",
        "time": {"column": "stamp", "unit": KINDS[log.kind]},
        "axes": [axis],
    }
    if log.bus:
        signals = [{"name": "torque", "type": "int16"}, {"name": "position", "type": "int32"}]
        chart |= {"motion": "rotary", "time": {"column": "time"}}
        chart["source"] = {"sync_id": None, "pdos": [{"id": 0x181, "signals": signals}]}
    followed = ""
    for _ in range(2):
        (folder / "map.yaml").write_text(yaml.safe_dump({**chart, "experiments": [entry]}), encoding="utf-8")
        status = run(
            ["import", str(folder / name), "--map", str(folder / "map.yaml"), "-o", str(folder / "r.h5")]
        )
        said = capsys.readouterr().err
        if status == 0:
            return read_recording(folder / "r.h5").experiments[0], rows, followed
        followed = said
        rate, part = (
            re.search(r"sample_rate_hz: ([\d.]+|…)", said),
            re.search(r"rows: \[(\d+), (\d+)\]", said),
        )
        assert rate is not None, said
        if "differences: true" in said and log.kind == "differences":
            chart["time"] = {**chart["time"], "differences": True}
            continue
        # Who knows that his rows came every millisecond fills in the rate that nothing tells.
        chart["time"] = {"sample_rate_hz": 1 / STEP if rate[1] == "…" else float(rate[1])}
        if part is not None:
            entry["rows"] = [int(part[1]), int(part[2])]
            rows = rows[int(part[1]) : int(part[2])]
            if rows.size < PERIOD:
                entry.update(kind="other", period_samples=0)
    raise AssertionError(f"followed, the sentence did not read the file: {followed}")


def test_the_stamps_are_those_meant(tmp_path) -> None:
    """The strategies write what they say: an instant a row, wraps where they are named."""
    t = np.arange(1000) * STEP
    assert float(written("2^32 µs", t)[-1]) < float(written("2^32 µs", t)[0])
    assert written("half days", t + 1.5)[0].startswith("01:00:00.5")
    assert len(set(written("two a tick", t))) == 500


LOGS = st.builds(
    Log,
    kind=st.sampled_from(sorted(KINDS)),
    jitter=st.sampled_from([0.0, 0.05, 0.2, 0.35, 0.5]),
    loss=st.sampled_from([0.0, 0.002, 0.01]),
    gap=st.booleans(),
    late=st.sampled_from([0, 5]),
    seed=st.integers(0, 999),
)


@pytest.mark.campaign
@settings(
    max_examples=30, deadline=None, derandomize=True, phases=[Phase.explicit, Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)  # fmt: skip
@given(log=LOGS)
@example(log=Log("2^32 µs", 0.5, 0.01, True, 5, 1))
@example(log=Log("two a tick", 0.0, 0.0, True, 0, 2))
@example(log=Log("differences", 0.2, 0.0, True, 0, 3))
def test_the_motion_on_the_grid_is_the_one_that_was(tmp_path_factory, capsys, log: Log) -> None:
    if log.kind == "constant" and (log.loss or log.gap):
        return  # nothing in the file tells of rows that are missing
    periods = 2
    e, rows, _ = imported(tmp_path_factory.mktemp("clock"), log, periods, capsys)
    position, torque = motion(periods)
    found = resample_uniformly(e)
    assert found.step == pytest.approx(STEP, rel=1e-4)
    true = np.arange(rows[0], rows[-1] + 1)
    # Where a row was lost is known to a row or two, if the stamps jitter by half a step or tick once in two.
    coarse = log.jitter >= 0.35 or log.kind == "two a tick"
    assert abs(found.samples - true.size) <= (2 if coarse else 0)
    # The time of the first row means nothing: all may be one row late.
    misses = []
    for late in (-1, 0, 1):
        at = np.arange(found.samples) + true[0] + late
        inside = np.isin(at, rows)  # a gap is filled, not measured
        misses.append(
            [
                float(np.sqrt(np.mean((values[inside, 0] - truth[at[inside]]) ** 2)))
                for values, truth in ((found.position, position), (found.torque, torque))
            ]
        )
    best = min(misses, key=lambda m: m[0])
    for wrong, truth in zip(best, (position, torque), strict=True):
        row = float(np.sqrt(np.mean(np.diff(truth) ** 2)))
        # In rows, as if all were that far off: a twentieth; a quarter where losses lie in coarse stamps.
        assert wrong < row * (0.25 if coarse and (log.loss or log.gap) else 0.05), wrong / row


@pytest.mark.campaign
@pytest.mark.parametrize(("work", "seldom"), [(0.04, 0.0), (0.02, 0.25), (0.3, 0.1)])
def test_a_loop_that_sleeps_after_its_work_keeps_no_clock_and_misses_no_row(
    work: float, seldom: float
) -> None:
    rng = np.random.default_rng(4)
    turns = 1.0 + rng.exponential(work, 8000) + 1.4 * (rng.random(8000) < seldom)
    slots = count_slots(np.cumsum(turns) * 5e-3)
    assert not slots.even
    assert slots.lost == 0


@pytest.mark.parametrize(
    "log",
    [
        pytest.param(Log("2^32 µs", 0.5, 0.002, False, 5, 11), marks=pytest.mark.campaign),
        Log("differences", 0.2, 0.01, True, 0, 12),
        pytest.param(Log("two a tick", 0.0, 0.0, False, 0, 13), marks=pytest.mark.campaign),
    ],
    ids=lambda log: log.kind,
)
def test_the_model_is_the_clean_one_within_three_standard_deviations(tmp_path, capsys, log: Log) -> None:
    clean = model_of(tmp_path, Log("seconds", 0.0, 0.0, False, 0, 0), capsys)
    found = model_of(tmp_path, log, capsys)
    for name, truth in (("m1", TRUTH["m1"]), ("m2", TRUTH["m2"]), ("k", TRUTH["k"])):
        value, std = found[name]
        assert abs(value - truth) <= 3 * std, (name, value, std)
        assert std <= 10 * clean[name][1], (name, std, clean[name][1])


def model_of(
    folder: Path, log: Log, capsys, statuses: tuple[int, ...] = (0,)
) -> dict[str, tuple[float, float]]:
    """Masses and spring with their deviations; empty where they are said not to be trustworthy."""
    imported(folder, log, 6, capsys)
    status = run(["identify", str(folder / "r.h5"), "-o", str(folder / "m.json")])
    assert status in statuses, capsys.readouterr().err
    if status:
        return {}
    branch = json.loads((folder / "m.json").read_text(encoding="utf-8"))["branches"][0]
    values = {"m1": branch["masses"][0], "m2": branch["masses"][1], "k": branch["springs"][0]}
    return {n: (v["value"], v["std"]) for n, v in values.items()}
