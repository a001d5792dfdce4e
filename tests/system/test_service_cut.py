"""kill -9 of runner, service, both and ``invid measure`` in mid-run: ``benchmarks/service/bench_cut.py``."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from benchmarks.service.bench_cut import VICTIMS, WINDOW_S, cut

pytestmark = pytest.mark.xdist_group("service")


@pytest.mark.slow
@pytest.mark.parametrize("victim", VICTIMS)
def test_a_kill_at_a_random_instant_leaves_a_readable_recording_that_is_offered_and_worked_out(
    tmp_path: Path, victim: str
) -> None:
    moment_s = random.Random(victim).uniform(0.0, WINDOW_S)
    found = cut(victim, moment_s, tmp_path)
    assert list(found.complaints) == []
    assert found.rows > 0
    assert found.outcome in ("failed", "aborted", "completed")
