"""What `compare` says of causes: appeared, grew, shrank, gone or not, and how often that is wrong."""

import math

import numpy as np
import pytest
from stated_models import again, model_of, term

from invid.comparison.causes import compare_causes
from invid.comparison.changes import Change, Comparison, Repeatability, Status
from invid.comparison.compare import ALPHA, TOLERANCE, compare
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm, Model
from invid.wording.sentence import say

AXES = ("A1", "A2", "A3")
TORQUE, GAP = 0.4, 3e-4
STD = {"coulomb_friction": 0.01, "viscous_friction": 0.02, "backlash": 1e-5}


CHAINS = CoupledChains.build([[1.0, 2.0]] * 3, [[1000.0]] * 3, [[0.5]] * 3, 1e-9 * (1 - np.eye(3)), axes=AXES)


def friction(axis: str) -> EffectTerm:
    return term("coulomb_friction", axis, "mass 1", torque=(TORQUE, STD["coulomb_friction"]))


def viscous(axis: str) -> EffectTerm:
    return term("viscous_friction", axis, "mass 1", coefficient=(0.2, STD["viscous_friction"]))


def play(gap: float = GAP, std: float = STD["backlash"]) -> EffectTerm:
    return term("backlash", "A2", "spring 1", gap=(gap, std))


def model(*effects: EffectTerm, verdict: str | None = "explained", relative: float = 1e-3) -> Model:
    return model_of(CHAINS, None, relative, *effects, verdict=verdict)


def usual() -> tuple[EffectTerm, ...]:
    """What the case study shows: dry and viscous friction on three axes."""
    return (*(friction(a) for a in AXES), *(viscous(a) for a in AXES))


def of(c: Comparison, name: str) -> Change:
    return next(x for x in c.causes if x.name == name)


def test_no_more_than_two_in_a_hundred_pairs_of_runs_call_an_unchanged_cause_changed() -> None:
    rng, base, trials, false = np.random.default_rng(20261124), model(*usual(), play()), 200, 0
    for _ in range(trials):
        causes = compare(again(base, rng), again(base, rng)).causes
        assert len(causes) == 7
        false += any(c.status.is_change for c in causes)
    assert false / trials <= 0.02


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_cause_that_grew_or_shrank_by_five_deviations_is_found_and_no_other(side: float) -> None:
    rng = np.random.default_rng(41)
    base, trials = model(*usual(), play()), 1000
    other = GAP + side * 5 * math.sqrt(2) * STD["backlash"]
    changed = model(*usual(), play(other))
    name, word = "A2.backlash.spring 1", Status.GREW if side > 0 else Status.SHRANK
    found = others = 0
    for _ in range(trials):
        pair = again(base, rng), again(changed, rng)
        causes = compare_causes(*pair, AXES, alpha=ALPHA, tolerance=TOLERANCE, scatter=Repeatability())
        found += any(c.status is word and c.name == name for c in causes)
        others += any(c.status.is_change and c.name != name for c in causes)
    assert found / trials >= 0.95
    assert others / trials <= 0.03


def reported(size: float, std: float, rng: np.random.Generator) -> Model:
    """A run that names the play only where it is beyond 4.4 standard deviations, as a diagnosis does."""
    seen = size + std * rng.standard_normal()
    return model(*usual(), *((play(seen, std),) if seen > 4.4 * std else ()))


@pytest.mark.campaign
def test_a_cause_at_the_edge_of_what_is_named_does_not_appear_and_vanish_from_run_to_run() -> None:
    """Now named, now not, of one and the same size: neither appeared nor gone."""
    rng = np.random.default_rng(5)
    wrong = one_sided = 0
    for _ in range(400):
        size = 1e-5 * rng.uniform(3.0, 7.0)
        c = compare(reported(size, 1e-5, rng), reported(size, 1e-5, rng))
        causes = [x for x in c.causes if x.cause == "backlash"]
        one_sided += any(x.old is None or x.new is None for x in causes)
        wrong += any(x.status.is_change for x in causes)
    assert one_sided > 50  # the case that matters did occur
    assert wrong / 400 <= 0.02


def test_a_cause_that_was_nothing_and_is_large_has_appeared_and_the_other_way_round_gone() -> None:
    came = compare(model(*usual()), model(*usual(), play()))
    assert of(came, "A2.backlash.spring 1").status is Status.APPEARED
    said = "New: free play in the transmission on A2 at spring 1, 0.30 ± 0.01 mrad; check the gear's wear"
    assert any(s.startswith(said) for s in came.sentences)
    went = compare(model(*usual(), play()), model(*usual()))
    assert of(went, "A2.backlash.spring 1").status is Status.GONE
    assert came.headline == (
        "New: free play in the transmission on A2 at spring 1, 0.30 ± 0.01 mrad. "
        "Before accepting: check the gear's wear, keys and couplings."
    )
    assert say(went.headline, "de").startswith(
        "Spiel im Getriebe an A2, Feder 1 verschwunden, zuvor 0,30 ± 0,01 mrad."
    )


@pytest.mark.parametrize(
    ("old", "why"),
    [
        (model(verdict=None), "does not say that causes were looked for"),
        (model(*usual(), verdict="partly_explained"), "had no name; it may have been this"),
        (model(verdict="unexplained"), "had no name; it may have been this"),
        (model(*usual(), relative=0.05), "the old run would have seen it from"),
    ],
)
def test_a_run_that_could_not_have_seen_a_cause_says_nothing_about_it(old: Model, why: str) -> None:
    found = of(compare(old, model(*usual(), play())), "A2.backlash.spring 1")
    assert found.status is Status.CANNOT_TELL
    assert why in found.why
