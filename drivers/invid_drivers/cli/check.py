"""``invid check``: preflight of config, bus budget, drives and limits; moves nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import typer

from invid.cli.output import EXIT_OK, emit
from invid.config import CellConfig, load_config
from invid.errors import DriveError, InputError
from invid_drivers.cia402.bus import STOPPED_S
from invid_drivers.cia402.stated.scales import MUCH_OF_RATED
from invid_drivers.cli.measure import budget_lines, plan_text
from invid_drivers.connect import is_virtual
from invid_drivers.readiness import ask
from invid_drivers.stopping_budgets import Budgeted
from invid_drivers.timing import timing_of

IN_TIME = "the way that the axis needs to come to rest"


def preflight(config: CellConfig, cleared: Sequence[str] = ()) -> tuple[Budgeted, dict[str, Any]]:
    """Check config, holds, plan, bus budget, every drive's capabilities, safety objects and limits.

    ``cleared``: axes at which an earlier run ended and of which a person has found the cause.

    Raises
    ------
    ConfigError, DriveError, BusError
        The first thing that would keep a measurement from starting.
    """
    asked = ask(config, cleared=cleared, probes=not is_virtual(config))
    if asked.refusal is not None or asked.prepared is None:
        raise asked.refusal or DriveError("the drives were not asked")
    within, reports = asked.prepared, asked.reports
    plan, tighter, found = within.plan, within.config, within.round_trip
    timing = timing_of(config)
    warnings = [*plan.warnings, *asked.said, *timing.warnings(plan)]
    return within, {
        "robot": config.robot,
        "simulated": config.simulated,
        "ready": asked.can_start,
        "reasons": [asdict(r) for r in asked.reasons],
        "holding": [h.to_json() for h in asked.holdings],
        "bus": {
            "interface": config.bus.interface,
            "channel": config.bus.channel,
            "load": plan.budget.load,
            "max_load": plan.budget.max_load,
            "jitter_rms_us": timing.to_json()["jitter_rms_us"],
            "highest_trustworthy_Hz": timing.highest_hz,
            "round_trip": None if found is None else found.to_json(),
        },
        "timing": timing.to_json(),
        "drives": [r.to_json() for r in reports],
        "limits": [
            {
                "axis": a.name,
                "torque": a.limits.torque,
                "position": a.limits.position,
                "velocity": a.limits.velocity,
                "hold": a.hold.mode,
                "sources": {
                    **{what: limit["source"] for what, limit in asdict(r.limits).items()},
                    **({"velocity": IN_TIME} if b.permitted < b.case.velocity else {}),
                },
            }
            for a, r, b in zip(tighter.axes, reports, within.budgets, strict=True)
        ],
        "budgets": [b.to_json() for b in within.budgets],
        "longest_stop_s": STOPPED_S,
        "plan": plan.to_json(),
        "warnings": warnings,
    }


def _text(config: CellConfig, within: Budgeted, document: dict[str, Any]) -> str:
    plan = within.plan
    bus = document["bus"]
    ready = "ready" if document["ready"] else "NOT READY"
    beyond = [
        a.name
        for a, drive in zip(config.axes, document["drives"], strict=True)
        if a.limits.torque > min(drive["limits"]["torque"]["value"], MUCH_OF_RATED * drive["rated_torque"])
    ]
    if beyond:
        ready += f"; the torque limit of {', '.join(beyond)} is beyond what its drive gives (see the notes)"
    lines = [
        f"{config.robot}: {ready}. Bus {bus['interface']} {bus['channel']}, load {bus['load']:.0%} of "
        f"{bus['max_load']:.0%}; frequencies up to {bus['highest_trustworthy_Hz']:.0f} Hz can be trusted"
    ]
    if bus["round_trip"] is not None:
        lines.append(
            "  adapter: {count} round trips of {median_ms:.2g} ms, 99 % within {bound_ms:.2g} ms, the worst "
            "{worst_ms:.2g} ms".format(**bus["round_trip"])
            + f"; carries cycles from {bus['round_trip']['shortest_cycle_s'] * 1e3:g} ms"
        )
    for drive, limit in zip(document["drives"], document["limits"], strict=True):
        unit, torque = ("m", "N") if config.linear else ("rad", "N·m")
        lines.append(
            f"  {drive['axis']}: node {drive['node_id']}, {drive['torque_mode'].replace('_', ' ')}, rated "
            f"{drive['rated_torque']:g} {torque}, one count is {drive['position_per_count']:.3g} {unit}; "
            f"limits {limit['torque']:g} {torque}, ±{limit['position']:g} {unit}, {limit['velocity']:g} "
            f"{unit}/s"
        )
        lines += [f"    {what} limited by {source}" for what, source in limit["sources"].items()]
        lines += [f"    lacks {what}" for what in drive["lacks"]]
    lines += [
        f"  {'note' if r['taken_over'] else 'not ready'}: {r['text']}; {r['fix']}"
        for r in document["reasons"]
    ]
    lines += budget_lines(within.budgets, linear=config.linear)
    lines.append(f"  a stop ends, whatever drives do, within {document['longest_stop_s']:.0f} s")
    lines.append(plan_text(plan, "plan"))
    lines += [f"  note: {w}" for w in document["warnings"] if w not in plan.warnings]
    return "\n".join(lines)


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    def check(
        config: Path = typer.Argument(..., help="The cell's config."),
        cleared: str | None = typer.Option(
            None,
            "--cleared",
            help="Loaded axes, as A1,A2, at which a run ended and whose cause has been found.",
        ),
        as_json: bool = typer.Option(False, "--json", help="One JSON document on stdout."),
    ) -> int:
        """Preflight: config, bus budget, drives, safety objects, limits; moves nothing."""
        cell = load_config(config)
        names = [a.strip() for a in (cleared or "").split(",") if a.strip()]
        unknown = [n for n in names if n not in {a.name for a in cell.axes}]
        if unknown:
            raise InputError(f"--cleared names {unknown[0]!r}; the axes are {[a.name for a in cell.axes]}")
        within, document = preflight(cell, names)
        emit(document, _text(cell, within, document), as_json=as_json)
        return EXIT_OK if document["ready"] else DriveError.exit_code
