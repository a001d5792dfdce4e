"""One run of every kind of fault (`tests/machines/faults.py`)."""

from pathlib import Path

import numpy as np
import pytest

from tests.machines import faults as campaign

# One worker: what numba compiles for the plant is compiled once.
pytestmark = pytest.mark.xdist_group("faults")


EVERY_TIME = (
    "bus_off master",
    "node_silent",
    "emcy",
    "encoder_stuck",
    "ignore_quick_stop",
    "ignore_controlword",
    "sign_flip encoder",
    "push",
)


@pytest.mark.parametrize(
    "kind",
    [pytest.param(k, marks=() if k in EVERY_TIME else pytest.mark.campaign) for k in campaign.EXPECTED],
)
def test_a_fault_at_a_random_moment_leaves_no_axis_energised_and_the_recording_whole(
    kind: str, tmp_path: Path
) -> None:
    seed = sum(kind.encode())
    outcome = campaign.run_one(kind, np.random.default_rng([2026, seed]), tmp_path)
    assert outcome.complaints == ()


def test_the_campaign_notices_a_drive_that_is_left_energised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The judge must be able to say no: without the way out, it does."""
    from invid_drivers.cia402.bus import Cia402Cell

    monkeypatch.setattr(Cia402Cell, "stop", lambda self: None)
    monkeypatch.setattr(Cia402Cell, "close", lambda self: [])
    # a drive that hears SYNC no longer stops by its own heartbeat watch; take that away as well
    monkeypatch.setattr("invid_drivers.cia402.axis.Drive.protect", lambda self, report: None)
    outcome = campaign.run_one("emcy", np.random.default_rng(1), tmp_path)
    assert any("OPERATION_ENABLED" in c for c in outcome.complaints)


@pytest.mark.parametrize(("at_s", "length"), [(0.7, 8), (1.2, 3), (1.5, 1)])
def test_an_error_reported_while_the_drives_are_prepared_is_not_forgotten(
    at_s: float, length: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fault = {"kind": "emcy", "axis": "A1", "at_s": at_s, "code": 0x2310, "length": length}
    monkeypatch.setattr(campaign, "draw", lambda *_: fault)
    outcome = campaign.run_one("emcy", np.random.default_rng(1), tmp_path)
    assert outcome.status == 5
    assert outcome.complaints == ()
