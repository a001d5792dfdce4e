"""A budget ends every search with an answer that claims nothing of what was not looked at."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from hidden.generator import make

import invid
from invid.cli.app import INTERRUPTED, run
from invid.cli.display import shown_progress
from invid.diagnosis.diagnose import diagnose
from invid.identification import machine_kind
from invid.identification.identify import identify
from invid.numerics import budget
from invid.numerics.budget import Budget, Progress, use_budget
from invid.numerics.run_clock import RunClock
from invid.recording import Kind


class Ticks:
    """A clock that moves by one second each time somebody looks: where a run is cut does not hang on the
    machine."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 1.0
        return self.now


@pytest.fixture(scope="module")
def recording() -> invid.Recording:
    return make("coulomb_friction", (0, 1), seed=5, motors=1, masses=(2,), target_db=30.0, moves=False)[0]


@pytest.fixture(scope="module")
def whole(recording: invid.Recording) -> tuple[invid.Model, invid.Diagnosis, float]:
    """Model, diagnosis and how often the diagnosis looked at its clock."""
    model = identify(recording)
    clock = Ticks()
    with use_budget(Budget(1e9, clock)):
        found = diagnose(recording, model=model)
    return model, found, clock.now


@pytest.fixture(autouse=True)
def _one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Helpers have clocks of their own."""
    monkeypatch.setattr("invid.numerics.parallel._cores", lambda: 1)


def test_a_part_ends_before_the_whole_and_what_is_left_out_is_told_once() -> None:
    now = [0.0]
    with use_budget(Budget(10.0, lambda: now[0])):
        now[0] = 4.0
        with budget.use_share(0.5):
            now[0] = 6.9
            assert not budget.is_spent()
            now[0] = 7.0
            assert budget.is_spent()
            assert budget.or_else("the rest", lambda: 1, 2) == 2
            assert budget.or_else("the rest", lambda: 1, 2) == 2
        assert not budget.is_spent()
        assert budget.left_out() == ("the rest",)
        assert "10 s of the processor" in str(budget.warning())
        assert "at their shares of it, after 7 s in all" in str(budget.warning())
        now[0] = 10.0
        assert "was spent" in str(budget.warning())
    assert not budget.is_spent()
    assert budget.warning() is None


@pytest.mark.parametrize(("moved", "least"), [(True, 80.0), (False, 45.0)])
def test_what_a_rigid_machine_s_diagnosis_does_not_need_goes_to_the_doubt_about_its_kind(
    moved: bool, least: float, monkeypatch: pytest.MonkeyPatch, recording: invid.Recording
) -> None:
    """Where rigid axes miss a lot chains are tried; a search for their causes may follow or not."""
    monkeypatch.setattr(machine_kind, "is_trajectory", lambda _: moved)
    monkeypatch.setattr(machine_kind, "analyse", lambda _: SimpleNamespace(is_cut_short=False))
    monkeypatch.setattr(machine_kind, "rigid_missed_share", lambda _: 0.5)
    monkeypatch.setattr(machine_kind, "identify_trajectory", lambda *_, **__: None)
    given = list[bool]()
    now = [0.0]

    def chains() -> invid.Model:
        for now[0] in (least, 99.0):
            given.append(not budget.is_spent())
        raise invid.InvidError("no chains fit")

    other = tuple(replace(e, kind=Kind.OTHER, period_samples=0) for e in recording.experiments)
    record = replace(recording, experiments=other, masses_per_axis=None)
    with use_budget(Budget(100.0, lambda: now[0])):
        assert machine_kind.machine_kind(record, None, chains, 0.5).rigid
    assert given == [True, False]


def test_progress_never_goes_back_and_says_how_long_at_most() -> None:
    now, seen = [0.0], list[Progress]()
    with use_budget(Budget(100.0, lambda: now[0], seen.append)):
        now[0] = 10.0
        with budget.use_share(1.0, 0.2, 0.6):
            budget.tell("weighing", 0.5, axis="A2", cause="cubic_stiffness", element="spring 1")
            budget.tell("weighing", 0.1)
    assert [round(p.fraction, 3) for p in seen] == [0.4, 0.4]
    assert seen[0].seconds_left == pytest.approx(15.0)
    assert str(seen[0]) == "weighing cubic stiffness, A2 spring 1"


def test_an_identification_that_is_cut_anywhere_gives_a_model_that_says_so(
    recording: invid.Recording,
) -> None:
    clock = Ticks()
    with use_budget(Budget(1e9, clock)):
        assert identify(recording).fit["trustworthy"]
    for share in (0.001, 0.05, 0.2, 0.4, 0.6, 0.8):
        with use_budget(Budget(share * clock.now, Ticks())):
            model = identify(recording)
        assert [w for w in model.warnings if w.startswith("the budget of") and "not looked at" in w], share


@pytest.mark.parametrize("share", [0.001, 0.1, 0.25, 0.5, 0.75, 0.95])
def test_a_search_that_is_cut_calls_nothing_consistent_and_no_finding_sure(
    recording: invid.Recording, whole: tuple[invid.Model, invid.Diagnosis, float], share: float
) -> None:
    model, complete, ticks = whole
    with use_budget(Budget(share * ticks, Ticks())):
        found = diagnose(recording, model=model)
    assert any(w.startswith("the budget of") for w in found.warnings)
    if found.findings:
        assert found.findings[0].effect.cause == complete.findings[0].effect.cause
    if found.details.get("cut_short"):
        assert found.verdict != "consistent"
        assert all(f.confidence <= 0.89 for f in found.findings)
        assert found.findings or found.model.fit["trustworthy"] is False


def test_nothing_is_called_consistent_before_a_cause_was_looked_for() -> None:
    recording = make(None, (0, 1), seed=5, motors=1, masses=(2,), moves=False)[0]
    model = identify(recording)
    assert diagnose(recording, model=model).verdict == "consistent"
    with use_budget(Budget(5.0, Ticks())):
        found = diagnose(recording, model=model)
    assert found.verdict == "unexplained"
    assert found.unexplained is not None
    assert "cut short" in found.unexplained.sentence
    assert found.model.fit["trustworthy"] is False


def test_a_budget_that_is_not_used_up_changes_nothing(
    recording: invid.Recording, whole: tuple[invid.Model, invid.Diagnosis, float]
) -> None:
    model, complete, _ = whole
    plain = diagnose(recording, model=model)
    assert plain.warnings == complete.warnings
    assert [f.effect for f in plain.findings] == [f.effect for f in complete.findings]


def test_the_interface_takes_seconds_and_a_callback(recording: invid.Recording) -> None:
    seen: list[Progress] = []
    invid.diagnose(recording, budget=1000.0, progress=seen.append)
    assert seen[0].fraction < 0.1
    assert seen[-1].fraction > 0.9
    assert [p.fraction for p in seen] == sorted(p.fraction for p in seen)
    found = [f for p in seen for f in p.found]
    assert any(f.cause == "coulomb_friction" and f.axis == recording.axes[0] for f in found)
    with pytest.raises(invid.InputError, match="budget"):
        invid.identify(recording, budget=0.0)


@pytest.mark.parametrize("presses", [1, 2])
def test_ctrl_c_hands_out_the_best_answer_so_far_and_twice_ends_at_once(
    recording: invid.Recording,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    presses: int,
) -> None:
    invid.write_recording(recording, tmp_path / "rec.h5")
    looks = iter(range(10**9))

    def monotonic() -> float:
        if next(looks) in range(20, 20 + presses):
            signal.raise_signal(signal.SIGINT)
        return 0.0

    monkeypatch.setattr("invid.numerics.run_clock.time.monotonic", monotonic)
    result = run(["diagnose", str(tmp_path / "rec.h5"), "--json"])
    out, err = capsys.readouterr()
    assert "Traceback" not in err
    if presses == 2:
        assert result == INTERRUPTED
        assert out == ""
        assert err.splitlines()[-1] == "invid: interrupted"
        return
    assert result in (0, 3)
    document = json.loads(out)
    assert document["format"] == "invid-diagnosis"
    assert any("ended by whoever waited" in w for w in document["warnings"])


def test_a_budget_counts_processor_time_and_that_of_helpers_and_waits_no_longer_than_twice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now, used = [100.0], [5.0, 1.0, 0.5, 0.5, 0.0]
    monkeypatch.setattr("invid.numerics.run_clock.time.monotonic", lambda: now[0])
    monkeypatch.setattr("invid.numerics.run_clock.os.times", lambda: tuple(used))
    clock = RunClock()
    assert clock() == 0.0
    used[0] += 3.0
    assert clock() == pytest.approx(3.0)
    with use_budget(Budget(60.0, clock)):
        with budget.use_helpers(2):
            used[0] += 1.0  # a helper that lives works as much as this process
            assert clock() == pytest.approx(5.0)
            used[2] += 0.8
        assert clock() == pytest.approx(4.8)  # and is counted exactly when it is gone
    now[0] += 20.0
    assert clock() == pytest.approx(10.0)


def test_json_stays_alone_on_stdout_and_the_budget_ends_the_command(
    recording: invid.Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    invid.write_recording(recording, tmp_path / "rec.h5")
    assert run(["diagnose", str(tmp_path / "rec.h5"), "--json", "--budget", "1"]) in (0, 3)
    assert json.loads(capsys.readouterr().out)["format"] == "invid-diagnosis"


@pytest.mark.campaign
@pytest.mark.parametrize("fresh", [True, False])
def test_the_first_run_after_an_installation_says_that_it_compiles(tmp_path: Path, fresh: bool) -> None:
    """With an empty cache, and with the one that this run then filled."""
    script = (
        "import numpy as np, time\nfrom invid.effects.laws.slider import slide\nfrom invid.numerics.budget "
        "import Budget, use_budget\nwith use_budget(Budget(None, time.monotonic, lambda p: print(p))):\n    "
        "slide(np.linspace(-1.0, 1.0, 100), 0.5, periodic=False)\n"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    for _ in range(1 if fresh else 2):
        said = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
        ).stdout
    assert ("compiling" in said) == fresh


def test_plain_lines_say_at_once_that_it_compiles_and_then_now_and_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr("invid.cli.display.time.monotonic", lambda: now[0])
    with shown_progress("diagnosing") as show:
        show(Progress("compiling, once after an installation"))
        for second in range(12):
            now[0] = float(second)
            show(Progress("weighing", "A2", "backlash", 0.5, 20.0, "spring 1"))
    lines = capsys.readouterr().err.splitlines()
    assert "compiling" in lines[0]
    assert lines[1:] == ["diagnosing:  50% weighing backlash, A2 spring 1 (about 20 s left)"] * 2
