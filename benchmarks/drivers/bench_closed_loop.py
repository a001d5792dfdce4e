"""The loop closed on simulated cells, from the values that drives come with to the measured loops: a table.

    python benchmarks/drivers/bench_closed_loop.py [--cells 20] [--first 0]

Every cell is drawn: inertias, resonance, damping, friction, encoder, noise, the drive's own gains. Cell 7
has an encoder so coarse that 1 % of ripple leaves no loop that holds (20 % are permitted), cell 11 free play,
and of cell 15 the load is taken off after its model was identified, so that the tuning stands on a wrong
model. Settling and following error are of one move there and back, made by the simulated drive in cyclic
synchronous position, foretold by the model, and told from what the verification measures.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

import invid
from invid.config import CellConfig
from invid.recording import read_recording
from invid.tuning.axis_loop import AxisLoop
from invid.tuning.feedforward import NONE
from invid.tuning.servo_loop import DriveTiming, Gains
from invid.tuning.simulated_loops import Command, LoopRun, move_figures, run_loops
from invid.tuning.verification import verify
from invid_drivers.measurement import measure_to_file
from invid_drivers.simulated.cell import SimulatedCell
from invid_drivers.simulated.kernel import POSITION_GAIN, VELOCITY_GAIN
from invid_drivers.values.closed_loop import closed_loop_config

COARSE, PLAY, WRONG = 7, 11, 15
CYCLE_S = 0.001
ENABLE_CYCLES = 400


def drawn_cell(number: int) -> CellConfig:
    """One axis of two masses, as ``number`` draws it."""
    rng = np.random.default_rng(1000 + number)
    motor = float(rng.uniform(0.3, 2.0))
    load = motor * float(rng.uniform(0.5, 3.0))
    resonance = 2 * math.pi * float(rng.uniform(8.0, 20.0))
    spring = resonance**2 * motor * load / (motor + load)
    rated = 20.0 * (motor + load)
    play = {"cause": "backlash", "axis": "A1", "parameters": {"gap": 1e-3}}
    counts = 8192 if number == COARSE else int(2 ** rng.integers(17, 21))
    return CellConfig.model_validate(
        {
            "format": "invid-config",
            "format_version": 1,
            "robot": f"cell {number}",
            "bus": {"interface": "invid-virtual", "channel": f"loop{number}", "cycle_s": CYCLE_S},
            "axes": [
                {
                    "name": "A1",
                    "node_id": 1,
                    "rated_torque_Nm": rated,
                    "masses": 2,
                    "inertia_kgm2": motor + load,
                    "gravity_loaded": False,
                    "limits": {
                        "torque_Nm": 0.5 * rated, "position_window_rad": 1.0, "velocity_rad_per_s": 5,
                        "stopping_room_rad": 3,
                    },
                }
            ],
            "experiments": [
                {"kind": "multisine", "band_Hz": [0.5, 30], "period_s": 2.048, "periods": 3},
                {"kind": "multisine", "role": "validate", "band_Hz": [0.5, 30], "period_s": 2.048,
                 "periods": 2, "amplitude": 0.5},
            ],
            "simulation": {
                "seed": number,
                "plant": {
                    "branches": [{
                        "axis": "A1", "masses": [motor, load], "springs": [spring],
                        "dampers": [2 * float(rng.uniform(0.005, 0.03)) * math.sqrt(spring * motor * load
                                                                                     / (motor + load))],
                    }]
                },
                "defaults": {
                    "loop_cycle_s": CYCLE_S,
                    "encoder_counts": counts,
                    "position_loop_Hz": float(rng.uniform(6.0, 25.0)),
                    "torque_noise": float(rng.uniform(0.001, 0.004)),
                    "friction": {"coulomb_Nm": rated * float(rng.uniform(0.001, 0.006)),
                                 "viscous_Nms_per_rad": float(rng.uniform(0.0, 0.3))},
                },
                "effects": [play] if number == PLAY else [],
            },
        }
    )  # fmt: skip


def without_load(config: CellConfig) -> CellConfig:
    """The same cell after most of its load was taken off."""
    simulation = config.simulation or {}
    (branch,) = simulation["plant"]["branches"]
    motor, load = branch["masses"]
    plant = {**simulation["plant"], "branches": [{**branch, "masses": [motor, 0.1 * load]}]}
    return config.model_copy(update={"simulation": {**simulation, "plant": plant}})


def present(config: CellConfig) -> AxisLoop:
    """The loops that the drive comes with."""
    row = SimulatedCell(config).plant.command[0]
    return AxisLoop(Gains(float(row[VELOCITY_GAIN]), math.inf, float(row[POSITION_GAIN])))


def with_loops(config: CellConfig, loop: AxisLoop) -> CellConfig:
    """The same cell with these values in its drive."""
    simulation = config.simulation or {}
    forward = {name: getattr(loop.feedforward, name) for name in ("inertia", "viscous")}
    defaults = {**simulation["defaults"], "loops": asdict(loop.gains) | forward}
    return config.model_copy(update={"simulation": {**simulation, "defaults": defaults}})


def as_driven(loop: AxisLoop) -> AxisLoop:
    """What the drive runs of it."""
    own = loop.feedforward
    return AxisLoop(loop.gains, replace(NONE, inertia=own.inertia, viscous=own.viscous))


def driven_move(config: CellConfig, command: Command) -> LoopRun:
    """The move made by the simulated drive itself, which gets a target a cycle and interpolates it."""
    cell = SimulatedCell(config)
    (drive,) = cell.drives
    od, motors = drive.node.od, cell.plant.structure.motors
    ends = int(motors[0]) + cell.plant.structure.chains.masses_per_branch[0] - 1
    od.entry(0x6060).value = 8
    rows = []
    for k in range(ENABLE_CYCLES + len(command.position)):
        now = (k + 1) * 1_000_000
        od.entry(0x6040).value = (6, 7, 15)[min(k // 2, 2)]
        target = float(command.position[k - ENABLE_CYCLES, 0]) if k >= ENABLE_CYCLES else 0.0
        od.entry(0x607A).value = round(drive.direction * target * drive.counts_per_unit)
        cell._observe(now)
        drive.synchronous = True
        drive.tick(now)
        if k >= ENABLE_CYCLES:
            rows.append((cell.plant.positions[motors[0]], cell.plant.positions[ends]))
    motor, load = np.array(rows).T[:, :, None]
    late = np.vstack([command.position[:1], command.position[:-1]])  # interpolated: there a cycle later
    return LoopRun(np.arange(len(rows)) * CYCLE_S, late, motor, load, np.zeros_like(motor))


def closed(number: int, folder: Path) -> list[str]:
    """The whole way of one cell, as cells of the table."""
    began = time.process_time()
    config = drawn_cell(number)
    measure_to_file(config, folder / "open.h5")
    recording = read_recording(folder / "open.h5")
    model = invid.identify(recording)
    source = invid.diagnose(recording, model=model, budget=60) if number == PLAY else model
    ripple = 0.2 if number == COARSE else 0.01
    tuned = invid.tune(source, before={"A1": present(config)}, draws=100, ripple=ripple)
    (axis,) = tuned.axes
    loops = {"A1": as_driven(axis.after)}
    now = without_load(config) if number == WRONG else config
    was = move_figures(driven_move(now, tuned.command), tuned.command)[0]
    now = with_loops(now, loops["A1"])
    now_is = move_figures(driven_move(now, tuned.command), tuned.command)[0]
    measure_to_file(closed_loop_config(now), folder / "closed.h5")
    found = verify(
        tuned.model, {"A1": axis.after}, DriveTiming(CYCLE_S), read_recording(folder / "closed.h5")
    )
    counts = np.array([2 * math.pi / (config.simulation or {})["defaults"]["encoder_counts"]])
    foretold = move_figures(
        run_loops(tuned.model, [loops["A1"]], tuned.command, tuned.settings.timing, counts), tuned.command
    )[0]
    (seen,) = found.axes
    share = [
        100.0 * x / seen.rated
        for x in (axis.before.margins.ripple, seen.ripple.predicted, seen.ripple.measured)
    ]

    def ms(value: float) -> str:
        return "–" if not math.isfinite(value) else f"{1e3 * value:.0f}"

    note = {COARSE: "coarse encoder", PLAY: "free play", WRONG: "wrong model"}.get(number, "")
    return [
        str(number), note,
        f"{ms(was.settling)} → {ms(now_is.settling)} ({ms(foretold.settling)})",
        f"{1e3 * was.following:.2f} → {1e3 * now_is.following:.2f} "
        f"({1e3 * foretold.following:.2f}; verified {1e3 * seen.following.measured:.2f})",
        f"{axis.before.margins.sensitivity:.2f} → {seen.sensitivity.measured:.2f} ± "
        f"{seen.sensitivity.std:.2f} ({seen.sensitivity.low:.2f} … {seen.sensitivity.high:.2f})",
        f"{seen.phase_margin.measured:.0f} ({seen.phase_margin.predicted:.0f})",
        f"{share[0]:.2f} → {share[2]:.2f} ({share[1]:.2f})",
        str(found.verdict),
        f"{time.process_time() - began:.0f}",
    ]  # fmt: skip


HEAD = (
    "cell", "", "settling [ms] before → after (foretold)",
    "following error rms [mrad] (foretold; as verified)",
    "peak of sensitivity", "phase margin [°]", "torque ripple [% of rated]", "verification", "cpu [s]",
)  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    asked = parser.parse_args()
    print("| " + " | ".join(HEAD) + " |\n|" + " --- |" * len(HEAD))
    for number in range(asked.first, asked.first + asked.cells):
        with tempfile.TemporaryDirectory() as folder:
            try:
                print("| " + " | ".join(closed(number, Path(folder))) + " |", flush=True)
            except invid.InvidError as error:
                print(f"| {number} | {type(error).__name__}: {error} |" + " |" * 7, flush=True)


if __name__ == "__main__":
    main()
