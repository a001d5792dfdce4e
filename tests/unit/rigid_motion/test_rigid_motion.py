"""Large motions: an axis integrated here, by other code than the one under test."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from large_motion import RATE, Force, experiment, recording, simulate

from invid.cli.app import run
from invid.diagnosis.rigid import diagnose_trajectory
from invid.model.diagnosis_document import Verdict, diagnosis_to_json, load_model
from invid.model.document import dump_json
from invid.recording import Kind, write_recording
from invid.rigid_motion.model import identify_trajectory
from invid.rigid_motion.record_kind import is_trajectory
from invid.simulation.run import simulate as simulated


def test_a_plain_mass_with_noise_is_consistent_and_nothing_is_named():
    for seed in range(4):
        diagnosis = diagnose_trajectory(recording(simulate(np.random.default_rng(seed))))
        assert diagnosis.verdict is Verdict.CONSISTENT, (seed, diagnosis.sentences)
        assert not diagnosis.findings
        mass = diagnosis.model.chains.masses[0][0]
        assert mass == pytest.approx(0.5, rel=0.01)
        # The command is held over the sample: half of it is the mean lag.
        offset = diagnosis.model.fit["time_offset_s"]["A1.time_offset"]
        assert offset["value"] == pytest.approx(0.5 / RATE, abs=0.1 / RATE)


def ripple(q: float, v: float, t: float) -> float:
    return 0.6 * np.sin(23.0 * q + 0.3)


approx = pytest.approx
RIPPLE = {
    "torque": approx(0.6, rel=0.05),
    "cycles_per_rev": approx(23.0, rel=2e-3),
    "phase": approx(0.3, abs=0.05),
}
DRY = {"coulomb_friction": {"torque": approx(0.8, rel=0.05)}}


@pytest.mark.parametrize(
    ("seed", "machine", "named"),
    [
        (1, {"dry": (1.0, 1.0), "wet": (0.6, 0.6)}, {
            "coulomb_friction": {"torque": approx(1.0, rel=0.03)},
            "viscous_friction": {"coefficient": approx(0.6, rel=0.05)},
        }),
        (2, {"dry": (1.5, 0.8), "wet": (0.3, 0.9)}, {"asymmetric_friction": {
            "coulomb_positive": approx(1.5, rel=0.05), "coulomb_negative": approx(0.8, rel=0.08),
            "viscous_positive": approx(0.3, abs=0.08), "viscous_negative": approx(0.9, abs=0.08),
        }}),
        (4, {"extra": lambda q, v, t: 3.0 * np.sin(q + 0.4), "stroke": 1.5}, {
            "gravity": {"torque": approx(3.0, rel=0.03), "angle": approx(0.4, abs=0.03)},
        }),
        (5, {"extra": ripple}, {"cogging": RIPPLE}),
        (5, {"extra": ripple, "dry": (0.8, 0.8)}, {"cogging": RIPPLE, **DRY}),
    ],
    ids=["friction", "friction by direction", "gravity", "ripple", "ripple beside friction"],
)  # fmt: skip
def test_what_acts_is_named_with_its_sizes_and_nothing_else(
    seed: int, machine: dict[str, Any], named: dict[str, dict[str, Any]]
):
    diagnosis = diagnose_trajectory(recording(simulate(np.random.default_rng(seed), **machine)))
    found = {f.cause: {name: p.value for name, p in f.effect.parameters.items()} for f in diagnosis.findings}
    assert found.keys() == named.keys()
    for cause, sizes in named.items():
        assert {name: found[cause][name] for name in sizes} == sizes
    assert diagnosis.model.chains.masses[0][0] == approx(0.5, rel=0.02)
    assert diagnosis.explained_fraction > 0.95


@pytest.mark.parametrize(
    "extra",
    [
        lambda q, v, t: 0.8 * np.sin(2 * np.pi * 3.1 * t),
        lambda q, v, t: 0.8 * (t > 11.3) * np.sin(2 * np.pi * 1.3 * t),
    ],
    ids=["hum over time", "hum that starts late"],
)
def test_what_is_outside_the_catalogue_is_left_unnamed(extra: Force):
    diagnosis = diagnose_trajectory(recording(simulate(np.random.default_rng(5), extra=extra)))
    assert not diagnosis.findings, diagnosis.sentences
    assert diagnosis.verdict is Verdict.UNEXPLAINED
    assert diagnosis.unexplained is not None
    assert diagnosis.unexplained.axis == "A1"


def test_a_smooth_law_of_position_is_no_cogging_and_has_no_name():
    """Two periods on the travel: any law of position is as good."""
    slow = simulate(np.random.default_rng(5), extra=lambda q, v, t: 0.6 * np.sin(5.0 * q + 0.3), stroke=1.2)
    (law,) = diagnose_trajectory(recording(slow)).findings
    table = law.effect.table
    assert (law.cause, table.over) == ("empirical_law", "position")
    assert np.array(table.value) == pytest.approx(0.6 * np.sin(5.0 * np.array(table.at) + 0.3), abs=0.1)


def test_a_drag_at_one_place_of_the_travel_is_a_law_over_velocity_and_position():
    def drag(q, v):
        return 1.5 * np.exp(-(((q - 0.3) / 0.4) ** 2)) * v

    worn = recording(simulate(np.random.default_rng(5), extra=lambda q, v, t: drag(q, v)))
    diagnosis = diagnose_trajectory(worn)
    assert diagnosis.verdict is Verdict.PARTLY_EXPLAINED
    (law,) = diagnosis.findings
    table = law.effect.table
    assert (law.cause, table.quantities) == ("empirical_law", ("velocity", "position"))
    v, q = np.meshgrid(table.at, table.across_at, indexing="ij")
    seen = (np.abs(v) < 0.5 * v.max()) & (np.abs(q) < 0.7 * q.max())
    assert np.reshape(table.value, v.shape)[seen] == pytest.approx(drag(q, v)[seen], abs=0.3)
    errors = [
        np.std(simulated(m, worn).experiments[0].torque - worn.experiments[0].torque)
        for m in (replace(diagnosis.model, effects=()), diagnosis.model)
    ]
    assert errors[1] < 0.2 * errors[0]


def test_constant_speeds_show_stribeck_friction_and_say_that_the_inertia_is_unknown():
    rng = np.random.default_rng(7)
    experiments = []
    for k, speed in enumerate([s * d for s in np.geomspace(0.3, 30, 14) for d in (1, -1)]):
        time = np.arange(400) / 100.0
        friction = np.sign(speed) * (2.0 + 1.2 * np.exp(-((speed / 3.0) ** 2))) + 0.05 * speed
        velocity = speed + 0.1 * rng.standard_normal(time.size)
        position = np.concatenate(([0.0], np.cumsum(velocity[:-1] * 0.01)))
        torque = friction + 0.3 * rng.standard_normal(time.size)
        experiments.append(
            experiment(
                time,
                position[:, None],
                torque[:, None],
                Kind.CONSTANT_VELOCITY,
                f"{k:03d}",
                attributes={"position_source": "integrated_velocity"},
            )
        )
    data = recording(*experiments)
    assert is_trajectory(data)
    diagnosis = diagnose_trajectory(data)
    found = {f.effect.cause: f.effect for f in diagnosis.findings}
    assert {"stribeck_friction", "viscous_friction"} == set(found)
    effect = found["stribeck_friction"]
    assert effect.value("static") == pytest.approx(3.2, rel=0.05)
    assert effect.value("coulomb") == pytest.approx(2.0, rel=0.05)
    assert effect.value("velocity") == pytest.approx(3.0, rel=0.2)
    assert effect.parameters["exponent"].std == 0.0  # tried, not fitted
    assert np.isnan(diagnosis.model.std.masses[0][0])
    assert any("no inertia" in w for w in diagnosis.warnings)


def test_the_diagnosis_is_strict_json_with_its_torque_errors():
    rng = np.random.default_rng(10)
    diagnosis = diagnose_trajectory(recording(simulate(rng, dry=(1.0, 1.0), seconds=10)))
    document = diagnosis_to_json(diagnosis)
    dump_json(document)
    errors = document["details"]["relative_torque_error_percent_all_axes"]
    assert 0 < errors["fit"] <= errors["held_out_with_one_force_while_standing"] < 10


def test_the_commands_take_a_large_motion_to_a_rigid_model_and_back(tmp_path):
    rng = np.random.default_rng(11)
    data = recording(simulate(rng, dry=(1.0, 1.0), wet=(0.6, 0.6), seconds=10))
    write_recording(data, tmp_path / "rec.h5")
    model, diagnosis = tmp_path / "model.json", tmp_path / "diagnosis.json"
    assert run(["identify", str(tmp_path / "rec.h5"), "-o", str(model)]) == 0
    assert load_model(model).method == "trajectory"
    # A model given by the caller does not send the record to the diagnosis of resonances.
    assert run(["diagnose", str(tmp_path / "rec.h5"), "--model", str(model), "-o", str(diagnosis)]) == 0
    assert '"coulomb_friction"' in diagnosis.read_text(encoding="utf-8")


def test_a_rigid_model_simulates_the_experiments_asked_for_alone():
    (one,) = recording(simulate(np.random.default_rng(0))).experiments
    data = recording(one, replace(one, key="001"))
    answer = simulated(identify_trajectory(data), data, only=["001"])
    assert [e.key for e in answer.experiments] == ["001"]


def test_dry_friction_that_gives_before_it_slides_is_named_with_its_stiffness():
    """A slider of 60 N·m/rad that slides at 1.2 N·m: most of the record's reversals lie within its travel."""
    last, z = 0.0, 0.0

    def slider(q: float, v: float, t: float) -> float:
        nonlocal last, z
        z, last = min(max(z + q - last, -0.02), 0.02), q
        return 60.0 * z

    data = recording(simulate(np.random.default_rng(5), extra=slider, wet=(0.4, 0.4), stroke=0.2))
    diagnosis = diagnose_trajectory(data)
    found = {f.effect.cause: f.effect for f in diagnosis.findings}
    assert set(found) == {"presliding_friction", "viscous_friction"}
    assert found["presliding_friction"].value("torque") == pytest.approx(1.2, rel=0.05)
    assert found["presliding_friction"].value("stiffness") == pytest.approx(60.0, rel=0.2)
    errors = diagnosis.details["relative_torque_error_percent"]["A1"]
    assert errors["held_out_with_one_force_while_standing"] == pytest.approx(errors["fit"], rel=0.5)
