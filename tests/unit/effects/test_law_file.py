"""A law without a name as an effect file sits where the law was found, and has its shape."""

from pathlib import Path

import numpy as np
import pytest

from invid.effects.effect import PlaceMotion
from invid.effects.effect_files import load_effects
from invid.effects.law_file import law_file
from invid.model.document import EffectTerm
from invid.model.law_table import LawTable
from invid.model.plant import Structure

KNOWN = ((0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.01))


def law(over: str, element: str | None, other: str | None = None) -> EffectTerm:
    table = LawTable(over, (-1.0, 0.0, 2.0), "rad", (-4.0, 0.0, 2.0), "N·m", KNOWN)
    return EffectTerm("empirical_law", "A1", {}, element, other, table)


@pytest.mark.parametrize(
    ("term", "kind"),
    [(law("position", "mass 2"), "mass"), (law("deflection", "spring 1"), "spring"),
     (law("deflection", None, "A2"), "pair")],
    ids=["mass", "spring", "pair"],
)  # fmt: skip
def test_its_places_are_of_the_kind_where_the_law_was_found(
    term: EffectTerm, kind: str, tmp_path: Path
) -> None:
    file = tmp_path / "bump.py"
    file.write_text(law_file("bump", term), encoding="utf-8")
    (effect,) = load_effects(file)
    assert {p.kind for p in effect.places(Structure((2, 2), ("A1", "A2")))} == {kind}
    still = np.zeros(4)
    shape = effect.resistance(PlaceMotion(np.array([-1.0, 0.0, 2.0, 3.0]), still, still), ())
    assert shape[:3, 0] == pytest.approx([-1.0, 0.0, 0.5])
    slope = shape[3, 0] - shape[2, 0]  # straight beyond its knots
    assert effect.resistance(PlaceMotion(np.array([4.0]), still[:1], still[:1]), ())[0, 0] == pytest.approx(
        shape[3, 0] + slope
    )
