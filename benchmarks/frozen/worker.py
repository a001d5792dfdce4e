"""Runs recordings with whatever revision of invid stands on the path, each in a fork of its own.

    python worker.py TREE RESULTS TIMEOUT < paths

Started by bench_frozen.py, once a revision. Only the command line is used, which every revision has. What
fails, hangs or takes its process down is written down as that.
"""

from __future__ import annotations

import contextlib
import io
import json
import multiprocessing
import os
import sys
from pathlib import Path


def one(recording: str, place: Path) -> None:
    """Documents of one recording, and beside them what the commands said and took."""
    from invid.cli.app import run

    said, statuses, started = io.StringIO(), {}, sum(os.times()[:4])
    for command, document in (("identify", "model.json"), ("diagnose", "diagnosis.json")):
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            statuses[command] = run([command, recording, "-o", str(place / document)])
    answer = {"status": statuses, "said": said.getvalue(), "cpu_s": sum(os.times()[:4]) - started}
    (place / "answer.json").write_text(json.dumps(answer), encoding="utf-8")


def main(tree: str, results: str, timeout: str) -> None:
    """Work through the paths of stdin."""
    import invid
    import invid.cli.app  # before the forks: once

    if Path(tree).resolve() not in Path(invid.__file__).resolve().parents:
        raise SystemExit(f"invid comes from {invid.__file__}, not from {tree}")
    for path in sys.stdin.read().splitlines():
        place = Path(results) / Path(path).stem
        place.mkdir(exist_ok=True)
        process = multiprocessing.get_context("fork").Process(target=one, args=(path, place))
        process.start()
        process.join(float(timeout))
        why = "the process ended" if process.exitcode is not None else f"no answer within {timeout} s"
        process.kill()
        process.join()
        if not (place / "answer.json").exists():
            lost = {"status": {}, "said": why, "cpu_s": 0.0}
            (place / "answer.json").write_text(json.dumps(lost), encoding="utf-8")
        print(f"{place.name}: done", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
