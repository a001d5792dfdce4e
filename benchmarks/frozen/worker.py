"""Runs cases with whatever revision of invid stands on the path: one JSON line in, one out.

Started by bench_frozen.py, once a revision and job. Only the command line is used, which every revision has.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from pathlib import Path


def main(tree: str) -> None:
    """Answer each line of stdin, until there are no more."""
    answers = sys.stdout  # what the commands print goes elsewhere
    import invid
    from invid.cli.app import run

    if Path(tree).resolve() not in Path(invid.__file__).resolve().parents:
        raise SystemExit(f"invid comes from {invid.__file__}, not from {tree}")
    print(json.dumps({"ready": True}), file=answers, flush=True)
    for line in sys.stdin:
        job = json.loads(line)
        said, statuses, started = io.StringIO(), {}, sum(os.times()[:4])
        for command in ("identify", "diagnose"):
            out = Path(job["folder"]) / ("model.json" if command == "identify" else "diagnosis.json")
            with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
                statuses[command] = run([command, job["recording"], "-o", str(out), *job["arguments"]])
        cpu = sum(os.times()[:4]) - started
        print(
            json.dumps({"status": statuses, "said": said.getvalue(), "cpu_s": cpu}), file=answers, flush=True
        )


if __name__ == "__main__":
    main(sys.argv[1])
