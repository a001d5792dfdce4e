"""Which of two nested causes leads."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from invid.diagnosis.search import _rank_candidates
from invid.effects.catalogue.coulomb_friction import CoulombFriction
from invid.effects.catalogue.stribeck_friction import StribeckFriction
from invid.model.place import Place


def _trial(effect: Any, axis: int, training: float, held: float) -> Any:
    term = SimpleNamespace(
        effect=effect, place=Place("mass", axis, 1), size=3 - 2 * (effect.main == "torque")
    )
    cost = training + held
    return SimpleNamespace(
        term=term,
        fit=SimpleNamespace(cost=training),
        held=SimpleNamespace(cost=held),
        cost=cost,
        dispersion=max(1.0, cost / 110.0),
    )


@pytest.mark.parametrize(
    ("axis", "gain", "first"),
    [
        (0, 4.0, "coulomb_friction"),  # noise gives that to two parameters more often than not
        (0, 20.0, "stribeck_friction"),
        (1, 4.0, "stribeck_friction"),  # on another axis it contains nothing
    ],
)
def test_a_larger_friction_model_leads_only_where_the_training_records_ask_for_it(
    axis: int, gain: float, first: str
) -> None:
    dry = _trial(CoulombFriction(), 0, 50.0, 60.0)
    sticks = _trial(StribeckFriction(), axis, 50.0 - gain, 48.0)  # held-out chance is kind to it
    ranked = _rank_candidates([(dry, dry.cost + 4.0), (sticks, sticks.cost + 12.0)], frozenset())
    assert ranked[0][0].term.effect.cause == first
    assert [s for _, s in ranked] == sorted(s for _, s in ranked)


def test_what_a_smaller_friction_model_misses_by_far_is_no_measure_of_what_the_larger_must_gain() -> None:
    """Of exact records the larger model gained thirty of thirty-one, and was put behind for the rest."""
    dry = _trial(CoulombFriction(), 0, 550_000.0, 12_700_000.0)
    sticks = _trial(StribeckFriction(), 0, 14_000.0, 2_600_000.0)
    ranked = _rank_candidates([(dry, 1200.0), (sticks, 250.0)], frozenset())
    assert ranked[0][0] is sticks
