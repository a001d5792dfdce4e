"""Screening against an accepted model: nothing found where nothing changed, and only that which did."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from invid.comparison.screening import changed_parts, part_of, screen
from invid.config import CellConfig, load_config
from invid.errors import ModelError
from invid.identification.identify import identify
from invid.model.document import Model, parameter_vector
from invid.planning import Plan
from invid.planning.belief import from_model, guess
from invid.planning.goal import plan_for_goal
from invid.recording import read_recording
from invid_drivers.foretelling import sensor_noise
from invid_drivers.measurement import measure_to_file
from invid_drivers.rescreening import part_axes, screen_cell, screening_plan
from invid_drivers.simulated import truth

CONFIG = Path(__file__).parents[3] / "configs" / "case-study.yaml"
NAMES = (
    "A1.mass.1",
    "A1.mass.2",
    "A1.spring.1",
    "A2.mass.1",
    "A2.mass.2",
    "A2.spring.1",
    "A1-A2.coupling",
)


def cell(seed: int, tool: float = 6.0, coupling: float = 1.0) -> CellConfig:
    """The case study with its tool mass on A2 and its coupling of A1 and A2 as given."""
    base = load_config(CONFIG)
    plant, names = truth(base), [a.name for a in base.axes]
    masses = [list(map(float, m)) for m in plant.masses]
    masses[1][2] = tool
    document = base.model_dump(mode="python")
    document["simulation"] |= {
        "seed": seed,
        "plant": {
            "branches": [
                {
                    "axis": names[i],
                    "masses": masses[i],
                    "springs": plant.springs[i].tolist(),
                    "dampers": plant.dampers[i].tolist(),
                }
                for i in range(3)
            ],
            "couplings": [
                {
                    "between": [names[i], names[j]],
                    "value": coupling if (i, j) == (0, 1) else float(plant.couplings[i, j]),
                }
                for i in range(3)
                for j in range(i + 1, 3)
            ],
        },
    }
    return CellConfig.model_validate(document)


@pytest.fixture(scope="module")
def accepted(tmp_path_factory: pytest.TempPathFactory) -> Model:
    config, path = cell(1), tmp_path_factory.mktemp("accepted") / "r.h5"
    belief = guess(config)
    assert belief is not None
    plan = plan_for_goal(config, belief, sensor_noise(config), 1e-3).plan
    measure_to_file(config, path, plan=plan.first(1))
    return identify(read_recording(path), masses=(3, 3, 3))


@pytest.fixture(scope="module")
def short(accepted: Model) -> Plan:
    config = cell(1)
    return screening_plan(config, from_model(accepted, config), sensor_noise(config)).plan


@pytest.mark.campaign
def test_an_unchanged_cell_is_said_to_be_unchanged_after_seconds(
    accepted: Model, short: Plan, tmp_path: Path
) -> None:
    assert short.shaking_s < 10
    measure_to_file(cell(2), tmp_path / "r.h5", plan=short)
    found = screen(read_recording(tmp_path / "r.h5"), accepted)
    assert found.verdict == "unchanged"
    assert found.parts == ()
    assert np.median(found.detectable) < 0.03
    assert "nothing changed" in found.sentence


@pytest.mark.campaign
def test_a_heavier_tool_on_a2_names_a2_and_all_are_shaken_where_holding_the_others_takes_their_torque(
    accepted: Model, tmp_path: Path
) -> None:
    config, path = cell(3, tool=6.6), tmp_path / "r.h5"
    found = screen_cell(config, accepted, path, noise=sensor_noise(config))
    assert found.screening.parts == ("A2",)
    # What the drives' holds would need on A1 and A3 leaves A2 a fortieth of its torque.
    assert found.axes == ("A1", "A2", "A3")
    assert found.duration_s < 100
    assert found.model is not None
    assert found.model.chains.masses[1][2] == pytest.approx(6.6, rel=0.005)
    # everything else stays as well known as it was, and true
    names, values = parameter_vector(found.model.chains)
    wanted = parameter_vector(replace(truth(config), ground_dampers=np.zeros(3)))[1]
    judged = np.array([".damper." not in n for n in names])
    assert np.abs(values / wanted - 1)[judged].max() < 0.01
    kept = accepted.covariance
    assert kept is not None
    assert found.model.covariance is not None
    other = [k for k, n in enumerate(names) if part_of(n) != "A2" and judged[k]]
    place = [accepted.parameter_names.index(names[k]) for k in other]
    assert np.all(np.diag(found.model.covariance)[other] <= np.diag(kept)[place] * 1.0001)
    recording = read_recording(path)
    assert recording.experiments[0].excited_axis == -1
    assert {e.excited_axis for e in recording.experiments[1:]} == {-1}


@pytest.mark.campaign
def test_a_changed_coupling_is_measured_again_on_its_two_axes_in_the_band_that_tells_about_it(
    accepted: Model, tmp_path: Path
) -> None:
    config, path = cell(4, coupling=1.5), tmp_path / "r.h5"
    found = screen_cell(config, accepted, path, noise=sensor_noise(config), goal=0.01)
    assert found.screening.parts == ("A1-A2",)
    assert found.axes == ("A1", "A2")
    assert found.model is not None
    assert found.model.chains.couplings[0, 1] == pytest.approx(1.5, abs=0.02)
    low, high = found.band_hz or (0.0, 0.0)
    # The config's band is 0.5 to 12 Hz; a coupling is told by what passes from one axis to the other.
    assert high - low < 0.8 * 11.5
    screening, *again = read_recording(path).experiments
    assert screening.excited_axis == -1
    assert again
    for experiment in again:
        lines = experiment.frequencies_hz
        assert low <= lines.min()
        assert lines.max() <= high
        demand = experiment.torque_demand
        assert demand is not None
        hz = np.fft.rfftfreq(experiment.samples, 1 / experiment.sample_rate_hz)
        power = np.abs(np.fft.rfft(demand, axis=0)) ** 2
        # A quarter of a second of ramp at each end smears the lines by some hertz.
        inside = (hz > low - 1.0) & (hz < high + 1.0)
        shaken = power[:, :2].sum()
        assert power[inside, :2].sum() > 0.95 * shaken
        assert power[:, 2].sum() < 0.02 * shaken  # A3 is held, not shaken


def test_a_model_without_covariance_or_of_another_cell_is_refused(accepted: Model) -> None:
    config = cell(1)
    recording = replace(_empty(config), axes=("X", "Y", "Z"))
    with pytest.raises(ModelError, match="its own model"):
        screen(recording, accepted)
    with pytest.raises(ModelError, match="no covariance"):
        screen(_empty(config), replace(accepted, covariance=None, parameter_names=()))


def _empty(config: CellConfig):  # type: ignore[no-untyped-def]
    from invid.recording import Recording

    return Recording("r", tuple(a.name for a in config.axes), "rad", "N·m", "2026-01-01T00:00:00Z", ())


def spread() -> np.ndarray:
    rng = np.random.default_rng(0)
    mix = np.eye(7) + 0.6 * rng.standard_normal((7, 7))
    return mix @ mix.T


def test_chance_alone_refutes_once_in_a_thousand() -> None:
    rng, covariance = np.random.default_rng(1), spread()
    draws = rng.multivariate_normal(np.zeros(7), covariance, size=4000)
    alarms = sum(changed_parts(NAMES, d, covariance) != () for d in draws)
    # 4 expected; 13 or more once in five thousand campaigns
    assert 0 < alarms < 13


@pytest.mark.parametrize(
    ("moved", "parts"),
    [
        ({1: 40.0}, ("A1",)),
        ({4: -40.0, 5: 30.0}, ("A2",)),
        ({6: 50.0}, ("A1-A2",)),
        ({0: 50.0, 4: 60.0}, ("A1", "A2")),
    ],
)
def test_the_fewest_parts_that_explain_the_change_are_named(
    moved: dict[int, float], parts: tuple[str, ...]
) -> None:
    rng, covariance = np.random.default_rng(2), spread()
    shift = np.zeros(7)
    shift[list(moved)] = list(moved.values())
    found = [
        changed_parts(NAMES, shift + rng.multivariate_normal(np.zeros(7), covariance), covariance)
        for _ in range(50)
    ]
    assert found.count(parts) >= 48


def test_parts_are_branches_and_couplings_whatever_the_axes_are_called() -> None:
    assert part_of("arm.2.mass.3") == "arm.2"
    assert part_of("a-b-c.coupling") == "a-b-c"
    assert part_axes("a-b-c", ("a-b", "c")) == ("a-b", "c")
    assert part_axes("A2", ("A1", "A2")) == ("A2",)
