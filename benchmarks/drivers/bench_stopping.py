"""Stated against true way to rest: after a stop by the watch, and after the master has died.

    python benchmarks/drivers/bench_stopping.py [--draws 200] [--seed 0]

Each draw is one axis (a motor, a spring and a load's mass) on the simulated bus: its speed limit, inertia,
torque limit, load in the direction of motion, friction (1 to 5 % of its torque limit), resonance (6 to 20
Hz), ramp (0x6085), the torque that goes on, heartbeat, and how late the computer is (up to what is forgiven)
are drawn. What `check` states is taken from the product; the true way is the plant's, from where the motor
first passes its speed limit to the furthest point that it reaches. Limits of the drives are off in torque
mode. A quarter of the drives counts its ramp in rpm/s, two fifths watch for missing RPDOs (0x1400:5). The
exit status is 1 where a stated way was exceeded, or where half of them are more than twice the true.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import yaml

from invid.config import CellConfig, parse_config
from invid.errors import DriveError, SafetyStop
from invid.planning.stopping_distance import FEEDBACK_FACTOR, SPEED_TOLERANCE, StoppingBudget, budgets_of
from invid.sweep.bounds import AxisLimits, Bounds
from invid.sweep.ports import Mode, Want, Wish
from invid.sweep.watch import Watch
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.stated.vendors import VENDORS, YES
from invid_drivers.simulated import VirtualTimeBus, open_virtual_bus

TIMER = "a drive whose manual says that 0x1400:5 acts"
VENDORS[TIMER] = replace(VENDORS["generic"], rpdo_event_timer=YES)
WAYS = ("stop", "dead master")
COUNTS = 524288
OVERRUN = 20
"""SYNC slots that a late computer may skip: ``safety.overrun_cycles`` as it is by default."""
FAR = 1000.0
"""No window: the way beyond it is what is measured."""


@dataclass(frozen=True)
class Draw:
    """One axis."""

    speed: float
    inertia: float
    torque: float
    load: float
    ramp: float
    planned: float
    heartbeat_s: float
    cycle_s: float
    in_rpm: bool
    timer: bool
    late_cycles: int
    friction: float
    resonance_hz: float


def draw(rng: np.random.Generator) -> Draw:
    """Logarithmic in everything that has a scale."""
    inertia = float(np.exp(rng.uniform(np.log(0.2), np.log(20))))
    torque = inertia * float(np.exp(rng.uniform(np.log(3), np.log(40))))
    return Draw(
        speed=float(np.exp(rng.uniform(np.log(0.3), np.log(5)))),
        inertia=inertia,
        torque=torque,
        load=torque * float(rng.choice([0.0, rng.uniform(0.05, 0.5)])),
        ramp=float(np.exp(rng.uniform(np.log(1), np.log(60)))),
        planned=torque * float(rng.uniform(0.05, 0.4)),
        heartbeat_s=float(rng.choice([0.01, 0.03, 0.1])),
        cycle_s=float(rng.choice([0.001, 0.002, 0.004])),
        in_rpm=(other := float(rng.random())) < 0.25,
        timer=other > 0.6,
        late_cycles=int(rng.integers(0, OVERRUN + 1)),
        friction=torque * float(rng.uniform(0.01, 0.05)),
        resonance_hz=float(rng.uniform(6, 20)),
    )


def cell_config(d: Draw, seed: int) -> CellConfig:
    """The axis on the virtual bus."""
    omega = 2 * np.pi * d.resonance_hz
    spring = 0.24 * d.inertia * omega**2
    axis: dict[str, Any] = {
        "name": "A1", "node_id": 1, "rated_torque_Nm": d.torque, "inertia_kgm2": d.inertia,
        "gravity_loaded": d.load > 0,
        "limits": {
            "torque_Nm": d.torque, "position_window_rad": FAR, "velocity_rad_per_s": d.speed,
            "stopping_room_rad": FAR,
        },
    }  # fmt: skip
    drive: dict[str, Any] = {
        "rated_torque_Nm": d.torque, "encoder_counts_per_rev": COUNTS, "brake": False,
        "limits_in_torque_mode": False, "quick_stop_deceleration_rad_per_s2": d.ramp,
        "friction": {"coulomb_Nm": d.friction},
        "load": {"torque_Nm": -d.load, "element": "last mass"},
        "objects": {"values": {"0x6072": 1000}},
    }  # fmt: skip
    if d.timer:
        axis["vendor"] = TIMER
    if d.in_rpm:
        axis |= {"vendor": "epos4", "position_rad_per_count": 2 * np.pi / COUNTS}
        drive |= {"ramp_unit": "rpm_per_s"}
        drive["objects"] = {"profile": "epos4", "values": {"0x3001:1": 3000, "0x3001:2": 3000}}
    data = {
        "format": "invid-config", "robot": "one axis",
        "bus": {"interface": "invid-virtual", "channel": "stopping", "cycle_s": d.cycle_s},
        "axes": [axis],
        "safety": {"heartbeat_s": d.heartbeat_s},
        "simulation": {
            "seed": seed,
            "plant": {
                "branches": [
                    {"axis": "A1", "masses": [0.6 * d.inertia, 0.4 * d.inertia], "springs": [spring],
                     "dampers": [0.02 * 0.24 * d.inertia * omega]}
                ]
            },
            "axes": {"A1": drive},
        },
    }  # fmt: skip
    return parse_config(yaml.safe_dump(data))


class Run:
    """One axis brought to its speed limit with the load; where the motor is, past bus and encoder."""

    def __init__(self, config: CellConfig, d: Draw) -> None:
        port = open_virtual_bus(config)
        if not isinstance(port, VirtualTimeBus):
            raise TypeError("the bus is not virtual")
        self.sim = port.wire.cell
        if not d.timer:
            self.sim.drives[0].node.od.remove_entry(0x1400, 5)
        self.master = Cia402Cell(port, config)
        self.config, self.draw = config, d

    @property
    def _motor(self) -> tuple[float, float]:
        plant = self.sim.plant
        plant.advance_to(self.sim.now_ns)
        i = plant.structure.motors[0]
        return float(plant.state[i]), float(plant.state[i + plant.state.size // 2])

    def budget(self) -> StoppingBudget:
        """What is stated; the load is known, as after settling."""
        (report,) = self.master.check()
        d = self.draw
        (found,) = budgets_of(self.config, [report.stopping], [d.planned], [d.inertia], [d.load])
        return found

    def way(self, how: str) -> float:
        """From where the motor passes its speed limit to the furthest point."""
        d, cycle = self.draw, self.config.bus.cycle_s
        master, clock = self.master, self.master.clock
        master.run(master.energise([Mode.TORQUE]))
        limits = AxisLimits("A1", d.torque, FAR, d.speed, 2 * np.pi / COUNTS, d.torque, "rad", "N·m")
        bounds = Bounds([limits], cycle_s=cycle, missed_tpdos=5, overrun_cycles=OVERRUN)
        watch = Watch(bounds, cycle_s=cycle)
        bounds.start([self._motor[0]])
        since, late = None, False
        while True:
            try:
                sample = master.tick(Wish([Want.LEAD], [FEEDBACK_FACTOR * d.planned - d.load + d.friction]))
            except (SafetyStop, DriveError):  # a drive may have stopped by itself where the computer was late
                since = self._motor[0] if since is None else since
                break
            position, velocity = self._motor
            if since is None and velocity >= SPEED_TOLERANCE * d.speed:
                since = position
            if since is not None and how == "dead master":
                break
            if since is not None and not late:
                late = True
                clock.sleep_until(clock.now() + d.late_cycles * cycle)
            try:
                watch.check(sample)
            except (SafetyStop, DriveError):  # a drive may have stopped by itself where the computer was late
                since = position if since is None else since
                break
        furthest = self._motor[0]
        if how == "stop":
            supervisor = master._supervised
            tick = supervisor.tick

            def seen(wants: Any) -> Any:
                nonlocal furthest
                result = tick(wants)
                furthest = max(furthest, self._motor[0])
                return result

            supervisor.tick = seen  # type: ignore[method-assign]
            master.stop()
        rest = d.heartbeat_s * 3 + (d.speed + d.planned / d.inertia * 0.3) / min(
            d.ramp, 0.5 * d.torque / d.inertia
        )
        end = clock.now() + rest + 0.3
        while clock.now() < end:
            clock.sleep_until(clock.now() + cycle)
            position, velocity = self._motor
            furthest = max(furthest, position)
            if velocity <= 0 and clock.now() > end - rest:
                break
        return furthest - (since if since is not None else furthest)


def main() -> int:
    """Print the table; 1 where the bar was missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    arguments, _ = parser.parse_known_args()
    ratios: dict[str, list[float]] = {how: [] for how in WAYS}
    for n in range(arguments.draws):
        d = draw(np.random.default_rng([arguments.seed, n]))
        for how in WAYS:
            run = Run(cell_config(d, n), d)
            budget = run.budget()
            stated, true = (budget.stop if how == "stop" else budget.dead_master) or 0.0, run.way(how)
            run.master.close()
            ratios[how].append(stated / true)
            if stated < true:
                print(f"exceeded ({how}): stated {stated:.4g}, true {true:.4g}: {d}", flush=True)
    print("| way to rest | draws | stated over true: least | median | largest |\n|" + " --- |" * 5)
    for how, each in ratios.items():
        print(f"| {how} | {len(each)} | {min(each):.2f} | {np.median(each):.2f} | {max(each):.2f} |")
    return int(any(min(each) < 1 or np.median(each) > 2 for each in ratios.values()))


if __name__ == "__main__":
    sys.exit(main())
