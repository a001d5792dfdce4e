"""Special rules that a diagnosis may use, and a record of what those that it called did.

The search, the fits before it and the verdict know no rule: they call the context by name
(``apply_rule("friction-ladder", step, …)``), which runs the rule or, where it is switched off, returns what
there would be without it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from invid.diagnosis import rules
from invid.errors import InputError
from invid.numerics import budget


class Stage(StrEnum):
    """Kind of object that a rule receives and returns."""

    DATA = "data"
    """Recording or records before the search."""
    CANDIDATES = "candidates"
    """Trials of one step."""
    RANKING = "ranking"
    """The order of a step's candidates."""
    STEP = "step"
    """A cause that was just added."""
    SELECTION = "selection"
    """All causes found."""
    RESTART = "restart"
    """A whole search, while it is not at the noise."""
    VERDICT = "verdict"
    """What is said of what is left."""


CHEAP = (Stage.DATA, Stage.RESTART, Stage.VERDICT)
"""Stages whose rules run even when the budget is spent: cheap ones, and the search beside friction, which
then evaluates what the identification found and ends."""


@dataclass(frozen=True)
class Rule:
    """Something that the general search does not do by itself: another start, candidate or doubt.

    Attributes
    ----------
    name
        For ``details.rules`` and ``--without-rule``.
    reason, source
        One sentence of physics or statistics; where it is from.
    apply
        Takes the object (first) and what the rule needs besides; returns the object unchanged where it finds
        nothing.
    without
        What is returned instead, of the same arguments; default: the first of them.
    applies
        Of the same arguments: whether the rule has anything to examine; fits nothing.
    """

    name: str
    stage: Stage
    reason: str
    source: str
    apply: Callable[..., Any]
    without: Callable[..., Any] = lambda first, *_, **__: first
    applies: Callable[..., bool] = lambda *_, **__: True


@dataclass(frozen=True)
class RuleUse:
    """One call of a rule: whether it changed anything, χ² before and after, and its processor time [s]."""

    rule: str
    stage: Stage
    number: int
    """Which search of the diagnosis it was in, from 1."""
    changed: bool
    chi2: tuple[float, float] | None = None
    cpu_s: float | None = None

    def to_json(self) -> dict[str, Any]:
        """An entry of ``details.rules``."""
        out: dict[str, Any] = {
            "rule": self.rule,
            "stage": str(self.stage),
            "pass": self.number,
            "changed": self.changed,
            "chi2": None if self.chi2 is None else [float(f"{c:.6g}") for c in self.chi2],
        }
        return out if self.cpu_s is None else {**out, "cpu_s": round(self.cpu_s, 3)}


@dataclass(eq=False)
class Context:
    """The rules of one diagnosis that are switched off, and the calls of the others.

    ``clock`` is that of the processor, given where the price of rules is measured; without it two documents
    of one recording are equal.
    """

    without: frozenset[str] = frozenset()
    clock: Callable[[], float] | None = None
    searches: int = 0
    asked: list[RuleUse] = field(default_factory=list)
    latest: Context | None = None
    """Context of the latest diagnosis within this one, with every rule that was called there."""

    def fresh(self) -> Context:
        """A context with the same switches and no calls yet; kept as ``latest``."""
        self.latest = Context(self.without, self.clock)
        return self.latest

    def fired_rules(self) -> list[dict[str, Any]]:
        """Entries of ``details.rules``: the rules that changed anything, in that order."""
        return [a.to_json() for a in self.asked if a.changed]


_current: ContextVar[Context] = ContextVar("context of the diagnosis")


def current_context() -> Context:
    """The context of the running diagnosis; one with all rules on where none runs."""
    return _current.get(Context())


@contextmanager
def use_context(context: Context) -> Iterator[Context]:
    """Context manager that makes ``context`` the current one."""
    token = _current.set(context)
    try:
        yield context
    finally:
        _current.reset(token)


def context_without(names: Collection[str], clock: Callable[[], float] | None = None) -> Context:
    """A context with the rules ``names`` switched off.

    Raises
    ------
    InputError
        A name that no rule has.
    """
    known = rules_by_name()
    for name in names:
        if name not in known:
            raise InputError(f"--without-rule {name}: no rule of that name; there are {', '.join(known)}")
    return Context(frozenset(names), clock)


def rules_by_name() -> Mapping[str, Rule]:
    """All rules by name, in the order in which they are called."""
    known: Mapping[str, Rule] = rules.BY_NAME
    return known


def apply_rule(name: str, *given: Any, **options: Any) -> Any:
    """The result of a rule for ``given``; what there would be without it where it is off or finds nothing."""
    rule, context = rules_by_name()[name], current_context()
    if name in context.without:
        return rule.without(*given, **options)
    if not rule.applies(*given, **options):
        return rule.without(*given, **options)
    started = 0.0 if context.clock is None else context.clock()
    label = name.replace("-", " ")
    if rule.stage not in CHEAP and budget.is_left_out(label):
        return rule.without(*given, **options)
    try:
        found = rule.apply(*given, **options)
    except budget.BudgetSpent:
        budget.leave_out(label)
        return rule.without(*given, **options)
    cpu_s = None if context.clock is None else context.clock() - started
    without = rule.without(*given, **options)
    costs = chi2_of(given[0] if given else None), chi2_of(found)
    changed = not _is_same(found, without)
    chi2 = None if not changed or costs[0] is None or costs[1] is None else (costs[0], costs[1])
    context.asked.append(RuleUse(name, rule.stage, max(context.searches, 1), changed, chi2, cpu_s))
    return found


def _is_same(one: object, other: object) -> bool:
    """Whether a rule returned just what there would be without it."""
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(_is_same(a, b) for a, b in zip(one, other, strict=True))
    return one is other or (isinstance(one, bool | float | str) and one == other)


def chi2_of(value: object) -> float | None:
    """χ² of what a rule returned: of a fit, a trial, a step, a selection or the best of several; else
    ``None``."""
    for path in (("selection", "final", "cost"), ("final", "cost"), ("chosen", "cost"), ("cost",)):
        found: object = value
        for part in path:
            found = getattr(found, part, None)
        if isinstance(found, float | int):
            return float(found)
    if isinstance(value, Sequence) and not isinstance(value, str):
        costs = [c for c in map(chi2_of, value) if c is not None]
        return min(costs, default=None)
    return None
