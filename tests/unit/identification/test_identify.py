"""From recording to model, on plants simulated by code the estimator does not use."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from benchmarks.shared import plant_oracle as oracle
from invid.cli.identify import model_text
from invid.errors import InputError, NotIdentifiableError
from invid.identification.identify import identify
from invid.model.document import dump_json, model_from_json, model_to_json
from invid.recording.model import Experiment, Kind, Recording, Role

RATE = 1000.0
TWO = oracle.OraclePlant([[1.0, 2.0], [1.5, 1.0]], [[3000.0], [2500.0]], [[1.2], [1.0]], {(0, 1): 0.4})
TWO_TRUTH = {
    "A1.mass.1": 1.0, "A1.mass.2": 2.0, "A2.mass.1": 1.5, "A2.mass.2": 1.0,
    "A1.spring.1": 3000.0, "A2.spring.1": 2500.0, "A1-A2.coupling": 0.4,
}  # fmt: skip


def record(
    plant: oracle.OraclePlant,
    seed: int,
    *,
    peak: float = 20.0,
    period: int = 4000,
    periods: int = 3,
    settle: int = 1,
    band: tuple[float, float] = (0.5, 16.0),
    together: bool = False,
    in_drive: bool = False,
    noise: float = 0.005,
    linear: bool = False,
) -> Recording:
    """One experiment an axis (or all at once), the others held by PD."""
    rng = np.random.default_rng(seed)
    count = len(plant.masses)
    sums = np.array([sum(m) for m in plant.masses])
    gain, damping = np.full(count, 200.0), 2 * 0.5 * np.sqrt(200.0 * sums)
    experiments = []
    for number in range(count):
        demand = np.zeros((period * (settle + periods), count))
        for axis in range(count) if together else [number]:
            wave, hz = oracle.multisine(rng, period, RATE, band)
            demand[:, axis] = peak * np.tile(wave, settle + periods)
        position, torque = oracle.simulate(plant, demand, RATE, gain=gain, damping=damping, in_drive=in_drive)
        keep = slice(settle * period, None)
        step = 2 * np.pi / 2**19
        quantised = np.round(position[keep] / step) * step
        measured = torque[keep] + noise * peak * rng.standard_normal(quantised.shape)
        experiments.append(
            Experiment(
                f"{number:03d}",
                Kind.MULTISINE,
                Role.IDENTIFY,
                -1 if together else number,
                gain,
                period if settle + periods > 1 else 0,
                hz,
                RATE,
                np.arange(quantised.shape[0]) / RATE,
                quantised,
                measured,
            )
        )
    axes = tuple(f"A{i + 1}" for i in range(count))
    units = ("m", "N") if linear else ("rad", "N·m")
    return Recording("bench", axes, *units, "2026-11-21T00:00:00Z", tuple(experiments))


def estimates(document: dict) -> dict[str, tuple[float, float]]:
    out = {}
    for branch in document["branches"]:
        for kind in ("mass", "spring"):
            for q, e in enumerate(branch["masses" if kind == "mass" else "springs"]):
                out[f"{branch['axis']}.{kind}.{q + 1}"] = (e["value"], e["std"])
    for c in document["couplings"]:
        out["-".join(c["between"]) + ".coupling"] = (c["value"], c["std"])
    return out


def assert_true(document: dict, truth: dict[str, float], *, within: float, sigma: float = 4.0) -> None:
    found = estimates(document)
    assert found.keys() == truth.keys()
    for name, value in truth.items():
        got, std = found[name]
        assert got == pytest.approx(value, rel=within), name
        assert abs(got - value) < sigma * std, (name, got, std)


@pytest.mark.parametrize("together", [False, True])
def test_two_coupled_axes_are_identified_to_a_tenth_of_a_per_cent(together: bool) -> None:
    model = identify(record(TWO, 1, together=together), masses=(2, 2))
    assert model.fit["trustworthy"]
    assert_true(model_to_json(model), TWO_TRUTH, within=2e-3)


@pytest.mark.parametrize(("flaw", "said"), [("lost", "missing"), ("late", ""), ("period", "does not repeat")])
def test_lost_rows_jittered_instants_and_a_wrong_period_cost_nothing_unsaid(flaw: str, said: str) -> None:
    def spoiled(e: Experiment) -> Experiment:
        if flaw == "period":
            return replace(e, period_samples=3720)
        if flaw == "lost":
            rows = np.random.default_rng(2).permutation(np.arange(1, e.samples - 1))[: e.samples * 39 // 40]
            kept = np.r_[0, np.sort(rows), e.samples - 1]
            return replace(e, time=e.time[kept], position=e.position[kept], torque=e.torque[kept])
        late = np.clip(e.time + 3e-4 * np.sin(2 * np.pi * 6 * e.time), 0.0, e.time[-1])
        position, torque = (CubicSpline(e.time, x)(late) for x in (e.position, e.torque))
        return replace(e, time=late, position=position, torque=torque)

    whole = record(TWO, 1, together=True)
    model = identify(replace(whole, experiments=tuple(map(spoiled, whole.experiments))), masses=(2, 2))
    assert said in " ".join(model.warnings)
    assert_true(model_to_json(model), TWO_TRUTH, within=5e-3)


def test_one_axis_in_metres_is_identified_with_the_number_of_masses_found() -> None:
    slide = oracle.OraclePlant([[2.0, 3.0]], [[8000.0]], [[3.0]])
    model = identify(record(slide, 5, linear=True), masses="auto")
    document = model_to_json(model)
    assert document["units"] == {"mass": "kg", "stiffness": "N/m", "damping": "N·s/m"}
    assert document["fit"]["order"]["chosen"] == [2]
    assert_true(document, {"A1.mass.1": 2.0, "A1.mass.2": 3.0, "A1.spring.1": 8000.0}, within=5e-3)


def test_a_rigid_axis_is_one_mass() -> None:
    block = oracle.OraclePlant([[4.0]], [[]], [[]])
    model = identify(record(block, 6), masses="auto")
    assert model.chains.masses_per_branch == (1,)
    assert model.chains.masses[0][0] == pytest.approx(4.0, rel=2e-3)


def test_the_paper_method_gives_the_same_plant() -> None:
    model = identify(record(TWO, 7, together=True), masses=(2, 2), method="paper")
    assert model.method == "paper"
    found = estimates(model_to_json(model))
    for name, value in TWO_TRUTH.items():
        assert found[name][0] == pytest.approx(value, rel=0.002), name


def test_a_band_below_the_resonance_shows_one_mass_with_the_experiment_that_would_help() -> None:
    # Resonances of this plant lie at 10 and 11 Hz; nothing is excited above 1.2 Hz.
    weak = record(TWO, 8, band=(0.1, 1.2), noise=0.05, peak=2.0, period=20_000, periods=2)
    model = identify(weak, masses=(2, 2))
    assert model.chains.masses_per_branch == (1, 1)
    whole = [float(m.sum()) for m in model.chains.masses]
    assert whole == pytest.approx([3.0, 2.5], rel=0.03)
    assert any("masses 2, 2 were declared" in w and "excite higher frequencies" in w for w in model.warnings)


def test_fewer_equations_than_unknowns_are_refused_with_what_would_help() -> None:
    with pytest.raises(NotIdentifiableError, match="lengthen the period"):
        identify(record(TWO, 8, band=(0.25, 0.8)), masses=(2, 2))


def test_an_axis_that_is_never_excited_is_refused_by_name() -> None:
    full = record(TWO, 9)
    with pytest.raises(InputError, match="A2"):
        identify(replace(full, experiments=full.experiments[:1]), masses=(2, 2))


def test_the_model_survives_its_file_and_reads_as_a_table() -> None:
    model = identify(record(TWO, 12), masses=(2, 2))
    again = model_from_json(json.loads(dump_json(model_to_json(model))))
    assert again.parameter_names == model.parameter_names
    assert np.sqrt(np.diag(again.covariance)) == pytest.approx(np.sqrt(np.diag(model.covariance)))
    text = model_text(model)
    assert "A2 spring 1" in text
    assert "N·m/rad" in text
