"""A few power cuts of `benchmarks/drivers/bench_power_cut.py`, which makes sixty, and that it can convict."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.drivers import bench_power_cut
from invid_drivers.cia402.axis import Drive

# One worker: what numba compiles for the plant is compiled once.
pytestmark = pytest.mark.xdist_group("faults")


def test_after_a_power_cut_no_newer_setting_is_undone_and_no_entry_is_lost(tmp_path: Path) -> None:
    for number in range(4):
        history = bench_power_cut.run_one(np.random.default_rng([2026, number]), tmp_path)
        assert history.complaints == [], history


def test_a_product_that_restores_nothing_is_convicted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Drive, "restore", lambda self, *a, **k: [])
    history = bench_power_cut.run_one(np.random.default_rng([2026, 0]), tmp_path)
    assert any("at the end" in c for c in history.complaints)
