"""Write what each test costs and which blocks of the product it runs, by worker.

A plugin of pytest. Wall clock and processor time of set-up, call and tear-down, children that ended included;
a module's fixture counts for the first test that asks for it.
"""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from scripts.test_costs.blocks import ROOT, install

_SITE = """import importlib.util
spec = importlib.util.spec_from_file_location("blocks", {blocks!r})
blocks = importlib.util.module_from_spec(spec)
spec.loader.exec_module(blocks)
blocks.install(blocks.Path({array!r}))
"""


class Costs:
    """Writes a line of JSON a phase of each test."""

    def __init__(self, folder: Path) -> None:
        self.worker = os.environ.get("PYTEST_XDIST_WORKER", "alone")
        self.array = folder / f"ran-{self.worker}"
        self.array.unlink(missing_ok=True)
        self.ran = install(self.array)
        self.lines = (folder / f"costs-{self.worker}.jsonl").open("w", encoding="utf-8")
        site = folder / f"site-{self.worker}"
        site.mkdir(exist_ok=True)
        text = _SITE.format(blocks=str(ROOT / "scripts/test_costs/blocks.py"), array=str(self.array))
        (site / "sitecustomize.py").write_text(text, encoding="utf-8")
        rest = os.environ.get("PYTHONPATH")
        os.environ["PYTHONPATH"] = os.pathsep.join([str(site), *([rest] if rest else [])])

    def _phase(self, item: pytest.Item, name: str) -> Generator[None, Any, Any]:
        wall, before = time.perf_counter(), sum(os.times()[:4])
        try:
            return (yield)
        finally:
            spent = {"wall": time.perf_counter() - wall, "cpu": sum(os.times()[:4]) - before}
            grouped = item.get_closest_marker("xdist_group") is not None
            test = item.nodeid.rpartition("@")[0] if grouped and "@" in item.nodeid else item.nodeid
            ran = [found.start() for found in re.finditer(rb"\x01", self.ran)]
            self.ran[:] = bytes(len(self.ran))
            line = {"test": test, "phase": name, "worker": self.worker, **spent, "ran": ran}
            self.lines.write(json.dumps(line) + "\n")
            self.lines.flush()

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Generator[None, Any, Any]:
        return (yield from self._phase(item, "setup"))

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, Any, Any]:
        return (yield from self._phase(item, "call"))

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Generator[None, Any, Any]:
        return (yield from self._phase(item, "teardown"))


def pytest_configure(config: pytest.Config) -> None:
    """Measure where tests run: in the workers, or here where there are none."""
    if hasattr(config, "workerinput") or not config.getoption("numprocesses", None):
        folder = Path(os.environ["TEST_COSTS"]).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        config.pluginmanager.register(Costs(folder), "costs")
