"""Causes hidden in chains of another integrator are found at their place with their size, nothing beside."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from unit.likelihood.chain_plant import ChainPlant

from invid.diagnosis.unknown_forces.elastic import diagnose_elastic
from invid.effects.registry import registered_effects
from invid.identification.begun import begin_elastic
from invid.model.diagnosis_document import Diagnosis, Verdict

SPRINGS = ("A1", "spring 1"), ("A2", "spring 1"), ("A2", "spring 2")
DRAG = Path(__file__).parents[2] / "effects" / "quadratic_drag.py"
FRICTION = {"coulomb_friction", "viscous_friction"}


def found(plant: ChainPlant, seed: int) -> tuple[Diagnosis, list[str]]:
    """The diagnosis, and which causes beside friction it names."""
    result = diagnose_elastic(begin_elastic(plant.recording(seed), plant.sizes))
    for axis in ("A1", "A2"):  # friction of every motor, with its size
        named = {f.cause: f for f in result.findings if f.axis == axis and f.cause in FRICTION}
        true = dict(zip(("coulomb_friction", "viscous_friction"), (plant.dry, plant.viscous), strict=True))
        for cause, sizes in true.items():
            size = next(iter(named[cause].parameters.values()))
            assert size.value == pytest.approx(sizes[int(axis[1]) - 1], rel=0.1)
    return result, [f.cause for f in result.findings if f.cause not in FRICTION]


def drawn(seed: int) -> ChainPlant:
    rng = np.random.default_rng(seed)
    share = rng.uniform(0.8, 1.25, 5)
    return ChainPlant(
        masses=((1.2 * share[0], 2.1 * share[1]), (1.6 * share[2], 1.1 * share[3], 2.4 * share[4])),
        dry=tuple(rng.uniform(0.2, 0.8, 2)), viscous=tuple(rng.uniform(0.5, 2.5, 2)),
    )  # fmt: skip


@pytest.mark.campaign
def test_friction_alone_hides_nothing_else() -> None:
    plant = drawn(11)
    result, others = found(plant, 11)
    assert others == []
    masses = np.concatenate(result.model.chains.masses)
    assert masses == pytest.approx(np.concatenate(plant.masses), rel=2e-3)


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [21, 22])
def test_free_play_is_found_in_its_spring_with_its_gap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    spring, gap = int(rng.integers(3)), float(np.exp(rng.uniform(np.log(1.5e-3), np.log(5e-3))))
    plant = ChainPlant(gaps={spring: gap})
    result, others = found(plant, seed)
    assert others == ["backlash"]
    finding = next(f for f in result.findings if f.cause == "backlash")
    assert (finding.axis, finding.element) == SPRINGS[spring]
    assert finding.parameters["gap"].value == pytest.approx(gap, rel=0.05)
    assert finding.confidence > 0.9


@pytest.mark.campaign
def test_beside_free_play_the_records_kept_out_are_smoothed_until_they_stand() -> None:
    """At six tenths of the amplitude 7.3 floors were left of a gap known to a thousandth."""
    result, others = found(ChainPlant(gaps={0: 3e-3}), 42)
    assert others == ["backlash"]
    assert all(r.after < 3.0 * r.floor for r in result.residual)
    assert result.verdict is Verdict.EXPLAINED


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [31, pytest.param(32, marks=pytest.mark.campaign)])
def test_a_hardening_spring_is_found_with_its_coefficient(seed: int) -> None:
    rng = np.random.default_rng(seed)
    spring, share = int(rng.integers(3)), float(np.exp(rng.uniform(np.log(500.0), np.log(2000.0))))
    stiffness = np.concatenate(ChainPlant().springs)[spring]
    plant = ChainPlant(cubes={spring: stiffness * share})
    result, others = found(plant, seed)
    assert others == ["cubic_stiffness"]
    finding = next(f for f in result.findings if f.cause == "cubic_stiffness")
    assert (finding.axis, finding.element) == SPRINGS[spring]
    assert finding.parameters["coefficient"].value == pytest.approx(stiffness * share, rel=0.1)


@pytest.mark.campaign
def test_a_cause_in_a_file_of_its_own_is_found_by_its_law() -> None:
    plant = ChainPlant(drag=(0.0, 12.0), viscous=(1.1, 0.0))
    with registered_effects([DRAG]):
        result = diagnose_elastic(begin_elastic(plant.recording(41), plant.sizes))
    finding = next(f for f in result.findings if f.cause == "quadratic_drag")
    assert (finding.axis, finding.element) == ("A2", "mass 1")
    assert finding.parameters["coefficient"].value == pytest.approx(12.0, rel=0.05)
    assert finding.parameters["coefficient"].unit == "N·m·s²/rad²"


@pytest.mark.campaign
def test_a_drag_of_the_square_of_the_speed_is_no_viscous_friction() -> None:
    """Seen at one amplitude it is nearly that: it was named so, beside Stribeck friction, at 0.999."""
    plant = ChainPlant(drag=(0.0, 1.5), viscous=(1.1, 0.0))
    result = diagnose_elastic(begin_elastic(plant.recording(42), plant.sizes))
    causes = {(f.cause, f.axis) for f in result.findings}
    assert {c for c, axis in causes if axis == "A2"} == {"coulomb_friction", "empirical_law"}
    assert ("viscous_friction", "A1") in causes
