"""``invid simcell``: the simulated drives alone, in real time, for another master to drive."""

from __future__ import annotations

import signal
import threading
from pathlib import Path
from types import FrameType

import typer

from invid.cli.output import emit, note
from invid_drivers.stop_flag import StopFlag


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("simcell")
    def simcell(
        config: Path = typer.Argument(..., help="Cell configuration with a section 'simulation'."),
        duration_s: float | None = typer.Option(
            None, "--duration", help="Stop by itself after so many seconds.", min=0.0
        ),
        as_json: bool = typer.Option(False, "--json", help="Print statistics as one JSON document."),
    ) -> None:
        """Run the simulated drives in real time on the bus that CONFIG names, until Ctrl-C."""
        from invid.config import load_config
        from invid_drivers.simulated.simcell import run_simcell

        cell = load_config(config)
        stop, where = StopFlag(), f"{cell.bus.interface} {cell.bus.channel}"

        def leave(_number: int, _frame: FrameType | None) -> None:
            stop.set()

        before = {n: signal.signal(n, leave) for n in (signal.SIGINT, signal.SIGTERM)}
        timer = threading.Timer(duration_s or 0.0, stop.set)
        timer.daemon = True
        try:
            if duration_s is not None:
                timer.start()
            said = f"simulated cell is ready on {where}; Ctrl-C ends it"
            statistics = run_simcell(cell, stop, ready=lambda: note(said), realtime=True)
        finally:
            timer.cancel()
            for number, handler in before.items():
                signal.signal(number, handler)
        lines = [
            f"simulated cell ran {statistics.duration_s:.1f} s: {statistics.syncs} SYNC, "
            f"{statistics.frames_received} frames received, {statistics.frames_sent} sent"
        ]
        lines += [f"  {d['axis']} (node {d['node_id']}): {d['state']}" for d in statistics.drives]
        emit(statistics.to_json(), "\n".join(lines), as_json=as_json)
