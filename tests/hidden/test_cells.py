"""Whole cells: friction on every axis and up to two faults; what is sure is named beside what is not."""

from typing import Any

import pytest

from hidden.generator import Truth, make_cell
from hidden.scoring import names
from invid.diagnosis.diagnose import diagnose
from invid.model.diagnosis_document import Diagnosis, Verdict

Causes = list[tuple[str, int, int, float]]
QUIET: dict[str, Any] = {
    "noise": 0.003, "drive": "smooth", "moves": False, "from_rest": False, "periods": 2,
}  # fmt: skip


def rubbing(axes: int = 1) -> Causes:
    """Dry and viscous friction of every motor."""
    return [
        (c, k, 1, db)
        for k in range(axes)
        for c, db in (("coulomb_friction", 30.0), ("viscous_friction", 22.0))
    ]


def gap(truth: Truth, found: Diagnosis) -> float:
    """Relative error of the free play."""
    true = next(e for e in truth.effects if e.cause == "backlash").parameters["gap"]
    return abs(next(f for f in found.findings if f.cause == "backlash").parameters["gap"].value / true - 1.0)


@pytest.mark.parametrize(
    ("faults", "masses", "seed"),
    [
        pytest.param(
            [("cogging", 0, 1, 20.0), ("backlash", 0, 1, 25.0)], (2,), 1, marks=pytest.mark.panel,
            id="free play beside a motor's ripple",
        ),
        pytest.param(
            [("backlash", 0, 1, 25.0), ("cubic_stiffness", 0, 2, 25.0)], (3,), 1,
            id="a stiffening spring behind free play",
        ),
        pytest.param(
            [("gravity", 0, 2, 30.0), ("cubic_stiffness", 0, 1, 25.0)], (2,), 1,
            id="a stiffening spring under a weight",
        ),
        pytest.param([("gravity", 0, 3, 30.0)], (3,), 2, id="a weight that does not choose the chain"),
        pytest.param([("backlash", 1, 1, 25.0)], (2, 2), 1, id="free play of one of two axes"),
    ],
)  # fmt: skip
def test_every_cause_of_a_cell_is_named_at_its_place_and_nothing_else(
    faults: Causes, masses: tuple[int, ...], seed: int
) -> None:
    recording, truth = make_cell([*rubbing(len(masses)), *faults], seed=seed, masses=masses, **QUIET)
    found = diagnose(recording)
    missed = [e for e in truth.effects if not any(names(e, f) for f in found.findings)]
    wrong = [f for f in found.findings if not any(names(e, f) for e in truth.effects)]
    assert (missed, wrong) == ([], [])
    assert found.verdict is Verdict.EXPLAINED
    assert max(r.after / (r.noise_floor or 1.0) for r in found.residual) <= 1.2
    assert not any("backlash" in fault for fault in faults) or gap(truth, found) < 0.02


def test_friction_is_named_beside_what_no_catalogue_has_and_the_rest_is_a_law_of_two_quantities() -> None:
    """A damping that changes with position, at 42 dB."""
    recording, truth = make_cell([*rubbing(), ("position_damping", 0, 2, 42.0)], seed=1, masses=(2,), **QUIET)
    found = diagnose(recording)
    assert found.verdict is Verdict.PARTLY_EXPLAINED
    assert {f.cause for f in found.findings} == {"coulomb_friction", "empirical_law"}
    law = next(f for f in found.findings if f.cause == "empirical_law").effect
    assert law.table is not None
    assert (law.element, set(law.table.quantities)) == ("mass 2", {"velocity", "position"})
    assert found.unexplained is not None
    assert found.unexplained.axis == truth.chains.axes[0]
    assert "even" in found.unexplained.character
    assert all(f.confidence < 0.9 for f in found.findings)
