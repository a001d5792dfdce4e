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

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from invid.comparison.baseline import MINIMUM_RUNS, pool_agreeing, pool_models
from invid.comparison.baseline import repeatability as measured_repeatability
from invid.comparison.causes import compare_causes, variance_factors, with_cause_verdicts
from invid.comparison.changes import Change, Comparison, Repeatability, Status
from invid.comparison.joint_test import Selection, Whitened, covariance_of, detectable, joint_p, select
from invid.comparison.named import named_change
from invid.comparison.news import named_changes
from invid.comparison.pairs import effects as paired_effects
from invid.comparison.pairs import parameter_changes
from invid.comparison.pairs import structure as structure_of
from invid.comparison.sentences import bound_phrase, statements
from invid.errors import InputError
from invid.model.document import Model, units
from invid.numerics.arrays import Float64
from invid.numerics.distributions import normal_isf
from invid.wording.clauses import label
from invid.wording.statement import Listed, Statement

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
        warnings.append(f"the models name different robots: {old.robot!r} and {new.robot!r}")
    scatter = Repeatability()
    if history is not None:
        scatter = measured_repeatability(history, spanning=(old, new))
        if scatter.pairs < MINIMUM_RUNS:
            warnings.append(
                f"repeatability of this cell is not known yet ({scatter.pairs} earlier repetition(s), "
                f"{MINIMUM_RUNS} needed): the test rests on the covariance of the two fits alone"
            )
    scatter = replace(scatter, relative=repeatability)
    # A factor below 1 sharpens the comparison; runs of one state are not torn apart on it, as a run that is
    # off by chance would then stand alone for its side.
    apart = max(1.0, scatter.factor)
    sides = pool_agreeing(old, before, apart), pool_agreeing(new, after, apart)
    old, new = pool_models(sides[0]), pool_models(sides[1])
    parameters = parameter_changes(old, new, common, repeatability)
    effects = paired_effects(old, new, common, repeatability)
    causes = compare_causes(old, new, common, alpha=alpha, tolerance=tolerance, scatter=scatter)
    sizes = {f"{c.name}.{c.parameter}" for c in causes}
    both = [*parameters, *effects]
    judged = list(both)
    p_all, dof = None, 0
    # The size of a cause is judged with the causes: a family of its own, as nothing ties it to the masses.
    tested = [k for k, c in enumerate(both) if c.std is not None and c.name not in sizes]
    if tested:
        known = [both[k] for k in tested]
        covariance = scatter.factor**2 * _covariance((old, new), known, variance_factors(causes))
        white, sound = Whitened.of(np.array([c.difference for c in known], dtype=float), covariance)
        if not sound:
            warnings.append(
                "the joint covariance of the parameters is not positive definite, so their correlation is "
                "left out of the test"
            )
        runs = len(sides[0]), len(sides[1])
        selection = select(white, (1 - _JOINT_SHARE) * alpha, scatter.dof, runs)
        p_all, dof = joint_p(white, scatter.dof), len(known)
        seen = detectable(white, (1 - _JOINT_SHARE) * alpha, scatter.dof, runs)
        verdicts = _judge(known, white, selection, tolerance, alpha)
        for k, change, size in zip(tested, verdicts, seen, strict=True):
            judged[k] = replace(change, detectable=float(size) / change.scale if change.scale > 0 else None)
    comparison = Comparison(
        old.robot,
        new.robot,
        alpha,
        tolerance,
        tuple(judged[: len(parameters)]),
        with_cause_verdicts(judged[len(parameters) :], causes),
        p_all,
        dof,
        (),
        tuple(warnings),
        tuple(structure_of(old, new, common)),
        scatter,
        (len(sides[0]), len(sides[1])),
        causes,
    )
    joint_alpha = _JOINT_SHARE * alpha
    comparison = replace(comparison, named=named_changes(comparison, joint_alpha))
    return replace(comparison, statements=statements(comparison, joint_alpha=joint_alpha))


def _covariance(
    models: tuple[Model, Model],
    changes: Sequence[Change],
    factors: tuple[Mapping[str, float], Mapping[str, float]],
) -> Float64:
    """Covariance of the differences: joint over the linear parameters, each effect for itself.

    ``factors``: by axis, how many times the variance of its chain counts in either model.
    """
    spread = np.array([c.std or 0.0 for c in changes])
    covariance: Float64 = np.diag(spread**2)
    linear = [k for k, c in enumerate(changes) if c.kind not in ("effect", "inertia")]
    names = [changes[k].name for k in linear]
    own = [covariance_of(m, names) for m in models]
    block = own[0] + own[1]
    # The diagonal has the repeatability of the robot in it already.
    block[np.diag_indices_from(block)] = spread[linear] ** 2
    for part, by_axis in zip(own, factors, strict=True):
        for axis, factor in by_axis.items():
            at = [k for k, number in enumerate(linear) if changes[number].axis == axis]
            block[np.ix_(at, at)] += (factor - 1.0) * part[np.ix_(at, at)]
    covariance[np.ix_(linear, linear)] = block
    return covariance


def _judge(
    changes: Sequence[Change], white: Whitened, selection: Selection, tolerance: float, alpha: float
) -> list[Change]:
    """Status of every tested parameter; *unchanged* needs an interval inside ±tolerance."""
    sizes: dict[int, tuple[float, float]] = {}
    if selection.chosen:
        values, stds = white.sizes(selection.chosen)
        sizes = {k: (float(v), float(s)) for k, v, s in zip(selection.chosen, values, stds, strict=True)}
    doubtful = selection.doubtful()
    # One-sided on either side: the larger of both ends decides (two one-sided tests).
    reach = normal_isf(alpha)
    out = []
    for k, c in enumerate(changes):
        difference, spread = c.difference or 0.0, float(white.std[k])
        if k in sizes and k not in doubtful:
            difference, spread = sizes[k]
        bound = (abs(difference) + reach * spread) / c.scale if c.scale > 0 else None
        rivals: tuple[str, ...] = ()
        why: Statement | None
        if k in doubtful:
            rivals = tuple(dict.fromkeys(changes[o].name for o in sorted(doubtful[k])))
            others = tuple(label(named_change(changes[o])) for o in sorted(doubtful[k]))
            status = Status.CANNOT_TELL
            why = Statement("why.rivals", {"labels": Listed(others, "or")})
        elif k in sizes:
            status, why = Status.CHANGED, None
        elif bound is not None and bound <= tolerance:
            status, why = Status.UNCHANGED, None
        else:
            status = Status.CANNOT_TELL
            why = Statement("why.was_zero")
            if bound is not None:
                why = Statement("why.unseen", {"bound": bound_phrase(bound)})
        out.append(
            replace(
                c,
                difference=difference,
                std=spread,
                p_value=selection.p[k],
                p_adjusted=selection.p_adjusted[k],
                status=status,
                why=why,
                bound=bound,
                rivals=rivals,
            )
        )
    return out
