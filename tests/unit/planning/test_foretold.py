"""What a plan says that it would show and how well, and runs that are no longer than that asks for."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from invid.config import CellConfig
from invid.errors import ModelError
from invid.identification.identify import identify
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, EffectTerm, Estimate, Model, parameter_vector
from invid.planning import Plan, make_plan
from invid.planning.belief import Belief, from_model
from invid.planning.detection import DetectionLimit, detection_limits
from invid.planning.expected_covariance import expected, fit_about
from invid.planning.goal import reached, shortest_runs
from invid.planning.screening import screening_plan
from invid.recording import read_recording
from invid_drivers.connect import connect
from invid_drivers.measurement import run_measurement
from invid_drivers.simulated import truth
from invid_drivers.simulated.config import sensor_noise


@pytest.fixture(scope="module")
def limits(cell: CellConfig, belief: Belief) -> dict[tuple[str, str], DetectionLimit]:
    plan = make_plan(cell, model=belief)
    found = detection_limits(cell, plan.recorded, belief, sensor_noise(cell))
    return {(limit.cause, limit.axis): limit for limit in found}


def test_the_default_plan_shows_the_frictions_of_the_case_study_and_free_play_below_what_is_sold_as_low(
    limits: dict[tuple[str, str], DetectionLimit], cell: CellConfig
) -> None:
    # what `bench_plan.py` then finds in twenty of twenty recordings
    for axis, dry, viscous in (("A1", 0.1, 0.1), ("A2", 0.2, 0.2), ("A3", 0.4, 0.4)):
        assert limits["coulomb_friction", axis].size < 0.6 * dry
        assert limits["viscous_friction", axis].size < viscous
        assert limits["backlash", axis].size < cell.sizes_of_interest.free_play
    assert {limit.unit for limit in limits.values()} == {"N·m", "N·m·s/rad", "rad", "kg·m²"}


@pytest.mark.campaign
def test_runs_are_no_longer_than_what_is_of_interest_asks_for(cell: CellConfig, belief: Belief) -> None:
    def seconds(**sizes: float) -> float:
        interest = cell.sizes_of_interest.model_copy(update=sizes)
        wanted = cell.model_copy(update={"sizes_of_interest": interest})
        return shortest_runs(wanted, belief, sensor_noise(cell)).period_s

    coarse = dict.fromkeys(("dry_friction", "viscous_friction", "mode", "free_play"), 1.0)
    assert seconds(**coarse) == 5.0
    assert 5.0 < seconds(**(coarse | {"viscous_friction": 0.005})) < 10.5
    assert seconds(**(coarse | {"viscous_friction": 0.001})) == 10.5


@pytest.mark.campaign
def test_records_show_about_what_was_foretold_of_them(
    limits: dict[tuple[str, str], DetectionLimit], cell: CellConfig, belief: Belief
) -> None:
    plan = make_plan(cell, model=belief)
    _, recording = fit_about(cell, plan.recorded, belief, sensor_noise(cell))
    found = reached(recording, (3, 3, 3), interests=cell)
    assert found.trustworthy
    for limit in found.limits:
        assert 0.5 < limit.size / limits[limit.cause, limit.axis].size < 2.0
    assert found.shown == sum(limit.is_met for limit in found.limits)
    assert found.meets(0.01) == (found.shown == len(found.limits))
    assert not found.meets(1e-6)


@pytest.fixture(scope="module")
def one_block(cell: CellConfig, belief: Belief) -> Plan:
    return screening_plan(cell, belief, sensor_noise(cell)).first(1)


@pytest.mark.campaign
def test_expected_and_actual_scatter_agree_in_the_simulated_cell(
    cell: CellConfig, belief: Belief, one_block: Plan, tmp_path: Path
) -> None:
    foretold = expected(cell, one_block, belief, sensor_noise(cell))
    found, stated = [], []
    for seed in range(5):
        document = cell.model_dump(mode="python")
        document["simulation"]["seed"] = 40 + seed
        config = CellConfig.model_validate(document)
        path = tmp_path / f"{seed}.h5"
        run_measurement(config, one_block, connect(config), path)
        model = identify(read_recording(path), masses=(3, 3, 3))
        assert model.covariance is not None
        found.append(parameter_vector(model.chains)[1])
        stated.append(np.sqrt(np.diag(model.covariance)))
    scatter = (np.array(found) - np.mean(found, axis=0)) / foretold.std * np.sqrt(5 / 4)
    ratio = float(np.sqrt(np.mean(scatter[:, foretold.goal] ** 2)))
    # 4 degrees of freedom for each of 18 correlated parameters: good to some 15 %
    assert 0.7 < ratio < 1.5
    # and beside what the estimator states from the records themselves, whose climb is a little stronger
    assert np.all(np.abs(np.log(np.median(stated, axis=0) / foretold.std)) < np.log(1.35))


def test_deviations_are_foretold_as_records_of_quiet_sensors_then_state_them(
    cell: CellConfig, belief: Belief
) -> None:
    plan = make_plan(cell, model=belief)
    usual, share = sensor_noise(cell), 0.01
    noise = replace(
        usual,
        position=share * usual.position,
        position_step=share * usual.position_step,
        torque=share * usual.torque,
        torque_step=share * usual.torque_step,
    )
    foretold = expected(cell, plan, belief, noise)
    _, recording = fit_about(cell, plan.recorded, belief, noise)
    model = identify(recording, masses=(3, 3, 3))
    assert model.covariance is not None
    stated = np.sqrt(np.diag(model.covariance))
    ratio = (foretold.std / stated)[foretold.goal]
    assert 0.7 < np.median(ratio) < 1.4, ratio
    assert np.all(np.abs(np.log(ratio)) < np.log(2.5)), ratio


def test_a_mass_that_nothing_reaches_is_said_to_be_unseen(cell: CellConfig, belief: Belief) -> None:
    plan = make_plan(cell, axes=["A1"])
    lonely = replace(belief, chains=replace(belief.chains, couplings=np.zeros((3, 3))))
    # the other axes stand still in their holds: nothing is learnt of what is behind them
    found = expected(cell, plan, lonely, sensor_noise(cell))
    by_name = dict(zip(found.names, found.relative, strict=True))
    assert by_name["A1.mass.3"] < 0.01
    assert not by_name["A3.mass.3"] < 1.0
    assert found.to_json()["worst"]["name"].startswith(("A2", "A3"))


def test_friction_of_an_accepted_model_is_part_of_the_belief(cell: CellConfig) -> None:
    chains = truth(cell)
    model = Model(
        "r",
        "refined",
        chains,
        ChainStd.unknown(chains),
        effects=(
            EffectTerm("coulomb_friction", "A2", {"torque": Estimate(0.3)}, element="mass 1"),
            EffectTerm("viscous_friction", "A3", {"coefficient": Estimate(0.7)}, element="mass 1"),
        ),
    )
    belief = from_model(model, cell)
    assert belief.coulomb.tolist() == [0, 0.3, 0]
    # the simulated plant's own ground dampers (0.1, 0.2 and 0.4) are counted once
    assert belief.viscous == pytest.approx([0.1, 0.2, 1.1])
    assert not belief.chains.ground_dampers.any()
    other = CoupledChains.build([[1.0]], [[]], axes=["X"])
    with pytest.raises(ModelError, match="the model of"):
        from_model(Model("r", "refined", other, ChainStd.unknown(other)), cell)
