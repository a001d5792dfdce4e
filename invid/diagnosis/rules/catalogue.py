"""All special rules of the search, in the order in which they are called."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from invid.diagnosis.context import Rule, Stage
from invid.diagnosis.rules.asymmetric_pair import doubt_asymmetric_pairs
from invid.diagnosis.rules.dropped_rows import find_dropped_rows
from invid.diagnosis.rules.known_friction import add_known_friction
from invid.diagnosis.rules.load_change import search_around_change
from invid.diagnosis.rules.mode_in_chain import fit_chain_with_mode
from invid.diagnosis.rules.near_variants import (
    delay_variants,
    friction_ladder,
    retime_load_change,
    try_other_places,
)
from invid.diagnosis.rules.nonrepeating_torque import describe_scatter
from invid.diagnosis.rules.own_evidence import keep_independent_causes
from invid.diagnosis.rules.slow_moves import rank_by_slow_moves
from invid.diagnosis.rules.tones import find_common_tones
from invid.diagnosis.rules.whole_search import search_beside_friction

GENERATORS = "hidden plants of this project (docs/explanations/hidden-tests.md)"
"""Source of rules that are empirical: the hidden tests of this project."""


def _no_result(*_: Any, **__: Any) -> None:
    return None


def _empty_list(*_: Any, **__: Any) -> list[Any]:
    return []


RULES: tuple[Rule, ...] = (
    Rule(
        "dropped-rows", Stage.DATA,
        "A row that repeats the one before, bit by bit, while the axis moves was lost on the bus.",
        GENERATORS, find_dropped_rows, _empty_list,
    ),
    Rule(
        "tones", Stage.DATA,
        "A sinusoid that repeats with no period turns by 2πfT from one to the next; noise does not.",
        GENERATORS, find_common_tones, _empty_list,
    ),
    Rule(
        "known-friction", Stage.SELECTION,
        "An identification that gets chains right beside friction has found it: the search starts with it.",
        "saves a step of the search for each law (bench_speed.py)", add_known_friction, _no_result,
        applies=lambda start, friction, *_: len(friction.terms) > 1,
    ),
    Rule(
        "delay-beyond-bound", Stage.CANDIDATES,
        "A time offset at its bound of one sample is a delay; it starts from the fit without that bound.",
        GENERATORS, delay_variants, _empty_list, applies=lambda here, train, held, late, free: bool(late),
    ),
    Rule(
        "change-retimed", Stage.CANDIDATES,
        "In a period half of one load, half of another, a small change early and a large one late are alike.",
        GENERATORS, retime_load_change, applies=lambda trial, *_: trial.term.effect.family == "time",
    ),
    Rule(
        "next-mass", Stage.CANDIDATES,
        "The screen's order of places is that of linear parameters which the cause itself has bent.",
        GENERATORS, try_other_places, _empty_list,
    ),
    Rule(
        "slow-moves", Stage.RANKING,
        "Over a long way a constant torque, gravity and a ripple differ, which are alike in small motion.",
        "regression on slow moves, as in Bittencourt and Gunnarsson, J. Dyn. Syst. Meas. Control 134 (2012)",
        rank_by_slow_moves, applies=lambda step, moves: bool(moves),
    ),
    Rule(
        "friction-ladder", Stage.STEP,
        "Friction by direction contains the laws without it: it has to earn its parameters against each.",
        GENERATORS, lambda step, train, held: friction_ladder(step, train, held) or (step,),
        lambda step, *_: (step,),
        applies=lambda step, *_: "dry" in step.chosen.term.effect.parts
        and "viscous" in step.chosen.term.effect.parts,
    ),
    Rule(
        "mode-in-chain", Stage.SELECTION,
        "A mode found beside a chain may be one of its own that the fit has lost: the inverse puts it back.",
        "inverse of a chain from its modes, equations 13 to 23 of the paper",
        fit_chain_with_mode, _no_result,
    ),
    Rule(
        "asymmetric-pair", Stage.SELECTION,
        "A constant torque and dry friction on one axis are friction that differs by direction.",
        "identity of the two laws", doubt_asymmetric_pairs, applies=lambda found, *_: len(found.steps) > 1,
    ),
    Rule(
        "load-change", Stage.SELECTION,
        "The period in which a load changes is half of one plant, half of another: it fits neither.",
        GENERATORS, search_around_change, _no_result, applies=lambda selection, *_: bool(selection.steps),
    ),
    Rule(
        "whole-records", Stage.RESTART,
        "Where periods differ in motion, the law of their mean is not the mean of the law: records are taken "
        "whole, against the friction that every joint has.",
        "whole cells (tests/hidden/cells.py)", search_beside_friction, _no_result,
    ),
    Rule(
        "own-evidence", Stage.SELECTION,
        "Dry friction of a motor is read from measured motion, and stands where nothing else is explained.",
        "whole cells (tests/hidden/cells.py)", keep_independent_causes, _no_result,
    ),
    Rule(
        "nonrepeating-torque", Stage.VERDICT,
        "Torque that differs from period to period beyond the sensors' noise is noise to all that repeats.",
        "expectation of the scatter between periods", describe_scatter, _no_result,
    ),
)  # fmt: skip
"""Every rule, by stage in the order in which the search meets them first."""

BY_NAME: Mapping[str, Rule] = MappingProxyType({r.name: r for r in RULES})
"""The same by name."""
