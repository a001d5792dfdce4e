"""Candidates for one more cause: screened, then refitted jointly with the linear parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from invid.diagnosis.acceptance import least_gain
from invid.diagnosis.context import apply_rule
from invid.diagnosis.evidence import Trial, at_bound, attempted, extends, finite, refit
from invid.diagnosis.score_test import Score, Screen
from invid.diagnosis.slow_move import Move
from invid.diagnosis.thresholds import COMPETES, LARGER
from invid.effects.motion import rms
from invid.likelihood.candidate_pool import each
from invid.likelihood.evaluation import evaluate
from invid.likelihood.joint_fit import JointFit, fit, held_out
from invid.likelihood.placed_effect import Candidate, Term
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.signals.spectral_record import Record

POLISHED, REFITTED, PLACES = 12, 6, 2
"""How many candidates are polished and refitted, and at most how many places of one cause."""
NEARLY = 0.5
"""Share of the gain at its cause's best place from which a place is polished as well. A guess: of a mode with
2 % damping, the shape of the grid next to it takes two thirds."""
REACH = 3.0
"""How much more a refit may gain than its screen promised: shapes between the grid's, inner motion. A guess
that saves refits; it only skips what could not be accepted at three times its promise."""
UNEXPLAINED = 1.5
"""χ²/ν above which no candidate explains the records. A guess; it decides only whether to look elsewhere."""


NOTHING = Candidate()


@dataclass(frozen=True, eq=False)
class Sought:
    """What a search is given beside the fit and its records; see ``select``."""

    linear_axes: bool
    free: Float64 | None
    start: Float64 | None
    moves: Sequence[Move]
    contested: frozenset[int] = frozenset()
    """Axes on which a delay goes before its lag."""
    axis: int | None = None
    """Where causes are looked for; everywhere where it is none."""
    family: str | None = None
    """Which causes are looked for; all where it is none."""
    among: frozenset[Term] | None = None
    """Which causes at which places are; all where it is none."""
    begun: Sequence[Trial] = ()
    """What the first cause is chosen from, in place of a screen."""
    friction: Candidate = NOTHING
    """Laws that the identification fitted along: where the search starts."""


def screened(screen: Screen, terms: Sequence[Term]) -> list[Score]:
    """The likeliest candidates with their best shapes, best first."""

    def look(term: Term) -> Score:
        budget.check()
        tell_of("screening", term, screen.fit, terms.index(term) / (3.0 * len(terms)))
        return screen.best(term)

    def polish(score: Score) -> Score:
        budget.check()
        tell_of("screening", score.term, screen.fit, 0.35)
        return screen.best(score.term, polish=True)

    scores = each(look, terms, screen.fit, [])
    scores = [s for s in scores if np.isfinite(s.gain) and s.gain > 0]
    scores.sort(key=lambda s: -s.gain)
    asked = _few_of_a_cause(scores)[:POLISHED]
    # The best may lie between a grid's shapes: a sharp mode, of which the next shape takes two thirds.
    least = {cause: NEARLY * s.gain for s in reversed(scores) if (cause := s.term.effect.cause)}
    further = [s for s in scores if s.term.effect.shapes and s.gain >= least[s.term.effect.cause]]
    asked += [s for s in further if s not in asked and s.gain >= asked[-1].gain]
    polished = each(polish, asked, screen.fit, [])
    screen.release()
    polished.sort(key=lambda s: -s.gain)
    return _few_of_a_cause(polished)


def _few_of_a_cause(scores: Sequence[Score]) -> list[Score]:
    """At most ``PLACES`` of each cause, in the order given."""
    count: dict[str, int] = {}
    out = []
    for s in scores:
        cause = s.term.effect.cause
        count[cause] = count.get(cause, 0) + 1
        if count[cause] <= PLACES:
            out.append(s)
    return out


def tell_of(stage: str, term: Term, fit: JointFit, fraction: float) -> None:
    """Progress: what is done with a candidate."""
    axis = fit.layout.structure.axes[term.place.axis]
    budget.tell(stage, fraction, axis=axis, cause=term.effect.cause, element=term.place.element)


def any_gain(_: Term) -> float:
    """No least gain."""
    return 0.0


def refitted(
    here: JointFit,
    train: Sequence[Record],
    held: Sequence[Record],
    scores: Sequence[Score],
    least: Callable[[Term], float],
    reached: float,
) -> list[Trial]:
    """Joint fits of the best screened; ``least``: training gain below which a cause is not accepted,
    ``reached``: what others came to."""
    # Far from what the best could reach, or from what would be accepted: no refit.
    far = 0.05 * max((s.gain for s in scores), default=0.0)
    worth = [s for s in scores[:REFITTED] if s.gain >= far and REACH * s.gain >= least(s.term)]

    def begin(score: Score) -> JointFit | None:
        tell_of("weighing", score.term, here, 0.4 + 0.2 * worth.index(score) / len(worth))
        return finite(partial(refit, here, train, score.term, score.x, 4, score.shift))

    begun = [f for f in each(begin, worth, here, train) if f is not None]
    near = min([reached, *(f.cost for f in begun if not at_bound(f))])

    def go_on(found: JointFit) -> Trial | None:
        # Four steps away from a start that is right to first order: what is far behind stays there.
        if budget.spent():
            return Trial(found, held_out(found, held))
        tell_of("weighing", found.candidate.terms[-1], here, 0.6)
        if found.converged or found.cost - near >= 0.5 * (here.cost - near):
            return attempted(lambda: found, held)
        further = partial(fit, found.layout, train, found.p, found.candidate, known=found.evaluation)
        return attempted(partial(further, iterations=10), held)

    trials = each(go_on, begun, here, [*train, *held])
    return [t for t in trials if t is not None and not at_bound(t.fit) and not is_smaller_model(t)]


def promised(
    here: JointFit,
    train: Sequence[Record],
    held: Sequence[Record],
    asked: Sought,
    terms: Sequence[Term],
    *,
    first: bool,
    rejects: bool,
    known: Sequence[Trial],
) -> tuple[list[Trial], list[Score]]:
    """Joint fits of what the screen promises, and the screen's other answers."""
    scores = screened(Screen(here), terms)
    late = [t for t in terms if t.effect.cause == "torque_delay"]
    trials = list(apply_rule("delay-beyond-bound", here, train, held, late, asked.free))
    if trials or not known:  # one beside those known was weighed when they were found
        trials += apply_rule("lag-beside-delay", here, train, held, trials, terms)
    tried = {(t.term.effect.cause, t.term.place) for t in trials}
    # Without a shape there is one minimum, and those known are in it.
    tried |= {(t.term.effect.cause, t.term.place) for t in known if not t.term.effect.shapes}
    scores = [
        s
        for s in scores
        if s.term.effect.cause != "torque_delay" and (s.term.effect.cause, s.term.place) not in tried
    ]
    # A rival of those known takes as much.
    known_gain = max((here.cost - t.fit.cost for t in known), default=0.0)

    def least(term: Term) -> float:
        return max(least_gain(here, term, len(terms), first=first), known_gain)

    reached = min((t.fit.cost for t in (*trials, *known)), default=np.inf)
    trials += refitted(here, train, held, scores, least, reached)
    if first and rejects and asked.start is not None and not known:
        trials = apply_rule("start-from-model", trials, asked.start, here, train, held, terms)
    if first and rejects and not known:
        trials = with_known(trials, apply_rule("stiff-coupling", here, train, held, terms))
    return trials, scores


def with_those_from(
    trials: Sequence[Trial],
    start: Float64,
    here: JointFit,
    train: Sequence[Record],
    held: Sequence[Record],
    terms: Sequence[Term],
) -> list[Trial]:
    """The ``trials`` and, where none of them explains the records, those from other linear parameters.

    A strong cause bends the linear fit without effects so far that no step leads back: friction of a far mass
    takes a spring and a damper apart. The identification fits friction along, so its parameters (``start``)
    may be right where the fit without is not.
    """
    best = min((t.fit.cost for t in trials), default=np.inf)
    if best < UNEXPLAINED * here.dof or here.candidate.terms or start.size != here.p.size:
        return list(trials)
    there = attempted(lambda: fit(here.layout, train, start, Candidate(), iterations=0), held)
    if there is None:
        return list(trials)
    scores = [s for s in screened(Screen(there.fit), terms) if s.term.effect.cause != "torque_delay"]
    others = refitted(there.fit, train, held, scores, any_gain, best)
    if not others:
        return list(trials)
    # Where the linear parameters alone gain more than the cause, it is no cause's doing.
    least = min(others, key=lambda t: t.fit.cost).fit
    alone = finite(lambda: fit(here.layout, train, least.p, Candidate(), iterations=20))
    if alone is None or here.cost - alone.cost > alone.cost - least.cost:
        return list(trials)
    found = {(t.term.effect.cause, t.term.place): t for t in trials}
    for trial in others:
        key = (trial.term.effect.cause, trial.term.place)
        if trial.fit.cost < (found[key].fit.cost if key in found else here.cost):
            found[key] = trial
    return list(found.values())


def is_smaller_model(trial: Trial) -> bool:
    """A larger friction model that is Coulomb or viscous friction to within a tenth.

    Empirical: the motion of inner masses is reconstructed to a few per cent, and so is the law there;
    what a larger model gains by that is no asymmetry and no Stribeck effect.
    """
    x, cause = trial.x, trial.term.effect.cause
    if cause == "stribeck_friction":
        return float(x[1]) < 0.1 * float(x[0])
    if cause != "asymmetric_friction":
        return False
    pattern = trial.term.place.pattern(trial.fit.layout.structure)
    speed = rms([v.velocity(pattern) for v in trial.fit.evaluation.views])
    up, down, up_rate, down_rate = (abs(float(c)) for c in (x[0], x[1], x[2] * speed, x[3] * speed))
    dry, wet = up + down, up_rate + down_rate
    coulomb = abs(up - down) < 0.1 * dry and wet < 0.1 * dry
    viscous = abs(up_rate - down_rate) < 0.1 * wet and dry < 0.1 * wet
    return coulomb or viscous


def promised_rivals(last: Trial, train: Sequence[Record], terms: Sequence[Term]) -> list[Term] | None:
    """Of ``terms`` those that may take the place of the cause that a fit has last, by one linear pass over
    all of them without it; ``None`` where that does not tell (a delay takes a parameter of the layout).

    They promise half of what it takes, or as much as it does to within what competes. A larger friction model
    always promises as much as the smaller one in it: it counts where the rest of it pays for its parameters.
    """
    one = last.fit
    if last.term.effect.cause == "torque_delay":
        return None
    others = one.candidate.only(range(len(one.candidate.terms) - 1))
    rest = evaluate(one.layout, train, one.p, others, jacobian=False, near=one.evaluation.views)
    rest = replace(rest, jacobian=one.evaluation.jacobian[:, : -last.term.size])
    screen = Screen(replace(one, candidate=others, evaluation=rest))
    own = float(screen.residual @ screen.residual) - one.cost
    spread, price = one.dispersion, float(np.log(max(one.dof, 2)))

    def competes(score: Score) -> bool:
        if (score.term.effect.cause, score.term.place) == (last.term.effect.cause, last.term.place):
            return False
        larger = (
            score.term.place == last.term.place
            and score.term.effect.family == last.term.effect.family == "friction"
            and score.size > last.term.size
        )
        if larger:
            return score.gain - own > (price * (score.size - last.term.size) - COMPETES) * spread
        return score.gain > min(NEARLY * own, own - COMPETES * spread)

    return [s.term for s in screened(screen, terms) if competes(s)]


def with_known(trials: Sequence[Trial], known: Sequence[Trial]) -> list[Trial]:
    """Trials and those known; of one cause at one place the better."""
    found = {(t.term.effect.cause, t.term.place): t for t in trials}
    for trial in known:
        key = (trial.term.effect.cause, trial.term.place)
        if key not in found or trial.fit.cost < found[key].fit.cost:
            found[key] = trial
    return list(found.values())


def ranked_trials(
    scored: Sequence[tuple[Trial, float]], contested: frozenset[int]
) -> list[tuple[Trial, float]]:
    """Best first; a lag on a contested axis just behind the delay there.

    So is a larger friction model behind a smaller one where the training records do not ask for it: one in 26
    motors with dry friction of 1 N·m alone got a peak of 4.7 ± 9.8 N·m at the slowest for held-out chance. Or
    where it makes those kept out worse: what it then fits is not what the machine does at another amplitude.
    """
    delays = {t.term.place.axis: s for t, s in scored if t.term.effect.cause == "torque_delay"}
    moved = []
    for trial, score in scored:
        behind = trial.term.effect.cause == "torque_lag" and trial.term.place.axis in contested
        least = delays.get(trial.term.place.axis, score) if behind else score
        for smaller, s in scored:
            if not extends(trial, smaller):
                continue
            limit = LARGER * trial.dispersion
            if smaller.fit.cost - trial.fit.cost < limit or trial.held.cost - smaller.held.cost > limit:
                least, behind = max(least, s), True
        moved.append((trial, max(score, least), behind))
    return [(t, s) for t, s, _ in sorted(moved, key=lambda one: one[1:])]
