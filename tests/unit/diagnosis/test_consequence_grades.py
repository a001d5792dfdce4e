"""Does it matter: grades by own limits, published figures or neither, and the headline that sums them up."""

from dataclasses import replace

import numpy as np
import pytest

from invid.diagnosis.consequence import grade_consequences
from invid.diagnosis.outcome import Outcome, assemble_diagnosis
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
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.wording.sentence import say

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
        "The mechanics: free play in the transmission on A2 at spring 1, 2 mrad (6.9′) of play: check"
    )
    assert "2 as expected" in result.headline


def concluded(start: Diagnosis, recording: Recording) -> Diagnosis:
    """The document of figures whose words the start leaves open."""
    return grade_consequences(
        assemble_diagnosis(
            recording,
            start.residual,
            start.findings,
            start.model,
            Outcome(
                missing=True,
                complete=True,
                explained=start.explained_fraction,
                left=start.unexplained,
                warnings=start.warnings,
            ),
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


def with_motion(position: np.ndarray, torque: np.ndarray, **more: np.ndarray) -> Recording:
    given = recording()
    columns = {"position": position[:, None] * np.ones(3), "torque": torque[:, None] * np.ones(3), **more}
    return replace(given, experiments=(replace(given.experiments[0], **columns),))


def test_torque_at_its_limit_is_the_loop_and_not_the_mechanics_and_comes_first() -> None:
    wave = np.sin(2 * np.pi * 2.5 * np.arange(2000) / 1000.0)
    found = grade_consequences(
        diagnosis(term("backlash", "A2", "spring 1", gap=2e-3)),
        with_motion(0.01 * wave, np.clip(30.0 * wave, -10.0, 10.0)),
    )
    assert found.headline.startswith(
        "The loop, not the mechanics: the torque of A1 stands at its limit of 10 N·m"
    )
    assert say(found.headline, "de").startswith("Die Regelung, nicht die Mechanik: das Moment von A1")
    assert "Free play" in found.headline or "free play" in found.headline


@pytest.mark.parametrize("swings", [True, False])
def test_a_swing_at_a_goal_that_stands_is_the_loop(swings: bool) -> None:
    rng = np.random.default_rng(0)
    time = np.arange(2000) / 1000.0
    position = 2e-3 * np.sin(2 * np.pi * 7.0 * time) if swings else np.zeros(2000)
    position = position + 1e-5 * rng.standard_normal(2000)
    goal = np.full((2000, 3), 0.3)
    found = grade_consequences(
        diagnosis(verdict=Verdict.CONSISTENT, explained=None),
        with_motion(position, rng.standard_normal(2000), position_reference=goal),
    )
    said = "The loop, not the mechanics: A1 swings by 2 mrad at 7 Hz while its goal stands"
    assert found.headline.startswith(said) == swings


def test_a_sensor_is_said_to_be_one() -> None:
    found = grade_consequences(
        diagnosis(term("encoder_eccentricity", "A2", amplitude=0.02, phase=0.1)), recording()
    )
    assert found.headline.startswith("A sensor, not the mechanics")
