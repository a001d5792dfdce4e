"""A budget ends every search with an answer that claims nothing of what was not looked at."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hidden.generator import make

import invid
from invid.cli.app import INTERRUPTED, run
from invid.diagnosis.diagnose import diagnose
from invid.identification.identify import identify
from invid.numerics.budget import Budget, use_budget
from invid.numerics.run_clock import RunClock

BY_NIGHT = pytest.mark.campaign


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


def test_an_identification_that_is_cut_anywhere_gives_a_model_that_says_so(
    recording: invid.Recording,
) -> None:
    clock = Ticks()
    with use_budget(Budget(1e9, clock)):
        assert identify(recording).fit["trustworthy"]
    for share in (0.001, 0.2, 0.8):
        with use_budget(Budget(share * clock.now, Ticks())):
            model = identify(recording)
        assert [w for w in model.warnings if w.startswith("the budget of") and "not looked at" in w], share


@pytest.mark.parametrize(
    "share", [0.001, 0.5, *(pytest.param(s, marks=BY_NIGHT) for s in (0.1, 0.25, 0.75, 0.95))]
)
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


def test_a_budget_counts_processor_time_and_waits_no_longer_than_twice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now, used = [100.0], [5.0, 1.0, 0.5, 0.5, 0.0]
    monkeypatch.setattr("invid.numerics.run_clock.time.monotonic", lambda: now[0])
    monkeypatch.setattr("invid.numerics.run_clock.os.times", lambda: tuple(used))
    clock = RunClock()
    assert clock() == 0.0
    used[0] += 3.0
    assert clock() == pytest.approx(3.0)
    now[0] += 20.0
    assert clock() == pytest.approx(10.0)


@pytest.mark.campaign
@pytest.mark.parametrize("fresh", [True, False])
def test_the_first_run_after_an_installation_says_that_it_compiles(tmp_path: Path, fresh: bool) -> None:
    """With an empty cache, and with the one that this run then filled."""
    script = (
        "import numpy as np, time\nfrom invid.numerics.budget import Budget, use_budget\n"
        "from invid.rigid_motion.rows import innovations\n"
        "with use_budget(Budget(None, time.monotonic, lambda p: print(p))):\n"
        "    innovations(np.ones((9, 1)), np.full(9, 0.5), 0.1)\n"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    for _ in range(1 if fresh else 2):
        said = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
        ).stdout
    assert ("compiling" in said) == fresh
