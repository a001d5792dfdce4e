"""Ways to rest against an integration of their own, and the speeds that are permitted for them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from invid.config import CellConfig, load_config
from invid.errors import ConfigError
from invid.planning.stopping_distance import (
    COASTING_SHARE,
    FEEDBACK_FACTOR,
    LEAST_EXCITATION,
    SETTLE_S,
    SPEED_TOLERANCE,
    StoppingCase,
    StoppingFacts,
    budget_of,
    budgets_of,
    case_of,
    permitted,
    torque_shares,
)

FACTS = StoppingFacts(deceleration=10.0, ramp="0x6085", watch_s=0.3, watch="0x1016")
CASE = StoppingCase(
    axis="A1", facts=FACTS, inertia=2.0, torque=30.0, load=4.0, planned=6.0, reaction_s=0.02, sight_s=0.005,
    room=0.5, velocity=3.0,
)  # fmt: skip


def integrated(case: StoppingCase, speed: float, seconds: float, braking: float) -> float:
    """A mass under the planned torque, then under a braking one, stepped; what swings on comes after."""
    assert case.inertia is not None
    x, v, t, step = 0.0, SPEED_TOLERANCE * speed, 0.0, 1e-5
    swing = (v + case.planned / case.inertia * seconds) * SETTLE_S
    while v > 0 or t < seconds:
        v += step * (case.planned / case.inertia if t < seconds else -braking)
        x, t = x + step * v, t + step
    return x + swing


@pytest.mark.parametrize(("speed", "seconds"), [(0.5, 0.0), (2.0, 0.02), (0.0, 0.3), (3.0, 0.3)])
@pytest.mark.parametrize(("ramp", "braking"), [(10.0, 10.0), (50.0, 13.0), (np.inf, 13.0)])
def test_the_way_to_rest_is_that_of_a_mass_braked_by_the_ramp_or_by_what_the_torque_leaves_beside_the_load(
    speed: float, seconds: float, ramp: float, braking: float
) -> None:
    case = replace(CASE, facts=replace(FACTS, deceleration=ramp))
    expected = integrated(case, speed, seconds, braking)
    assert case.distance(speed, seconds) == pytest.approx(expected, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("seed", range(8))
def test_from_the_permitted_speed_the_longer_way_is_the_room_or_the_speed_is_the_limit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    case = replace(
        CASE,
        facts=replace(FACTS, deceleration=rng.uniform(1, 50), watch_s=rng.uniform(0.01, 0.3)),
        room=rng.uniform(0.4, 5), planned=rng.uniform(0, 3),
    )  # fmt: skip
    budget = budget_of(case)
    assert budget.stop is not None
    assert budget.dead_master is not None
    longer = max(budget.stop, budget.dead_master)
    if budget.permitted < case.velocity:
        assert longer == pytest.approx(case.room)
    else:
        assert longer <= case.room


def test_a_torque_limit_that_does_not_carry_the_load_is_refused_with_the_way_out() -> None:
    config = cell(gravity_loaded=True)
    with pytest.raises(ConfigError, match=r"A1.*25 N·m leaves nothing beside a load of 30.*unload"):
        budgets_of(config, [FACTS], [0.0], [5.7], [30.0])


def test_a_master_that_is_missed_too_late_is_refused_with_the_way_out() -> None:
    facts = replace(FACTS, watch_s=1.5)
    with pytest.raises(ConfigError, match=r"A1.*even from rest.*1505 ms.*0x1016.*shorten safety.heartbeat_s"):
        budgets_of(cell(), [facts], [17.0], [5.7])


@pytest.mark.parametrize("seed", range(8))
def test_the_torque_that_is_kept_takes_half_of_the_room_from_rest_unless_it_is_the_least(seed: int) -> None:
    rng = np.random.default_rng(seed)
    facts = replace(FACTS, deceleration=rng.uniform(1, 50), watch_s=rng.uniform(0.03, 0.5))
    planned, inertia = rng.uniform(1, 25), float(10 ** rng.uniform(-0.5, 1))
    config = cell(inertia=inertia)
    (share,) = torque_shares(config, [facts], [planned], [inertia])
    (whole,) = (case_of(config.axes[0], facts, config, planned=p, inertia=inertia) for p in [planned])
    kept = replace(whole, planned=FEEDBACK_FACTOR * share * planned)
    assert kept.deceleration is not None
    way = integrated(kept, 0.0, kept.longest_s, kept.deceleration)
    least = share * planned == pytest.approx(LEAST_EXCITATION * 25)
    if share == 1.0:
        assert way <= COASTING_SHARE * kept.room * 1.01
    elif not least:
        assert way == pytest.approx(COASTING_SHARE * kept.room, rel=5e-3)
    else:
        assert way >= COASTING_SHARE * kept.room * 0.99


def test_an_axis_of_unknown_inertia_keeps_its_torque_until_the_trial_has_weighed_it() -> None:
    assert torque_shares(cell(inertia=None), [FACTS], [17.0], [None]) == (1.0,)


def test_the_refusal_of_the_least_excitation_says_the_heartbeat_and_the_room_that_would_do() -> None:
    config, facts = cell(inertia=0.5), replace(FACTS, watch_s=1.5)
    planned = LEAST_EXCITATION * 25
    with pytest.raises(ConfigError) as refused:
        budgets_of(config, [facts], [planned], [0.5])
    said = str(refused.value)
    assert "the least excitation of 5% of its torque limit" in said
    heartbeat = float(said.split("heartbeat_s to ")[1].split(" at most")[0])
    budgets_of(config, [replace(facts, watch_s=3 * heartbeat)], [planned], [0.5])
    limits = config.axes[0].limits.model_copy(update={"stopping_room": float(said.split()[-1]) * 1.01})
    wide = config.model_copy(update={"axes": [config.axes[0].model_copy(update={"limits": limits})]})
    budgets_of(wide, [facts], [planned], [0.5])


def test_a_lower_speed_says_why_and_what_would_make_the_way_shorter() -> None:
    (budget,) = budgets_of(cell(), [replace(FACTS, deceleration=1.0, watch_s=0.05)], [0.0], [5.7])
    assert budget.permitted < 1.0
    (said,) = budget.said(linear=False)
    assert "permitted, not 3" in said
    assert "0x6085" in said
    assert "stopping_room_rad" in said
    assert permitted(cell(), [budget]).axes[0].limits.velocity == budget.permitted


def test_what_nobody_knows_is_said_and_no_figure_is_made_up() -> None:
    nothing = replace(FACTS, deceleration=None, ramp="0x6085 (quick stop deceleration) is missing or 0")
    (budget,) = budgets_of(cell(), [nothing], [1.0], [5.7])
    assert budget.stop is None
    assert budget.dead_master is None
    assert "quick_stop_deceleration_rad_per_s2" in " ".join(budget.said(linear=False))
    (budget,) = budgets_of(cell(), [replace(FACTS, watch_s=None, watch="0x6007 is missing")], [1.0], [5.7])
    assert budget.stop is not None
    assert budget.dead_master is None
    assert "0x6007 is missing" in " ".join(budget.said(linear=False))


def test_a_range_of_the_drive_that_ends_in_the_way_is_said() -> None:
    (budget,) = budgets_of(cell(), [replace(FACTS, edge=0.55, watch_s=0.02)], [0.0], [5.7])
    assert any("0x607D" in s and "0.55" in s for s in budget.said(linear=False))


def cell(**axis: object) -> CellConfig:
    config = load_config(Path(__file__).parents[3] / "configs" / "case-study.yaml")
    first = config.axes[0].model_copy(update=axis)
    limits = first.limits.model_copy(update={"stopping_room": None})
    return config.model_copy(update={"axes": [first.model_copy(update={"limits": limits})]})
