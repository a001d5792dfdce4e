"""Test which parameters of two models of one robot changed beyond their uncertainty, in words and numbers.

A parameter *changed* where the smallest set of changes that explains the difference of the two models
needs it (``compare_joint``: joint covariance of both fits, repeatability of the cell, Holm's correction over
everything tested, so that calling anything changed on a robot that did not change happens at most with
probability ``alpha``); it is *unchanged within ±x %* where the whole interval of its difference lies inside
the tolerance; otherwise the data *cannot tell*: because that interval is too wide, or because this parameter
or another changed and the data do not separate them. The command line and the service's ``changes`` both
come here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.clauses import label
from invid.comparison.baseline import MINIMUM_RUNS, pool_agreeing
from invid.comparison.baseline import repeatability as measured_repeatability
from invid.comparison.causes import compare_causes, variance_factors, with_cause_verdicts
from invid.comparison.changes import Change, Comparison, Repeatability, Status
from invid.comparison.joint_test import Whitened, detectable, joint_p, select
from invid.comparison.numbers import covariance_of_differences, mean_model, paired_numbers
from invid.comparison.sentences import PRACTICAL, bound_phrase, named_changes, sentences
from invid.errors import InputError
from invid.model.document import Estimate, Model, units
from invid.model.named_change import ChangeKind, NamedChange
from invid.numerics.distributions import normal_isf
from invid.wording.sentence import listed, sentence

ALPHA = 0.01
"""Probability of calling anything changed where nothing did (family-wise), of parameters and of causes each:
together the 2 % promised for the service."""
TOLERANCE = 0.2
"""Default of ±x: where more than a fifth could change unseen, "unchanged" says little (a convention)."""
_JOINT_SHARE = 0.2
"""Share of ``alpha`` for "something changed, but no parameter stands out"; the rest is for parameters."""


def compare(  # noqa: PLR0913 - the contract: each is one option of the command
    old: Model,
    new: Model,
    *,
    tolerance: float = TOLERANCE,
    alpha: float = ALPHA,
    repeatability: float = 0.0,
    history: Sequence[Model] | None = None,
    before: Sequence[Model] = (),
    after: Sequence[Model] = (),
) -> Comparison:
    """Compare two models of one robot (``invid.compare``), as members of the history of a cell.

    Parameters
    ----------
    history
        Models of this cell, oldest first (the two among them or not), whose scatter from run to run says
        by how much the fits' covariances are too small; ``None`` where there is no history to ask.
    before, after
        Earlier models of the state that ``old`` and ``new`` stand for, oldest first: those that agree with
        it (``baseline.pool_agreeing``) are averaged with it, which makes smaller changes detectable.

    Raises
    ------
    InputError
        Where the models have no axis in common, different units, or an option is out of range.
    """
    for name, value, top in (
        ("tolerance", tolerance, 10.0),
        ("alpha", alpha, 0.5),
        ("repeatability", repeatability, 10.0),
    ):
        if not (0 <= value <= top) or (value == 0 and name != "repeatability"):
            raise InputError(f"compare: {name} is {value!r}; it must lie between 0 and {top}")
    if old.linear != new.linear:
        raise InputError(
            f"compare: the old model is in {units(old.linear)['mass']} and the new one in "
            f"{units(new.linear)['mass']}; these are different robots"
        )
    common = [a for a in old.axes if a in new.axes]
    if not common:
        raise InputError(
            f"compare: no axis in common: the old model has {list(old.axes)}, the new one {list(new.axes)}"
        )
    warnings = []
    if old.robot != new.robot:
        robots = sentence("{old!r} and {new!r}", old=old.robot, new=new.robot)
        warnings.append(sentence("the models name different robots: {robots}", robots=robots))
    scatter = Repeatability()
    if history is not None:
        scatter = measured_repeatability(history, spanning=(old, new))
        if scatter.pairs < MINIMUM_RUNS:
            warnings.append(
                sentence(
                    "repeatability of this cell is not known yet ({pairs} earlier repetition(s), "
                    "{minimum_runs} needed): the test rests on the covariance of the two fits alone",
                    pairs=scatter.pairs,
                    minimum_runs=MINIMUM_RUNS,
                )
            )
    scatter = replace(scatter, relative=repeatability)
    # A factor below 1 sharpens the comparison; runs of one state are not torn apart on it, as a run that is
    # off by chance would then stand alone for its side.
    apart = max(1.0, scatter.factor)
    sides = pool_agreeing(old, before, apart), pool_agreeing(new, after, apart)
    runs = len(sides[0]), len(sides[1])
    old, new = mean_model(sides[0]), mean_model(sides[1])
    rows = paired_numbers(old, new, common, repeatability)
    causes = compare_causes(old, new, common, alpha=alpha, tolerance=tolerance, scatter=scatter)
    # The size of a cause is judged with the causes: a family of its own, as nothing ties it to the masses.
    sizes = {f"{c.name}.{c.parameter}" for c in causes}
    known = [c for c in rows if c.std is not None and c.name not in sizes]
    judged, p_all, joint_alpha = {c.name: c for c in rows}, None, _JOINT_SHARE * alpha
    if known:
        factors = variance_factors(causes)
        covariance = scatter.factor**2 * covariance_of_differences(known, (old, new), factors)
        white, is_sound = Whitened.of(np.array([c.difference for c in known], dtype=float), covariance)
        if not is_sound:
            warnings.append(
                sentence(
                    "the joint covariance of the parameters is not positive definite, so their "
                    "correlation is left out of the test"
                )
            )
        p_all = joint_p(white, scatter.dof)
        found = _judge(known, white, (scatter.dof, runs), tolerance, alpha)
        judged |= {c.name: c for c in found}
    parameters, effects = (
        tuple(c for c in judged.values() if (c.kind is ChangeKind.EFFECT) is is_effect)
        for is_effect in (False, True)
    )
    comparison = Comparison(
        (old.robot, new.robot),
        alpha,
        tolerance,
        parameters,
        with_cause_verdicts(effects, causes),
        p_all,
        len(known),
        warnings=tuple(warnings),
        shape=tuple(_structure(old, new, common)),
        repeatability=scatter,
        runs=runs,
        causes=causes,
    )
    comparison = replace(comparison, named=named_changes(comparison, joint_alpha))
    return replace(comparison, sentences=sentences(comparison, joint_alpha))


def _structure(old: Model, new: Model, common: Sequence[str]) -> list[NamedChange]:
    """What differs in axes and numbers of masses."""
    said = [NamedChange(ChangeKind.AXIS_GONE, a) for a in old.axes if a not in common]
    said += [NamedChange(ChangeKind.AXIS_NEW, a) for a in new.axes if a not in common]
    for axis in common:
        was, now = (Estimate(float(m.chains.masses[m.axes.index(axis)].size)) for m in (old, new))
        if was != now:
            said.append(NamedChange(ChangeKind.MASSES, axis, old=was, new=now))
    return said


def _judge(
    changes: Sequence[Change],
    white: Whitened,
    known_from: tuple[float, tuple[int, int]],
    tolerance: float,
    alpha: float,
) -> list[Change]:
    """Status of every tested parameter; *unchanged* needs an interval inside ±tolerance.

    ``known_from``: degrees of freedom of the deviations, and the runs behind either side.
    """
    selection = select(white, (1 - _JOINT_SHARE) * alpha, *known_from)
    seen = detectable(white, (1 - _JOINT_SHARE) * alpha, *known_from)
    doubtful, values, stds = selection.doubtful(), *white.sizes(selection.chosen)
    # One-sided on either side: the larger of both ends decides (two one-sided tests).
    reach = normal_isf(alpha)
    out = []
    for k, c in enumerate(changes):
        difference, spread = c.difference or 0.0, float(white.std[k])
        status, why = Status.CANNOT_TELL, ""
        others = [changes[o] for o in sorted(set(doubtful.get(k, ())))]
        if k in doubtful:
            why = sentence(
                "this or {labels} changed; the data do not separate them",
                labels=listed([label(c) for c in others], alternatives=True),
            )
        elif k in selection.chosen:
            at = selection.chosen.index(k)
            difference, spread, status = float(values[at]), float(stds[at]), Status.CHANGED
        bound = (abs(difference) + reach * spread) / c.scale if c.scale > 0 else None
        if not why and status is not Status.CHANGED:
            if bound is None:
                why = sentence("no value to compare with: it was 0")
            elif bound <= tolerance:
                status = Status.UNCHANGED
            else:
                why = sentence("a change of up to {bound} would not be seen", bound=bound_phrase(bound))
        out.append(
            replace(
                c,
                difference=difference,
                std=spread,
                share=difference / c.scale if c.scale > 0 else None,
                matters=bound is None or bound > PRACTICAL,
                p_value=float(selection.p[k]),
                p_adjusted=float(selection.p_adjusted[k]),
                status=status,
                why=why,
                bound=bound,
                detectable=float(seen[k]) / c.scale if c.scale > 0 else None,
                rivals=tuple(o.name for o in others),
            )
        )
    return out
