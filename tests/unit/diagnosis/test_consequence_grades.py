"""Does it matter: grades by own limits, published figures or neither, and the headline that sums them up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from invid.config import parse_config
from invid.diagnosis.consequence import grade_consequences
from invid.diagnosis.outcome import assemble_diagnosis
from invid.effects.registry import CATALOGUE
from invid.model.chains import CoupledChains
from invid.model.diagnosis_document import (
    Alternative,
    AxisResidual,
    Diagnosis,
    Finding,
    Grade,
    Unexplained,
    Verdict,
)
from invid.model.document import ChainStd, EffectTerm, Estimate, Model
from invid.model.forward import resonances
from invid.recording.model import Experiment, Kind, Recording, Role

AXES = ("A1", "A2", "A3")
CONFIG = """\
format: invid-config
format_version: 1
robot: cell
{motion}bus: {{interface: virtual, channel: c}}
axes:
  - {{name: A1, node_id: 1, limits: {{torque: 25, position: 0.5, velocity: 3}}, acceptable: {{{own}}}}}
"""


def chains() -> CoupledChains:
    return CoupledChains.build(
        [[1.0, 2.0, 3.0]] * 3, [[1000.0, 2000.0]] * 3, [[0.5, 0.5]] * 3, np.zeros((3, 3)), axes=AXES
    )


def recording(
    *, torque: float = 10.0, config: str | None = None, rated: bool = True, unit: str = "rad"
) -> Recording:
    time = np.arange(2000) / 1000.0
    wave = np.sin(2 * np.pi * 5 * time)[:, None] * np.ones(3)
    experiment = Experiment(
        "000", Kind.MULTISINE, Role.VALIDATE, -1, np.zeros(3), 0, np.array([5.0]), 1000.0,
        time, 0.01 * wave, torque * wave,
    )  # fmt: skip
    return Recording(
        "cell", AXES, unit, "N·m" if unit == "rad" else "N", "2026-01-01T00:00:00Z", (experiment,),
        rated_torque=np.full(3, 100.0) if rated else None, config=config,
    )  # fmt: skip


def term(cause: str, axis: str = "A1", element: str | None = "mass 1", **values: float) -> EffectTerm:
    return EffectTerm(cause, axis, {n: Estimate(v, abs(v) / 50, None) for n, v in values.items()}, element)


def diagnosis(
    *terms: EffectTerm,
    verdict: Verdict = Verdict.EXPLAINED,
    explained: float | None = 0.99,
    after: float = 0.051,
    rivals: tuple[Alternative, ...] = (),
    unexplained: Unexplained | None = None,
) -> Diagnosis:
    built = chains()
    model = Model("cell", "refined", built, ChainStd.unknown(built), effects=terms)
    found = tuple(
        Finding(t, 0.99, 0.4, 0.05, 0.9 - 0.01 * k, rivals, None, f"{t.axis}: {t.cause} {k} is there.")
        for k, t in enumerate(terms)
    )
    rows = tuple(AxisResidual(a, "N·m", 0.4, after, 0.05) for a in AXES)
    sentences = tuple(f.sentence for f in found)
    return Diagnosis(verdict, rows, explained, found, unexplained, model, sentences=sentences)


def graded(*terms: EffectTerm, config: str | None = None, **options: bool) -> tuple[Grade, ...]:
    result = grade_consequences(diagnosis(*terms), recording(config=config, **options))
    return tuple(f.consequence.grade for f in result.findings if f.consequence is not None)


FIGURES = [(e.cause, size) for e in CATALOGUE for size in e.sizes if size.expected is not None]


def test_every_figure_rises_and_names_its_source() -> None:
    assert len(FIGURES) == 14
    for cause, size in FIGURES:
        assert 0 <= size.expected <= size.serious, cause
        assert "(" in size.source or size.linear, size.source


def test_every_measure_of_a_limit_can_stand_in_the_config() -> None:
    accepted = parse_config(CONFIG.format(motion="", own="")).axes[0].acceptable
    limits = {s.quantity.limit or s.quantity.name for _, s in FIGURES}
    assert limits - {"torque_shortfall_fraction_of_rated"} <= set(type(accepted).model_fields)


@pytest.mark.parametrize(
    ("found", "grade"),
    [
        (term("coulomb_friction", torque=0.4), Grade.AS_EXPECTED),
        (term("coulomb_friction", torque=20.0), Grade.WATCH),
        (term("coulomb_friction", torque=40.0), Grade.ACT),
        (term("backlash", element="spring 1", gap=1e-4), Grade.AS_EXPECTED),
        (term("backlash", element="spring 1", gap=5e-4), Grade.WATCH),
        (term("backlash", element="spring 1", gap=2e-3), Grade.ACT),
        (term("torque_gain", element=None, gain=0.95), Grade.AS_EXPECTED),
        (term("torque_gain", element=None, gain=0.7), Grade.ACT),
        (term("torque_saturation", element=None, limit=80.0), Grade.ACT),
        (term("torque_saturation", element=None, limit=180.0), Grade.AS_EXPECTED),
        (term("gravity", element="mass 3", torque=60.0, angle=0.1), Grade.AS_EXPECTED),
        (term("gravity", element="mass 3", torque=160.0, angle=0.1), Grade.ACT),
        (term("cogging", torque=1.0, cycles_per_rev=6.0, phase=0.0), Grade.AS_EXPECTED),
        (term("extra_mode", element="mass 3", mass=0.5, stiffness=300.0), Grade.WATCH),
        (term("torque_delay", element=None, delay=0.002), Grade.WATCH),
    ],
)
def test_sizes_are_graded_by_published_figures_and_watched_where_there_are_none(
    found: EffectTerm, grade: Grade
) -> None:
    assert graded(found) == (grade,)


def test_without_a_rated_torque_friction_has_no_figure_and_says_so() -> None:
    result = grade_consequences(diagnosis(term("coulomb_friction", torque=0.4)), recording(rated=False))
    consequence = result.findings[0].consequence
    assert consequence is not None
    assert consequence.grade is Grade.WATCH
    assert consequence.share_of_rated_torque is None
    assert "rated torque is not in the recording" in consequence.reason


def test_figures_for_rotary_gears_do_not_judge_a_linear_axis() -> None:
    result = grade_consequences(
        diagnosis(term("backlash", element="spring 1", gap=1e-5)), recording(unit="m")
    )
    assert result.findings[0].consequence.grade is Grade.WATCH
    assert "0.01 mm" in result.findings[0].consequence.text


@pytest.mark.parametrize(
    ("own", "grade"), [("backlash_rad: 1e-3", "as_expected"), ("backlash_rad: 1e-4", "act")]
)
def test_a_limit_in_the_config_counts_before_every_published_figure(own: str, grade: str) -> None:
    config = CONFIG.format(motion="", own=own)
    result = grade_consequences(
        diagnosis(term("backlash", element="spring 1", gap=5e-4)), recording(config=config)
    )
    consequence = result.findings[0].consequence
    assert (str(consequence.grade), consequence.source) == (grade, "config")
    assert "the config accepts" in consequence.reason


def test_a_config_that_cannot_be_read_is_a_warning_where_it_has_limits_and_silent_elsewhere() -> None:
    found = diagnosis(term("backlash", element="spring 1", gap=5e-4))
    broken = grade_consequences(found, recording(config="acceptable: [what"))
    assert any("acceptable" in w for w in broken.warnings)
    assert grade_consequences(found, recording(config="foreign notes")).warnings == ()


def test_findings_are_listed_by_consequence_and_their_sentences_with_them() -> None:
    result = grade_consequences(
        diagnosis(
            term("coulomb_friction", torque=0.4),
            term("backlash", "A2", "spring 1", gap=2e-3),
            term("viscous_friction", "A3", coefficient=10.0),
        ),
        recording(),
    )
    assert [f.effect.cause for f in result.findings] == ["backlash", "coulomb_friction", "viscous_friction"]
    assert [s.split(":")[0] for s in result.sentences] == ["A2", "A1", "A3"]
    assert result.grade is Grade.ACT
    assert result.headline.startswith(
        "Free play in the transmission on A2 at spring 1, 2 mrad (6.9′) of play: check"
    )
    assert "2 as expected" in result.headline


def test_alike_findings_are_one_clause_of_the_headline() -> None:
    result = grade_consequences(
        diagnosis(*(term("coulomb_friction", a, torque=0.2) for a in AXES)), recording()
    )
    assert result.headline == (
        "Dry friction on all three axes, up to 0.2 % of rated torque: as expected, nothing to do."
    )


def test_each_cause_of_a_clause_is_told_on_its_own_axes() -> None:
    dry = [term("coulomb_friction", a, torque=0.2) for a in AXES]
    viscous = [term("viscous_friction", a, coefficient=0.02) for a in AXES]
    on_two = grade_consequences(diagnosis(*dry, *viscous[:2]), recording())
    assert on_two.headline.startswith(
        "Dry friction on all three axes and viscous friction on A1 and A2, up to"
    )
    assert on_two.headlines["de"].startswith(
        "Trockene Reibung an allen drei Achsen und zähe Reibung an A1 und A2, bis zu"
    )
    on_all = grade_consequences(diagnosis(*dry, *viscous), recording())
    assert on_all.headline.startswith("Dry and viscous friction on all three axes, up to")


def test_a_resonance_that_another_mass_moves_is_told_as_its_relative_change() -> None:
    extra = term("extra_mode", "A2", "mass 3", mass=0.5, stiffness=300.0)
    measures = grade_consequences(diagnosis(extra), recording()).findings[0].consequence.measures
    # By hand: the three free axes with one mass more on the second.
    built = chains()
    longer = CoupledChains.build(
        [[1.0, 2.0, 3.0], [1.0, 2.0, 3.0, 0.5], [1.0, 2.0, 3.0]],
        [[1000.0, 2000.0], [1000.0, 2000.0, 300.0], [1000.0, 2000.0]],
        None,
        np.zeros((3, 3)),
        axes=AXES,
    )
    lowest = [min(w for w in resonances(c) if w > 1e-6) for c in (built, longer)]
    assert measures["resonance_change_fraction"] == pytest.approx(lowest[1] / lowest[0] - 1)


def test_play_between_loads_of_a_hysteretic_spring_is_twice_torque_over_stiffness() -> None:
    found = term("spring_hysteresis", element="spring 2", stiffness=100.0, torque=1.0)
    consequence = grade_consequences(diagnosis(found), recording()).findings[0].consequence
    assert consequence.measures["lost_motion"] == pytest.approx(2 * 1.0 / 2000.0)
    assert consequence.share_of_rated_torque == pytest.approx(0.01)
    assert consequence.grade is Grade.WATCH  # beyond 2 minutes of arc, below 4


def concluded(start: Diagnosis, recording: Recording) -> Diagnosis:
    """The document of figures whose words the start leaves open."""
    return grade_consequences(
        assemble_diagnosis(
            recording,
            start.residual,
            start.findings,
            start.model,
            missing=True,
            complete=True,
            explained=start.explained_fraction,
            left=start.unexplained,
            warnings=start.warnings,
        ),
        recording,
    )


def test_words_keep_the_contract_whatever_an_engine_says() -> None:
    rival = Alternative("viscous_friction", "A1", "mass 1", 0.06)
    found = diagnosis(term("coulomb_friction", torque=0.4), explained=0.7, rivals=(rival,))
    result = concluded(found, recording(rated=False))
    assert result.verdict is Verdict.PARTLY_EXPLAINED
    assert result.unexplained is not None
    assert result.unexplained.sentence in result.sentences
    assert result.findings[0].confidence <= 0.89
    assert "dry friction or viscous friction" in result.headline.lower()


def test_a_model_that_misses_more_than_half_of_the_torque_is_not_trusted_and_says_so_first() -> None:
    lost = Unexplained("A1", (), (), "A1: much is left")
    found = diagnosis(verdict=Verdict.UNEXPLAINED, explained=None, after=6.0, unexplained=lost)
    found = replace(found, warnings=("another",))
    result = concluded(found, recording(torque=10.0))
    assert "misses 85% of the torque" in result.warnings[0]  # 6 of 10/√2 rms
    assert result.model.fit["trustworthy"] is False
    assert result.grade is None
    assert "not to be trusted" in result.headline
    assert concluded(found, recording(torque=20.0)).warnings == ("another",)


def test_nothing_found_is_nothing_to_do_and_nothing_named_is_not() -> None:
    fine = grade_consequences(diagnosis(verdict=Verdict.CONSISTENT, explained=None), recording())
    assert fine.headline == "Nothing beyond noise on all three axes: nothing to do."
    assert fine.grade is Grade.AS_EXPECTED
    lost = Unexplained("A2", (), (), "A2: something is left")
    odd = diagnosis(verdict=Verdict.UNEXPLAINED, explained=None, unexplained=lost)
    odd = grade_consequences(odd, recording())
    assert odd.headline.startswith("Something on A2 is not in the model and no known cause explains it")
    assert odd.grade is None
