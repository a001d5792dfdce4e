"""A law over two quantities: its table in a document, its surface, its file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from invid.effects.effect import PlaceMotion
from invid.effects.effect_files import load_effects
from invid.effects.law_file import law_file
from invid.effects.laws.empirical_law import surface_law
from invid.errors import InputError, ModelError
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, EffectTerm, Estimate, Model, model_from_json, model_to_json
from invid.model.law_table import LawTable
from invid.numerics.smooth_parts import smooth_parts
from invid.simulation.laws import laws_of

AT, ACROSS = np.linspace(-3.0, 3.0, 7), np.linspace(-1.5, 1.5, 13)


def drag(v: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Drag that grows with the square of the distance from a place."""
    return 0.4 * v * (1.0 + (q - 0.3) ** 2)


def law(over: str = "velocity", across: str = "position", element: str = "mass 1") -> EffectTerm:
    at, beside = (AT, ACROSS) if over == "velocity" else (ACROSS, AT)
    first, second = np.meshgrid(at, beside, indexing="ij")
    value = (drag(first, second) if over == "velocity" else drag(second, first)).ravel()
    known = tuple(tuple(row) for row in (1e-4 * np.eye(value.size)).tolist())
    table = LawTable(
        over, tuple(at), "rad/s", tuple(value), "N·m", known, across, tuple(beside.tolist()), "rad"
    )
    size = Estimate(float(np.abs(value).max()), 0.01, "N·m")
    return EffectTerm("empirical_law", "A1", {"torque": size}, element, None, table)


def model(*effects: EffectTerm) -> Model:
    chains = CoupledChains.build([[0.5, 0.2]], [[60.0]], [[0.05]], axes=("A1",))
    return Model("cell", "refined", chains, ChainStd.unknown(chains), effects=effects)


def test_its_table_comes_back_from_a_document() -> None:
    term = law()
    (again,) = model_from_json(json.loads(json.dumps(model_to_json(model(term))))).effects
    assert again == term
    assert again.table.quantities == ("velocity", "position")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda p: p["table"].pop("across_at"), "table"),
        (lambda p: p["table"]["value"].pop(), "as many"),
        (lambda p: p["table"]["across_at"].reverse(), "ascend"),
    ],
    ids=["no knots of the second", "a value short", "knots that descend"],
)
def test_a_table_that_is_none_is_refused(change, said: str) -> None:
    document = json.loads(json.dumps(model_to_json(model(law()))))
    change(document["effects"][0]["parameters"])
    with pytest.raises(ModelError, match=said):
        model_from_json(document)


def test_two_quantities_that_do_not_go_together_are_refused_in_words() -> None:
    with pytest.raises(ModelError, match="velocity and position or deflection and deflection rate"):
        laws_of(model().chains, (law(across="deflection"),))


def test_beyond_its_knots_it_stays_as_it_is_at_the_last() -> None:
    resistance = surface_law(AT, ACROSS, drag(*np.meshgrid(AT, ACROSS, indexing="ij")).reshape(-1, 1))
    far, edge = (resistance(np.array([v]), np.array([q])) for v, q in ((9.0, 5.0), (3.0, 1.5)))
    assert far == pytest.approx(edge)


@pytest.mark.parametrize(
    ("over", "across", "element"),
    [("velocity", "position", "mass 1"), ("deflection", "deflection rate", "spring 1")],
)
def test_its_file_has_its_shape(over: str, across: str, element: str, tmp_path: Path) -> None:
    term = law(over, across, element)
    file = tmp_path / "worn.py"
    file.write_text(law_file("worn", term), encoding="utf-8")
    (effect,) = load_effects(file)
    rng = np.random.default_rng(1)
    q, v = rng.uniform(-1.5, 1.5, 50), rng.uniform(-3.0, 3.0, 50)
    found = effect.resistance(PlaceMotion(q, v, np.zeros(50)), ())[:, 0] * term.value("torque")
    assert found == pytest.approx(drag(v, q), abs=0.02 * np.abs(drag(v, q)).max())


def test_a_file_whose_quantities_do_not_go_together_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "worn.py"
    text = law_file("worn", law()).replace('across = "position"', 'across = "deflection"')
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="across is 'deflection'"):
        load_effects(file)


def test_a_surface_goes_on_smoothly_where_no_row_sees_it() -> None:
    """Rows in one half of the first quantity: what they tell of a plane goes on as the plane."""
    rng = np.random.default_rng(2)
    u, w = rng.uniform(-3.0, 0.0, 400), rng.uniform(-1.5, 1.5, 400)
    columns = surface_law(AT, ACROSS, np.eye(AT.size * ACROSS.size))(u, w)
    first, second = np.meshgrid(AT, ACROSS, indexing="ij")
    shapes, x = smooth_parts(columns, u * w + 0.5 * u, 1e-9, 6, ACROSS.size)
    assert (shapes @ x).reshape(first.shape) == pytest.approx(first * second + 0.5 * first, abs=0.05)
