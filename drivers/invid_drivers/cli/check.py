"""``invid check``: preflight; moves nothing."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import typer

from invid.cli.output import EXIT_OK, emit
from invid.config import CellConfig, load_config
from invid.plan import make_plan
from invid.sweep.holds import master_hold
from invid_drivers.cli.measure import plan_text
from invid_drivers.connect import connect, is_virtual

PROBE_S = 0.3
PHASE_RAD = 0.05


def preflight(config: CellConfig) -> dict[str, Any]:
    """Config, holds, plan, bus budget, every drive's capabilities and safety objects.

    Raises
    ------
    ConfigError, DriveError, BusError
        The first thing that would keep a measurement from starting.
    """
    for axis in config.axes:
        master_hold(axis, config.bus.cycle_s)
    plan = make_plan(config)
    cell = connect(config)
    try:
        reports = cell.check()
    finally:
        complaints = cell.close()
    warnings = [*plan.warnings, *complaints]
    jitter = None if is_virtual(config) else wake_jitter(config.bus.cycle_s)
    highest = highest_trustworthy(config.bus.cycle_s, jitter or 0.0)
    planned = max(
        (float(e.frequencies_hz.max()) for e in plan.experiments if e.frequencies_hz.size), default=0.0
    )
    if planned > highest:
        warnings.append(
            f"lines up to {planned:.3g} Hz are planned, but a cycle of {config.bus.cycle_s * 1e3:g} ms and a "
            f"computer that wakes {(jitter or 0.0) * 1e6:.0f} µs late (rms) carry only those up to "
            f"{highest:.3g} Hz; shorten bus.cycle_s, stop other programs, or lower the band"
        )
    for r in reports:
        warnings += r.warnings
    return {
        "robot": config.robot,
        "simulated": config.simulated,
        "ready": True,
        "bus": {
            "interface": config.bus.interface,
            "channel": config.bus.channel,
            "load": plan.budget.load,
            "max_load": plan.budget.max_load,
            "jitter_rms_us": None if jitter is None else jitter * 1e6,
            "highest_trustworthy_Hz": highest_trustworthy(config.bus.cycle_s, jitter or 0.0),
        },
        "drives": [r.to_json() for r in reports],
        "limits": [
            {
                "axis": a.name,
                "torque": a.limits.torque,
                "position": a.limits.position,
                "velocity": a.limits.velocity,
                "hold": a.hold.mode,
            }
            for a in config.axes
        ],
        "plan": plan.to_json(),
        "warnings": warnings,
    }


def wake_jitter(cycle_s: float) -> float:
    """How late (rms, s) this process wakes at its slots now; the cycle's own process does better."""
    late = []
    slot = time.monotonic()
    for _ in range(max(20, round(PROBE_S / cycle_s))):
        slot += cycle_s
        time.sleep(max(slot - time.monotonic(), 0.0))
        now = time.monotonic()
        late.append(now - slot)
        slot = max(slot, now - cycle_s)  # a pause is one pause, not every slot after it
    return math.sqrt(sum(x * x for x in late) / len(late))


def highest_trustworthy(cycle_s: float, jitter_s: float) -> float:
    """Highest frequency [Hz] with ten cycles to its period and at most 0.05 rad of jitter.

    Ten: the zero-order hold is then 0.3 rad, which is modelled, and its images lie above nine times the
    line. 0.05 rad is one per mille of the torque's power in the wrong phase (0.05²/2).
    """
    by_cycle = 0.1 / cycle_s
    return by_cycle if jitter_s <= 0 else min(by_cycle, PHASE_RAD / (2 * math.pi * jitter_s))


def _text(config: CellConfig, document: dict[str, Any]) -> str:
    bus = document["bus"]
    lines = [
        f"{config.robot}: ready. Bus {bus['interface']} {bus['channel']}, load {bus['load']:.0%} of "
        f"{bus['max_load']:.0%}; frequencies up to {bus['highest_trustworthy_Hz']:.0f} Hz can be trusted"
    ]
    for drive, limit in zip(document["drives"], document["limits"], strict=True):
        unit, torque = ("m", "N") if config.linear else ("rad", "N·m")
        lines.append(
            f"  {drive['axis']}: node {drive['node_id']}, {drive['torque_mode'].replace('_', ' ')}, rated "
            f"{drive['rated_torque']:g} {torque}, one count is {drive['position_per_count']:.3g} {unit}; "
            "limits "
            f"{limit['torque']:g} {torque}, ±{limit['position']:g} {unit}, {limit['velocity']:g} {unit}/s"
        )
        lines += [f"    lacks {what}" for what in drive["lacks"]]
    lines.append(plan_text(make_plan(config), "plan"))
    return "\n".join(lines)


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    def check(
        config: Path = typer.Argument(..., help="The cell's config."),
        as_json: bool = typer.Option(False, "--json", help="One JSON document on stdout."),
    ) -> int:
        """Preflight: config, bus budget, drives, safety objects, limits; moves nothing."""
        cell = load_config(config)
        document = preflight(cell)
        emit(document, _text(cell, document), as_json=as_json)
        return EXIT_OK
