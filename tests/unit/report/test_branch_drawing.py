"""The drawing of the branches: every number at its element, every finding at its place, one to six axes."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from invid.model.chains import CoupledChains
from invid.model.diagnosis_document import Consequence, Finding, Grade
from invid.model.document import ChainStd, EffectTerm, Estimate, Model
from invid.report.branch_drawing import branch_drawing

SVG = "{http://www.w3.org/2000/svg}"


def model_of(sizes: list[int], *, coupled: bool = True) -> Model:
    rng = np.random.default_rng(sum(sizes))
    masses = [rng.uniform(1.0, 9.0, n) for n in sizes]
    springs = [rng.uniform(1000.0, 9000.0, n - 1) for n in sizes]
    count = len(sizes)
    couplings = np.triu(rng.uniform(0.01, 0.05, (count, count)), 1) * coupled
    chains = CoupledChains.build(masses, springs, [0.001 * k for k in springs], couplings + couplings.T)
    std = ChainStd(
        masses=tuple(0.001 * m for m in chains.masses),
        springs=tuple(0.001 * k for k in chains.springs),
        dampers=tuple(0.1 * d for d in chains.dampers),
        couplings=0.1 * chains.couplings if coupled else np.full((count, count), np.nan),
        ground_springs=np.full(count, np.nan),
    )
    return Model("cell", "refined", chains, std)


def finding(
    cause: str, axis: str, element: str | None, grade: Grade | None = None, other: str | None = None
) -> Finding:
    term = EffectTerm(cause, axis, {"size": Estimate(0.3, 0.01, "N·m")}, element, other)
    means = None if grade is None else Consequence(grade, "3 % of rated torque", "usual")
    return Finding(term, 0.95, 1.0, 0.1, 0.9, consequence=means)


def texts(svg: str) -> list[str]:
    return [t.text or "" for t in ElementTree.fromstring(svg).iter(f"{SVG}text")]


@pytest.mark.parametrize("sizes", [[1], [3, 1], [3, 2, 1, 3, 2, 4]])
def test_every_number_of_the_model_stands_in_the_drawing_and_nothing_leaves_it(sizes: list[int]) -> None:
    model = model_of(sizes)
    svg = branch_drawing(model, [finding("torque_delay", a, None, Grade.WATCH) for a in model.axes])
    root = ElementTree.fromstring(svg)
    width, height = (float(v) for v in root.attrib["viewBox"].split()[2:])
    shown = texts(svg)
    for group in (model.chains.masses, model.chains.springs, model.chains.dampers):
        for value in np.concatenate(group):
            near = [float(t.split(" ")[0]) for t in shown if re.match(r"\d[\d.]* ±", t)]
            assert min(abs(n - value) for n in near) < 0.06 * value
    pairs = len(sizes) * (len(sizes) - 1) // 2
    assert svg.count("rotate(-90") == pairs
    for t in root.iter(f"{SVG}text"):
        assert 0 <= float(t.attrib["x"]) <= width
        assert 0 <= float(t.attrib["y"]) <= height
    axes = [t for t in root.iter(f"{SVG}text") if t.text in model.axes]
    assert [t.text for t in axes] == list(model.axes), "one row an axis, in order"


def test_hostile_names_stay_text() -> None:
    model = model_of([2])
    chains = CoupledChains.build(
        model.chains.masses, model.chains.springs, axes=['"><script>alert(1)</script>\x00']
    )
    svg = branch_drawing(Model("cell", "refined", chains, ChainStd.unknown(chains)))
    assert "<script" not in svg
    ElementTree.fromstring(svg)
