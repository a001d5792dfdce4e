"""A law over two quantities: its table in a document, its surface, its file."""

import json
from pathlib import Path

import numpy as np
import pytest

from invid.effects.effect_files import load_effects
from invid.effects.law_file import law_file
from invid.errors import InputError, ModelError
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, EffectTerm, Estimate, Model, model_from_json, model_to_json
from invid.model.law_table import LawTable

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


def test_a_file_whose_quantities_do_not_go_together_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "worn.py"
    text = law_file("worn", law()).replace('across = "position"', 'across = "deflection"')
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="across is 'deflection'"):
        load_effects(file)
