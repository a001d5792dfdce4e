"""`make bench`: every benchmark in turn, each in its own process; prints what each one prints.

    python benchmarks/run_all.py                                                   # all, whole campaigns
    python benchmarks/run_all.py --page docs/reference/benchmarks.md [--quick]     # the page of figures

A benchmark is any `bench_*.py` below `benchmarks/`; with no arguments it runs its whole campaign.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from benchmarks.page import page

HERE = Path(__file__).parent


def main() -> int:
    """Run all; the exit status is the number of benchmarks that failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--page", type=Path, help="write the page of figures here and run nothing else")
    parser.add_argument("--quick", action="store_true", help="short settings, with --page")
    options, rest = parser.parse_known_args()
    if options.page:
        text, missed = page(quick=options.quick)
        options.page.write_text(text, encoding="utf-8")
        return missed
    failed = 0
    for script in sorted(HERE.rglob("bench_*.py")):
        print(f"\n=== {script.relative_to(HERE)}", flush=True)
        failed += subprocess.run([sys.executable, str(script), *rest], check=False).returncode != 0
    return failed


if __name__ == "__main__":
    sys.exit(main())
