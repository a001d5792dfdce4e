"""The highest frequency that a cycle and a computer's jitter can carry."""

import math
import os
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from invid.cli.app import create_app
from invid.config import load_config
from invid.planning import make_plan
from invid_drivers.timing import Timing, highest_trustworthy, timing_of, wake_jitter


def test_without_jitter_a_line_needs_ten_cycles_to_its_period() -> None:
    assert highest_trustworthy(0.001, 0.0) == pytest.approx(100.0)
    assert highest_trustworthy(0.004, 0.0) == pytest.approx(25.0)


def test_jitter_lowers_it_where_its_phase_matters() -> None:
    highest = highest_trustworthy(0.001, 0.0005)
    assert highest < 100.0
    assert 2 * math.pi * highest * 0.0005 == pytest.approx(0.05)
    assert highest_trustworthy(0.001, 1e-6) == pytest.approx(100.0)


def test_this_computers_jitter_is_a_positive_time_within_what_is_not_skipped() -> None:
    jitter, skipped = wake_jitter(0.001)
    assert 0.0 < jitter <= 0.5 * 0.001
    assert 0.0 <= skipped <= 1.0


def test_a_check_leaves_the_process_with_the_priority_it_had() -> None:
    before = os.sched_getscheduler(0)
    config = load_config(Path(__file__).parents[3] / "configs" / "case-study-unix.yaml")
    found = timing_of(config)
    assert os.sched_getscheduler(0) == before
    assert found.jitter_s is not None
    assert found.highest_hz <= 100.0


def test_a_plan_beyond_what_the_computer_carries_is_told_so() -> None:
    config = load_config(Path(__file__).parents[3] / "configs" / "case-study-unix.yaml")
    plan = make_plan(config)
    assert Timing(0.001, 1e-6, 0.0, True).warnings(plan) == []
    (warning,) = Timing(0.001, 0.004, 0.0, False).warnings(plan)
    # 0.05 rad of jitter at 4 ms: 0.05/(2π·0.004) = 2 Hz
    assert "up to 1.99 Hz" in warning
    assert "bus.cycle_s" in warning


def test_the_text_of_a_check_shows_every_warning(tmp_path: Path) -> None:
    (tmp_path / "broken.eds").write_text("[FileInfo\nno EDS\n", encoding="utf-8")
    text = (Path(__file__).parents[3] / "configs" / "case-study.yaml").read_text(encoding="utf-8")
    data = yaml.safe_load(text)
    data["axes"][1]["eds"] = "broken.eds"
    (tmp_path / "cell.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    done = CliRunner().invoke(create_app(), ["check", str(tmp_path / "cell.yaml")])
    assert done.exit_code == 0
    assert "note: axis A2" in done.stdout
    assert "broken.eds does not parse" in done.stdout
