"""Cells as users describe them are measured by the default plan, within what the dry run announced."""

import pytest

from invid.config import CellConfig
from invid.errors import ConfigError
from invid_drivers.readiness import ask, foresee
from machines.ordinary import measure, ordinary

BY_NIGHT = pytest.mark.campaign


# one to three axes; with and without 0x1016, loads and stated inertias; 1, 2 and 4 ms
@pytest.mark.parametrize("seed", [2, *(pytest.param(s, marks=BY_NIGHT) for s in (5, 16, 19, 23, 34))])
def test_an_ordinary_cell_is_measured_and_its_plant_never_does_more_than_the_dry_run_announced(
    seed: int,
) -> None:
    found = measure(ordinary(seed))
    assert found.error == ""
    assert found.recording is not None
    assert len(found.recording.experiments) == len(found.config.axes) + 1
    assert (found.peaks <= found.announced * (1 + 1e-6)).all()
    assert (found.peaks <= found.limits * (1 + 1e-6)).all()
    for budget in found.budgets:  # nothing is announced that would not come to rest in its room
        for way in (budget.stop, budget.dead_master):
            assert way is None or way <= budget.case.room * (1 + 1e-6)


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [7, *(pytest.param(s, marks=BY_NIGHT) for s in (3, 16))])
def test_a_heartbeat_that_a_user_has_set_is_kept_and_the_refusal_names_one_that_will_do(seed: int) -> None:
    config = ordinary(seed)

    def with_heartbeat(seconds: float) -> CellConfig:
        safety = config.safety.model_copy(update={"heartbeat_s": seconds})
        return config.model_copy(update={"safety": safety})

    heartbeat = 2.0
    refused: list[str] = []
    for _ in config.axes:  # one axis after another may need a shorter one
        try:
            budgets = ask(with_heartbeat(heartbeat)).require().budgets
            break
        except ConfigError as error:
            refused.append(str(error))
            heartbeat = float(refused[-1].split("shorten safety.heartbeat_s to ")[1].split(" at most")[0])
    assert refused
    assert len({text.split(":")[0] for text in refused}) == len(refused)
    assert max(b.case.facts.watch_s or 0.0 for b in budgets) == pytest.approx(3 * heartbeat)
    assert foresee(config).budgets
