"""All special rules of the search, in the order in which they are asked."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from invid.diagnosis.candidates import with_those_from
from invid.diagnosis.context import Rule, Stage
from invid.diagnosis.linear_fit import from_causes, restarted
from invid.diagnosis.rules.asymmetric_pair import with_asymmetry
from invid.diagnosis.rules.declared_masses import with_the_declared_mass
from invid.diagnosis.rules.dropped_rows import find_dropped
from invid.diagnosis.rules.gradual_sign import with_gradual_signs
from invid.diagnosis.rules.heavy_mode import strong_modes
from invid.diagnosis.rules.known_friction import with_known_friction
from invid.diagnosis.rules.load_change import between_records, changes_with_time, searched_around
from invid.diagnosis.rules.mode_place import modes_moved, with_the_mode_in_the_chain
from invid.diagnosis.rules.near_variants import delays, elsewhere, ladder, lags, retimed
from invid.diagnosis.rules.nonrepeating_torque import said_of_scatter
from invid.diagnosis.rules.own_evidence import on_own_evidence
from invid.diagnosis.rules.pruning import pruned
from invid.diagnosis.rules.reidentify import looked_again
from invid.diagnosis.rules.scatter_explained import quieted
from invid.diagnosis.rules.slow_moves import judged_on_moves
from invid.diagnosis.rules.stiff_coupling import tied_loads
from invid.diagnosis.rules.tones import tones_of
from invid.diagnosis.rules.viscous_with_dry import allowing_for_viscous, with_viscous
from invid.diagnosis.rules.wide_gap import rattles
from invid.diagnosis.rules.widths import with_widths

GENERATORS = "hidden plants of this project (docs/explanations/hidden-tests.md)"
"""Where a rule is from that no book has: what the hidden tests showed."""


def _none(*_: Any, **__: Any) -> None:
    return None


def _nothing(*_: Any, **__: Any) -> list[Any]:
    return []


RULES: tuple[Rule, ...] = (
    Rule(
        "dropped-rows", Stage.DATA,
        "A row that repeats the one before, bit by bit, while the axis moves was lost on the bus.",
        GENERATORS, find_dropped, _nothing,
    ),
    Rule(
        "spread-restart", Stage.NUISANCE,
        "A fit in a wrong minimum is left by starting from evenly shared masses with modes over the band.",
        GENERATORS, restarted,
    ),
    Rule(
        "tones", Stage.DATA,
        "A sinusoid that repeats with no period turns by 2πfT from one to the next; noise does not.",
        GENERATORS, tones_of, _nothing,
    ),
    Rule(
        "time-causes-first", Stage.DATA,
        "Where records kept out differ from those fitted, only a change with time is worth the long search.",
        GENERATORS, changes_with_time, lambda *_, **__: True,
    ),
    Rule(
        "known-friction", Stage.SELECTION,
        "An identification that gets chains right beside friction has found it: the search starts with it.",
        "saves a step of the search for each law (benchmarks/bench_speed.py)", with_known_friction, _none,
        applies=lambda start, friction, *_: len(friction.terms) > 1,
    ),
    Rule(
        "delay-beyond-bound", Stage.CANDIDATES,
        "A time offset at its bound of one sample is a delay; it starts from the fit without that bound.",
        GENERATORS, delays, _nothing, applies=lambda here, train, held, late, free: bool(late),
    ),
    Rule(
        "lag-beside-delay", Stage.CANDIDATES,
        "Near low frequencies a lag is a delay; each delay is weighed against the lag that is as late.",
        GENERATORS, lags, _nothing,
    ),
    Rule(
        "start-from-model", Stage.CANDIDATES,
        "A strong cause bends the linear fit without it; the identification, which fits friction along, "
        "starts nearer.",
        GENERATORS, with_those_from,
    ),
    Rule(
        "stiff-coupling", Stage.CANDIDATES,
        "The nearest that chains come to a stiff spring between two loads is loads far too heavy.",
        GENERATORS, tied_loads, _nothing,
    ),
    Rule(
        "change-retimed", Stage.CANDIDATES,
        "In a period half of one load, half of another, a small change early and a large one late are alike.",
        GENERATORS, retimed, applies=lambda trial, *_: trial.term.effect.family == "time",
    ),
    Rule(
        "gradual-sign", Stage.CANDIDATES,
        "No contact reverses at once: friction changes its sign over a range of velocity.",
        "tanh law of velocity, as in Andersson, Söderberg, Björklund, Tribology International 40 (2007) 580",
        with_gradual_signs,
    ),
    Rule(
        "reversal-widths", Stage.SELECTION,
        "How gradually friction turns over shows once what acts beside it is in the model.",
        "whole cells (tests/hidden/cells.py)", with_widths,
        applies=lambda found, *_: bool(found.steps),
    ),
    Rule(
        "mode-moved", Stage.CANDIDATES,
        "Every branch shows all modes: one at the wrong mass takes most of what it would one mass further.",
        GENERATORS, modes_moved, _nothing,
    ),
    Rule(
        "next-mass", Stage.CANDIDATES,
        "The screen's order of places is that of linear parameters which the cause itself has bent.",
        GENERATORS, elsewhere, _nothing,
    ),
    Rule(
        "slow-moves", Stage.RANKING,
        "Over a long way a constant torque, gravity and a ripple differ, which are alike in small motion.",
        "regression on slow moves, as in Bittencourt and Gunnarsson, J. Dyn. Syst. Meas. Control 134 (2012)",
        judged_on_moves, applies=lambda step, moves: bool(moves),
    ),
    Rule(
        "friction-ladder", Stage.STEP,
        "Friction by direction contains the laws without it: it has to earn its parameters against each.",
        GENERATORS, lambda step, train, held: ladder(step, train, held) or (step,),
        lambda step, *_: (step,),
        applies=lambda step, *_: "dry" in step.chosen.term.effect.parts
        and "viscous" in step.chosen.term.effect.parts,
    ),
    Rule(
        "pruning", Stage.STEP,
        "A cause whose size is not told from none beside those that came after it stood for a part of them.",
        "backward elimination after forward selection",
        pruned, applies=lambda found, *_: len(found.steps) > 1,
    ),
    Rule(
        "viscous-with-dry", Stage.SELECTION,
        "What rubs is greased: viscous friction beside dry is one question, with no price for places.",
        GENERATORS, with_viscous, applies=lambda found, *_: bool(found.steps),
    ),
    Rule(
        "mode-in-chain", Stage.SELECTION,
        "A mode found beside a chain may be one of its own that the fit has lost: the inverse puts it back.",
        "inverse of a chain from its modes, equations 13 to 23 of the paper",
        with_the_mode_in_the_chain, _none,
    ),
    Rule(
        "asymmetric-pair", Stage.SELECTION,
        "A constant torque and dry friction on one axis are friction that differs by direction.",
        "identity of the two laws", with_asymmetry, applies=lambda found, *_: len(found.steps) > 1,
    ),
    Rule(
        "scatter-explained", Stage.SELECTION,
        "Scatter between periods that a cause explains is no noise: it counts as what the fit still leaves.",
        "expectation of χ²", quieted, lambda part: list(part.records),
    ),
    Rule(
        "restart-from-causes", Stage.SELECTION,
        "Beside a linear model in a wrong minimum any cause may be what leads out of it.",
        GENERATORS, from_causes, _none,
    ),
    Rule(
        "change-between-records", Stage.SELECTION,
        "A change inside a record taken whole is a mixture: the gap beside it explains it as well.",
        GENERATORS, between_records, applies=lambda selection: bool(selection.steps),
    ),
    Rule(
        "load-change", Stage.SELECTION,
        "The period in which a load changes is half of one plant, half of another: it fits neither.",
        GENERATORS, searched_around, _none, applies=lambda selection, *_: bool(selection.steps),
    ),
    Rule(
        "heavy-mode", Stage.RESTART,
        "A mode so heavy that the linear fit without it is lost shows from light chains alone.",
        GENERATORS, strong_modes, _nothing,
    ),
    Rule(
        "wide-gap", Stage.RESTART,
        "In a gap as wide as its spring deflects the load can move in many ways; the torque tells which.",
        GENERATORS, rattles, _none,
    ),
    Rule(
        "reidentify", Stage.RESTART,
        "Strong friction misleads an identification; with it taken out the machine is linear again.",
        GENERATORS, looked_again,
    ),
    Rule(
        "declared-masses", Stage.RESTART,
        "A mode found beside a chain with fewer masses than were declared is the mass left out.",
        GENERATORS, with_the_declared_mass, applies=lambda look, _: bool(look.selection.steps),
    ),
    Rule(
        "viscous-allowed-for", Stage.VERDICT,
        "Viscous friction that is not named may still be there, and dry friction takes its part.",
        "Schwarz' penalty as prior odds", allowing_for_viscous, applies=lambda found: bool(found.steps),
    ),
    Rule(
        "own-evidence", Stage.SELECTION,
        "Dry friction of a motor is read from measured motion, and stands where nothing else is explained.",
        "whole cells (tests/hidden/cells.py)", on_own_evidence, _none,
    ),
    Rule(
        "nonrepeating-torque", Stage.VERDICT,
        "Torque that differs from period to period beyond the sensors' noise is noise to all that repeats.",
        "expectation of the scatter between periods", said_of_scatter, _none,
    ),
)  # fmt: skip
"""Every rule, by stage in the order in which the search meets them first."""

BY_NAME: Mapping[str, Rule] = MappingProxyType({r.name: r for r in RULES})
"""The same by name."""
