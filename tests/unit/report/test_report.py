"""The report: self-contained, escaped, the same for the same data, and its pictures true to the data."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from hidden.generator import Truth, make

from invid.effects.registry import CATALOGUE
from invid.model.diagnosis_document import Alternative, AxisResidual, Diagnosis, Finding, Verdict
from invid.model.document import ChainStd, EffectTerm, Estimate, Model
from invid.recording.model import Recording
from invid.report import figure_data, render_report
from invid.report.figures import figures

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


def test_the_sentence_comes_before_every_picture_and_number(page: str) -> None:
    sentence = page.index("explains 97 % of what the model missed")
    assert sentence < page.index("<figure")
    assert sentence < page.index("<table")
    assert "damper 1 of A1 cannot be told" in page
    assert "cannot tell" in page  # springs without a standard deviation


def test_the_first_picture_shows_where_it_is(page: str) -> None:
    first = page[page.index("<figure") :].split("</figure>")[0]
    assert 'id="branches"' in first
    assert re.search(r"<desc[^>]*>[^<]*1: A2 motor, dry friction", first)


def test_what_is_known_of_the_run_stands_on_the_first_line(friction: tuple[Recording, Truth]) -> None:
    recording, truth = friction
    page = render_report(recording, linear_model(truth), run={"run": "r-17", "started by": "<Ann>"})
    line = page[page.index("<body") :].split("</p>")[0]
    assert "run r-17" in line
    assert "started by &lt;Ann&gt;" in line


def test_each_picture_says_its_figures_for_whoever_cannot_see_it(page: str) -> None:
    captions = dict(re.findall(r'<figure id="([^"]+)">.*?<figcaption>(.*?)</figcaption>', page, re.S))
    assert "A2 1.4, 0.05 and 0.049 N·m" in captions["residual"]
    assert re.search(r"A2: most at \d[\d.]* Hz", captions["missing-torque"])
    assert re.search(r"differ by \d[\d.]* % with the linear model", captions["frf-1"])
    assert re.search(r"\d+ points from -\d", captions["cause-1"])


def test_every_picture_has_a_caption_and_ids_are_unique(page: str) -> None:
    assert page.count("<figure") == page.count("<figcaption") == page.count("<svg") > 3
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    for reference in re.findall(r'(?:xlink:href="#|url\(#)([^")]+)', page):
        assert reference in ids


@pytest.mark.campaign
def test_the_same_data_give_the_same_bytes(friction: tuple[Recording, Truth]) -> None:
    recording, truth = friction
    assert render_report(recording, linear_model(truth)) == render_report(recording, linear_model(truth))


def test_hostile_names_stay_text(friction: tuple[Recording, Truth]) -> None:
    recording, truth = friction
    axes = HOSTILE[:2]
    hostile = replace(recording, axes=axes, robot=HOSTILE[2] + "<script>", config="</pre><script>x</script>")
    model = replace(linear_model(truth, axes), warnings=("<img src=x onerror=alert(1)>",))
    diagnosis = named(hostile, model, "coulomb_friction", axes[1], "mass 1", torque=2.0)
    tags = parsed(render_report(hostile, model, diagnosis)).tags
    assert not [t for t, _ in tags if t in ("script", "img", "b")]
    for picture in figures(hostile, model, diagnosis).values():
        ElementTree.fromstring(picture)
        assert "<script" not in picture


def test_the_measured_response_lies_on_the_true_one_within_its_band(
    friction: tuple[Recording, Truth],
) -> None:
    recording, truth = make(None, seed=12, masses=(2, 2), moves=False, drive="smooth", noise=0.003)
    data = figure_data(recording, linear_model(truth))
    m, d, k = (
        truth.chains.mass_matrix,
        truth.chains.damping_matrix,
        truth.chains.stiffness_matrix,
    )
    for axis, motor in enumerate((0, 2)):
        seen = data["frf"][axis]["measured"]
        w = 2 * np.pi * np.array(seen["frequency_hz"])
        true = np.array([np.abs(np.linalg.inv(k + 1j * x * d - x * x * m)[motor, motor]) for x in w])
        z = (np.array(seen["magnitude"]) - true) / np.array(seen["std"])
        assert w.size > 10
        # |G| of complex noise of total power std²: deviations of about 0.7 std
        assert np.median(np.abs(z)) < 1.5
        assert np.median(np.abs(z)) > 0.1


def test_missing_torque_stands_above_the_floor_only_where_something_is_missing(
    friction: tuple[Recording, Truth],
) -> None:
    recording, truth = friction
    rows = figure_data(recording, linear_model(truth))["missing_torque"]

    def ratio(row: dict[str, object]) -> float:
        floor = np.median(np.array(row["noise_floor"]))
        return float(np.median(np.array(row["excited"]["before"])) / floor)  # type: ignore[index]

    assert ratio(rows[1]) > 5
    assert ratio(rows[0]) < 2


def test_the_points_of_a_friction_picture_follow_the_friction(friction: tuple[Recording, Truth]) -> None:
    """Resistance inferred at the motor: +2 N·m when turning forward, −2 N·m backward."""
    recording, truth = friction
    model = linear_model(truth)
    diagnosis = named(recording, model, "coulomb_friction", recording.axes[1], "mass 1", torque=2.0)
    (cause,) = figure_data(recording, model, diagnosis)["causes"]
    v, y = np.array(cause["x"]), np.array(cause["y"])
    fast = np.abs(v) > 0.3 * np.abs(v).max()
    assert np.median(y[fast & (v > 0)]) == pytest.approx(2.0, rel=0.15)
    assert np.median(y[fast & (v < 0)]) == pytest.approx(-2.0, rel=0.15)
    assert max(cause["fit"]["y"]) == pytest.approx(2.0)


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
    (picture,) = figure_data(recording, model, diagnosis)["causes"]
    assert np.isfinite(picture["x"]).all()
    assert np.isfinite(picture["y"]).all()
    if cause != "encoder_eccentricity":
        assert picture["fit"] is not None


def test_a_recording_that_shakes_nothing_still_gives_a_report(friction: tuple[Recording, Truth]) -> None:
    recording, truth = friction
    html = render_report(replace(recording, experiments=()), linear_model(truth))
    parsed(html)
    assert "no pictures over frequency" in html


def test_a_record_from_rest_has_its_boundary_terms_removed() -> None:
    """The first period of a periodic record, cut anywhere, is a motion that does not close."""
    recording, truth = make(None, seed=13, masses=(2,), moves=False, drive="smooth", noise=0.002, periods=3)
    cut = []
    for e in recording.experiments:
        keep = slice(0, int(0.73 * e.period_samples))
        cut.append(
            replace(e, time=e.time[keep], position=e.position[keep], torque=e.torque[keep], period_samples=0)
        )
    (row,) = figure_data(replace(recording, experiments=tuple(cut)), linear_model(truth))["missing_torque"]
    assert np.median(row["excited"]["before"]) < 4 * np.median(row["noise_floor"])
