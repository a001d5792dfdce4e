"""Machines that nobody measured, from their CSV to the names: a few of the campaign of bench_real_data.py."""

from __future__ import annotations

import json

import pytest

from invid.cli.app import run
from machines.draw import draw
from machines.score import score
from machines.write import write

pytestmark = pytest.mark.campaign


@pytest.mark.panel
@pytest.mark.parametrize(
    ("family", "seed"),
    [("axis", 103), ("axis", 117), ("axis", 131), ("arm", 310)],
    ids=[
        "friction by direction, chirp of 400 Hz",
        "ripple seen as velocity only, which is no delay",
        "gravity and dry friction on a 12-bit encoder",
        "two links",
    ],
)
def test_nothing_is_named_for_sure_that_is_not_there(tmp_path, family, seed):
    machine = draw(seed, family)
    source, chart = write(machine, tmp_path, seed)
    record, out = tmp_path / "r.h5", tmp_path / "d.json"
    assert run(["import", str(source), "--map", str(chart), "-o", str(record)]) == 0
    assert run(["diagnose", str(record), "-o", str(out)]) == 0
    found = score(machine, json.loads(out.read_text(encoding="utf-8")))
    assert not found.wrong_sure, (machine.scenario, found)
    assert machine.outside or found.right, (machine.scenario, found)
    assert not machine.outside or not found.wrong, (machine.scenario, found)
