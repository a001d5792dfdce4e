"""The share of the held-out torque that is missed on real machines: ours, strong peers', published.

One definition for all: every held-out sample, standing and reversing ones too, below the record's band; rms
over that of the torque. Without a part to validate the last experiment is kept out, of a single one the last
quarter; nobody is shown it, neither in a fit nor in a choice. Beside it the product's own figure, of what it
kept out itself.

    python -m benchmarks.diagnosis.bench_league [WORD …]     records whose title holds a word; all without
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.diagnosis.bench_real_data import DATA, ROOT
from benchmarks.diagnosis.peer_torque import missed, shares
from invid import import_recording
from invid.diagnosis.rigid import diagnose_trajectory
from invid.model.diagnosis_document import Diagnosis
from invid.numerics import budget
from invid.recording import Experiment, Recording, Role
from invid.rigid_motion.analysis import Analysis, analyse
from invid.rigid_motion.terms import torque_of
from invid.signals.motion_record import derivative, prepare_rows
from invid.signals.timebase import resample_uniformly

MAPS = (Path(__file__).with_name("maps"), ROOT / "configs" / "import")
LEAGUE: list[tuple[str, str, str, float, str]] = [
    ("ball screw, pulses", "emps", "emps", 50.0, "6.0"),
    ("double pendulum", "double_pendulum", "double_pendulum", 10.0, "11.9 of both"),
    ("large robot, axis 1", "kr300", "kr300", 10.0, ""),
    ("large robot, axis 1 of three trajectories", "kr300_abc", "kr300_axis_1", 10.0, ""),
    ("large robot, axis 4", "kr300_abc", "kr300_axis_4", 10.0, ""),
    ("large robot, axis 6", "kr300_abc", "kr300_axis_6", 10.0, ""),
    ("geared pendulum", "simple_pendulum", "simple_pendulum", 10.0, ""),
    ("AcroMonk, elbow", "acromonk", "acromonk", 10.0, ""),
    ("two servos, steps", "hsm150", "hsm150", 20.0, ""),
    ("Panda joint 7", "panda", "panda_joint_7", 10.0, ""),
    ("UR10e joint 1", "ur10e/joint_1.csv", "ur10e_joint_1", 10.0, ""),
    ("UR10e joint 2", "ur10e/joint_2.csv", "ur10e_joint_2", 10.0, ""),
    ("UR10e joint 3", "ur10e/joint_3.csv", "ur10e_joint_3", 10.0, ""),
    ("UR10e joint 4", "ur10e/joint_4.csv", "ur10e_joint_4", 10.0, ""),
    ("UR10e joint 5", "ur10e/joint_5.csv", "ur10e_joint_5", 10.0, ""),
    ("UR10e joint 6", "ur10e/joint_6.csv", "ur10e_joint_6", 10.0, ""),
    ("light arm, joint 1", "six_axis", "six_axis_joint_1", 10.0, ""),
    ("light arm, joint 4", "six_axis", "six_axis_joint_4", 10.0, ""),
    ("light arm, joint 6", "six_axis", "six_axis_joint_6", 10.0, ""),
    ("OpenArm joint 1", "openarm/joint_1.npz", "openarm_joint_1", 5.0, ""),
    ("OpenArm joint 3", "openarm/joint_3.npz", "openarm_joint_3", 5.0, ""),
    ("OpenArm joint 4", "openarm/joint_4.npz", "openarm_joint_4", 5.0, ""),
    ("OpenArm joint 6", "openarm/joint_6.npz", "openarm_joint_6", 5.0, ""),
    ("OpenArm joint 7", "openarm/joint_7.npz", "openarm_joint_7", 5.0, ""),
    ("TIAGo arm", "tiago", "tiago_arm", 10.0, ""),
    ("TX40 arm", "tx40", "tx40", 20.0, ""),
]
"""Title, source, map, band [Hz], published share [%] of kept-out torque; `league_data.sh` brings what
`invid fetch-data` does not."""
BUDGET = 60.0
"""Seconds of processor time: the command's own."""
LEVEL = 0.1
"""Relative difference of two figures up to which they are called level (a guess)."""
Parts = list[list[tuple[np.ndarray, np.ndarray, float]]]


def kept_out(recording: Recording) -> Recording:
    """The recording with a part to validate: its last experiment, of a single one the last quarter."""
    *first, last = recording.experiments
    if recording.with_role(Role.VALIDATE):
        return recording
    if first:
        return replace(recording, experiments=(*first, replace(last, role=Role.VALIDATE)))
    cut = 3 * last.samples // 4
    parts = [
        replace(
            last, key=f"{i:03d}", role=role, time=last.time[rows], position=last.position[rows],
            torque=last.torque[rows], torque_demand=None, status=None,
        )
        for i, (role, rows) in enumerate(
            [(Role.IDENTIFY, slice(0, cut)), (Role.VALIDATE, slice(cut, None))]
        )
    ]  # fmt: skip
    return replace(recording, experiments=tuple(parts))


def of_rigid_axes(a: Analysis, e: Experiment, axes: int) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Torque of each axis at every sample, what the terms say of it, and the step."""
    even = resample_uniformly(e)
    *motion, rate = (
        derivative(x, even.step, a.band.motion_hz, k)
        for x, k in (*((even.position, k) for k in range(3)), (even.torque, 1))
    )
    m = replace(
        prepare_rows(e, a.band), position=motion[0], velocity=motion[1], acceleration=motion[2],
        torque=even.torque, torque_rate=rate, reading=np.asarray(even.position),
    )  # fmt: skip
    told = torque_of(a.final.parts, m)
    return [(even.torque[:, i], told[:, i], even.step) for i in range(axes)]


def ours(recording: Recording) -> tuple[Diagnosis, Parts]:
    """The diagnosis (of large motion) of what peers are fitted to, and what it says of each axis' held-out
    parts."""
    held, axes = recording.with_role(Role.VALIDATE), recording.axis_count
    recording = replace(recording, experiments=recording.with_role(Role.IDENTIFY))
    with budget.use_budget(budget.Budget(BUDGET, time.process_time)), np.errstate(all="ignore"):
        a = analyse(recording)
        found = diagnose_trajectory(recording, analysis=a)
    parts = [of_rigid_axes(a, e, axes) for e in held]
    return found, [list(p) for p in zip(*parts, strict=True)]


def main(wanted: list[str]) -> int:
    """Print the league; the exit status is 1 where the product is behind a peer."""
    behind, names = 0, ("rigid", "+ ripple, memory", "FIR or ARX")
    heads = ["record", "axis", "ours", *names, "published", "", "own figure", "CPU s", "named"]
    print(f"Missed torque, kept out [%]\n\n| {' | '.join(heads)} |\n|{' --- |' * len(heads)}")
    for title, source, chart, below_hz, published in LEAGUE:
        if wanted and not any(w in title for w in wanted):
            continue
        if not (DATA / source).exists():
            print(f"| {title} | NOT RUN: {DATA / source} is not there |")
            continue
        map_file = next(m / f"{chart}.yaml" for m in MAPS if (m / f"{chart}.yaml").exists())
        recording = kept_out(import_recording(DATA / source, map_file))
        began = time.process_time()
        found, parts = ours(recording)
        spent = time.process_time() - began
        peers = shares(recording, below_hz)
        power = np.sqrt(
            np.mean(np.concatenate([e.torque for e in recording.with_role(Role.IDENTIFY)]) ** 2, axis=0)
        )
        for i, row in enumerate(found.residual):
            own, best = missed(parts[i], below_hz), min(peers[n][i] for n in names)
            stands = "level" if abs(own / best - 1.0) <= LEVEL else "ahead" if own < best else "BEHIND"
            behind += stands == "BEHIND"
            figures = " | ".join(f"{100 * x:.3g}" for x in (own, *(peers[n][i] for n in names)))
            said = ", ".join(f"{f.cause} {f.confidence:.2f}" for f in found.findings if f.axis == row.axis)
            print(
                f"| {title} | {row.axis} | {figures} | {published} | {stands} | "
                f"{100 * row.after / power[i]:.3g} | {spent:.0f} | {found.verdict}: {said} |",
                flush=True,
            )
    return int(behind > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
