"""What `compare` says about two models, and how often it is wrong."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stated_models import model_of, term

from invid.cli.app import run
from invid.comparison.changes import Comparison, Status
from invid.comparison.compare import compare
from invid.comparison.numbers import mean_model
from invid.errors import InputError
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, EffectTerm, Model, parameter_vector, save_model

MASSES = [[0.7, 2.0, 3.0], [4.0, 5.0, 6.0]]
SPRINGS = [[1000.0, 2000.0], [3000.0, 4000.0]]


def model(
    masses: list[list[float]] = MASSES, springs: list[list[float]] = SPRINGS, *effects: EffectTerm
) -> Model:
    dampers = [[0.5 for _ in k] for k in springs]
    return model_of(CoupledChains.build(masses, springs, dampers, 1.0 - np.eye(2)), None, 0.002, *effects)


def by_name(c: Comparison, name: str) -> Status:
    return next(x.status for x in c.parameters + c.effects if x.name == name)


def test_a_change_along_a_well_known_direction_of_correlated_parameters_is_seen_jointly() -> None:
    """Two masses known only badly apart, their sum very well: the sum changes by ten deviations."""
    old = model()
    names, values = parameter_vector(old.chains)
    a, b = names.index("A1.mass.1"), names.index("A1.mass.2")
    covariance = np.diag((0.002 * np.abs(values)) ** 2)
    spread = 0.2
    covariance[a, a] = covariance[b, b] = spread**2
    covariance[a, b] = covariance[b, a] = -0.9999 * spread**2
    masses = tuple(m.copy() for m in old.std.masses)
    masses[0][:2] = spread
    std = replace(old.std, masses=masses)
    old = replace(old, std=std, covariance=covariance, parameter_names=names)
    moved = model([[0.7 + 0.02, 2.0 + 0.02, 3.0], [4.0, 5.0, 6.0]])
    new = replace(moved, std=std, covariance=covariance, parameter_names=names)
    result = compare(old, new)
    assert not any(c.status is Status.CHANGED for c in result.parameters)
    assert by_name(result, "A1.mass.1") is by_name(result, "A1.mass.2") is Status.CANNOT_TELL
    assert result.sentences[0] == ("A1 motor mass or A1 mass 2 changed, the data do not tell which.")
    assert result.joint_p is not None
    assert result.joint_p < 1e-6
    assert not any(s.startswith("Nothing changed") for s in result.sentences)


def test_one_axis_scaled_as_a_whole_is_a_torque_scale_and_no_mechanical_change() -> None:
    scaled = model(
        [[0.7, 2.0, 3.0], [x * 1.06 for x in MASSES[1]]], [SPRINGS[0], [k * 1.06 for k in SPRINGS[1]]]
    )
    result = compare(model(), scaled)
    assert "torque scale" in result.sentences[0]
    assert "1.06" in result.sentences[0]
    assert not any("tool change" in s for s in result.sentences)


def test_another_number_of_masses_compares_the_whole_inertia() -> None:
    shorter = model([[0.7, 5.0], [4.0, 5.0, 6.0]], [[900.0], [3000.0, 4000.0]])
    result = compare(model(), shorter)
    assert any("A1 had 3 and now has 2 masses" in s for s in result.sentences)
    assert by_name(result, "A1.inertia") is Status.UNCHANGED
    assert not any(c.name == "A1.mass.1" for c in result.parameters)


def rippled(phase: float) -> Model:
    """A model with cogging whose phase is known to 0.02 rad."""
    sizes = {"torque": (0.5, 0.01), "cycles_per_rev": (24.0, 0.01), "phase": (phase, 0.02)}
    return model(MASSES, SPRINGS, term("cogging", "A1", "mass 1", **sizes))


def test_a_phase_that_went_past_half_a_turn_changed_by_the_short_way_round() -> None:
    result = compare(rippled(3.13), rippled(-3.13))
    (phase,) = (c for c in result.effects if c.name.endswith(".phase"))
    assert phase.difference == pytest.approx(2 * np.pi - 6.26)
    assert phase.status is not Status.CHANGED
    (mean,) = mean_model([rippled(3.13), rippled(-3.13)]).effects
    assert abs(mean.value("phase")) == pytest.approx(np.pi, abs=1e-3)


def test_models_of_different_robots_are_refused_with_the_reason() -> None:
    with pytest.raises(InputError, match="no axis in common"):
        compare(model(), replace(model(), chains=replace(model().chains, axes=("X", "Y"))))
    with pytest.raises(InputError, match=r"kg·m²"):
        compare(model(), replace(model(), linear=True))
    with pytest.raises(InputError, match="tolerance"):
        compare(model(), model(), tolerance=-1.0)


def test_the_command_prints_one_document_and_the_exit_status_of_the_contract(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new, blind = tmp_path / "old.json", tmp_path / "new.json", tmp_path / "blind.json"
    save_model(model(), old)
    save_model(model([[0.7, 2.0, 3.0], [4.0, 5.0, 7.31]]), new)
    save_model(replace(model(), std=ChainStd.unknown(model().chains)), blind)
    assert run(["compare", str(old), str(new), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["format"] == "invid-comparison"
    assert [p["parameter"] for p in document["parameters"] if p["status"] == "changed"] == ["A2.mass.3"]
    assert run(["compare", str(old), str(blind), "--json"]) == 3
    assert json.loads(capsys.readouterr().out)["warnings"]
    assert run(["compare", str(old), str(tmp_path / "none.json")]) == 2
    assert "no such file" in capsys.readouterr().err
