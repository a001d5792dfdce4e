"""The report: self-contained, escaped, the same for the same data, and its pictures true to the data."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest
from hidden.generator import Truth, make

import invid
from invid.effects.registry import CATALOGUE
from invid.model.diagnosis_document import Alternative, AxisResidual, Diagnosis, Finding, Verdict
from invid.model.document import ChainStd, EffectTerm, Estimate, Model
from invid.recording.model import Recording
from invid.report import figures
from invid.report.data import figure_data, linear_model_of
from invid.report.page import render_report

HOSTILE = ('A1"><script>alert(1)</script>', "$\\frac{x", "a\x00b & <b>")


def linear_model(truth: Truth, axes: tuple[str, ...] | None = None) -> Model:
    chains = truth.chains if axes is None else replace(truth.chains, axes=axes)
    std = replace(ChainStd.unknown(chains), masses=tuple(0.002 * m for m in chains.masses))
    return Model("cell", "refined", chains, std, warnings=("damper 1 of A1 cannot be told: measure longer",))


def named(
    recording: Recording, model: Model, cause: str, axis: str, element: str | None, **values: float
) -> Diagnosis:
    term = EffectTerm(cause, axis, {k: Estimate(v, abs(v) * 0.02, "N·m") for k, v in values.items()}, element)
    sentence = f"Axis {axis}: {cause} explains 97 % of what the model missed."
    finding = Finding(
        term,
        0.98,
        1.4,
        0.05,
        0.97,
        (Alternative("viscous_friction", axis, element, 0.4),),
        {"kind": "slow"},
        sentence,
    )
    rows = tuple(AxisResidual(a, "N·m", 1.4, 0.05, 0.049) for a in recording.axes)
    return Diagnosis(
        Verdict.EXPLAINED, rows, 0.97, (finding,), None, model.extended(term), sentences=(sentence,)
    )


@pytest.fixture(scope="module")
def friction() -> tuple[Recording, Truth]:
    return make(
        "coulomb_friction",
        (1, 1),
        {"torque": 2.0},
        seed=11,
        motors=2,
        masses=(2, 2),
        moves=False,
        noise=0.002,
        drive="smooth",
    )


@pytest.fixture(scope="module")
def page(friction: tuple[Recording, Truth]) -> str:
    recording, truth = friction
    model = linear_model(truth)
    axis = recording.axes[1]
    return render_report(
        recording, model, named(recording, model, "coulomb_friction", axis, "mass 1", torque=2.0)
    )


class _Balanced(HTMLParser):
    VOID = frozenset({"meta", "br", "hr", "img", "link", "input"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def parsed(html: str) -> _Balanced:
    parser = _Balanced()
    parser.feed(html)
    assert parser.open == []
    return parser


@pytest.mark.campaign
def test_the_page_is_whole_and_needs_no_network(page: str) -> None:
    tags = parsed(page).tags
    assert not [t for t, _ in tags if t in ("script", "link", "img", "iframe", "object")]
    for _, attributes in tags:
        for name in ("src", "href", "xlink:href", "style"):
            assert "http" not in (attributes.get(name) or "")
    assert "@import" not in page
    assert not re.findall(r"url\((?!#)", page)
    assert len(page) < 1_500_000


def test_hostile_names_stay_text(friction: tuple[Recording, Truth]) -> None:
    recording, truth = friction
    axes = HOSTILE[:2]
    hostile = replace(recording, axes=axes, robot=HOSTILE[2] + "<script>", config="</pre><script>x</script>")
    model = replace(linear_model(truth, axes), warnings=("<img src=x onerror=alert(1)>",))
    diagnosis = named(hostile, model, "coulomb_friction", axes[1], "mass 1", torque=2.0)
    tags = parsed(render_report(hostile, model, diagnosis)).tags
    assert not [t for t, _ in tags if t in ("script", "img", "b")]
    for picture in figures.draw(figure_data(hostile, model, diagnosis)).values():
        ElementTree.fromstring(picture)
        assert "<script" not in picture


@pytest.mark.parametrize("cause", [e.cause for e in CATALOGUE if e.over])
def test_every_cause_with_a_picture_draws_it(friction: tuple[Recording, Truth], cause: str) -> None:
    recording, truth = friction
    model = linear_model(truth)
    names = (
        "torque coefficient static coulomb velocity stiffness coulomb_positive coulomb_negative "
        "viscous_positive viscous_negative cycles_per_rev phase delay time_constant gain limit amplitude "
        "gap angle"
    )
    values = dict.fromkeys(names.split(), 0.5)
    element = "spring 1" if cause in ("cubic_stiffness", "backlash", "spring_hysteresis") else "mass 1"
    diagnosis = named(recording, model, cause, recording.axes[0], element, **values)
    (view,) = figure_data(recording, model, diagnosis)["views"]
    side = view["sides"][0]
    assert side["what"] == view["own"]
    assert np.isfinite(side["x"]).all()
    assert np.isfinite(side["y"]).all()
    if cause != "encoder_eccentricity":
        assert side["fit"] is not None


def test_the_missing_torque_over_velocity_is_the_hidden_friction_and_as_much_as_the_verdict_misses() -> None:
    alone = {"motors": 1, "masses": (2,), "moves": False, "noise": 0.002, "drive": "smooth"}
    recording, truth = make("coulomb_friction", (0, 1), {"torque": 2.0}, seed=11, **alone)
    diagnosis = invid.diagnose(recording)
    data = figure_data(recording, linear_model_of(diagnosis), diagnosis)
    view = next(v for v in data["views"] if v["axis"] == recording.axes[0])
    side = next(s for s in view["sides"] if s["what"] == "velocity")
    velocity, torque = np.array(side["x"]), np.array(side["y"])
    fast = np.abs(velocity) > 0.5 * velocity.std()
    hidden = truth.effects[0].parameters["torque"]
    assert np.mean(np.sign(velocity) * torque, where=fast) == pytest.approx(hidden, rel=0.15)
    lines = np.concatenate([data["missing_torque"][0][kind]["before"] for kind in ("excited", "silent")])
    assert np.sqrt(np.sum(lines**2) / 2) == pytest.approx(diagnosis.residual[0].before, rel=0.2)


def test_a_recording_that_shakes_nothing_still_gives_a_report(friction: tuple[Recording, Truth]) -> None:
    recording, truth = friction
    html = render_report(replace(recording, experiments=()), linear_model(truth))
    parsed(html)
    assert "no pictures over frequency" in html
