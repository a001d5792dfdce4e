"""Which special rules a diagnosis may use, and what those that it asked did.

The search, the fits before it and the verdict know no rule: they ask the context by name
(``apply_rule("friction-ladder", step, …)``), which runs the rule, or where it is switched off hands back what
would be there without it.
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
    """What a rule is handed, and what it hands on."""

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


CHEAP = (Stage.DATA, Stage.VERDICT)
"""Stages whose rules look and fit little: they are asked when a budget is spent, too."""


@dataclass(frozen=True)
class Rule:
    """What the general search does not do by itself: another start, candidate or doubt.

    Attributes
    ----------
    name
        For ``details.rules`` and ``--without-rule``.
    reason, source
        One sentence of physics or statistics; where it is from.
    apply
        Takes what is there (first) and what it needs beside; hands back what it was given where it finds
        nothing.
    without
        What is handed on instead, of the same arguments; default: the first of them.
    applies
        Of the same arguments: whether there is anything to look at; it fits nothing.
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
    """One rule that applied: whether it changed anything, χ² before and after, and its processor time [s]."""

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
    """The rules of one diagnosis that are switched off, and those that were asked.

    ``clock`` is the processor's, where the price of rules is measured; documents of one recording are alike
    without it.
    """

    without: frozenset[str] = frozenset()
    clock: Callable[[], float] | None = None
    searches: int = 0
    asked: list[RuleUse] = field(default_factory=list)
    latest: Context | None = None
    """That of the diagnosis which ran last within this one: every rule that was asked there."""

    def fresh(self) -> Context:
        """The same switches, and nothing asked yet; kept as ``latest``."""
        self.latest = Context(self.without, self.clock)
        return self.latest

    def fired(self) -> list[dict[str, Any]]:
        """``details.rules``: the rules that changed anything, in the order in which they did."""
        return [a.to_json() for a in self.asked if a.changed]


_current: ContextVar[Context] = ContextVar("context of the diagnosis")


def current_context() -> Context:
    """The context of the diagnosis that runs; all rules on, where none does."""
    return _current.get(Context())


@contextmanager
def use_context(context: Context) -> Iterator[Context]:
    """Context manager: within it rules are asked in this context."""
    token = _current.set(context)
    try:
        yield context
    finally:
        _current.reset(token)


def context_without(names: Collection[str], clock: Callable[[], float] | None = None) -> Context:
    """A context with these rules off; InputError where there is no rule of a name."""
    known = rules_by_name()
    for name in names:
        if name not in known:
            raise InputError(f"--without-rule {name}: no rule of that name; there are {', '.join(known)}")
    return Context(frozenset(names), clock)


def rules_by_name() -> Mapping[str, Rule]:
    """All rules in the order in which they are asked."""
    known: Mapping[str, Rule] = rules.BY_NAME
    return known


def apply_rule(name: str, *given: Any, **options: Any) -> Any:
    """What a rule makes of what it is given; what there would be without it, where it is off."""
    rule, context = rules_by_name()[name], current_context()
    if name in context.without:
        return rule.without(*given, **options)
    if not rule.applies(*given, **options):
        return rule.without(*given, **options)
    begin = 0.0 if context.clock is None else context.clock()
    what = name.replace("-", " ")
    if rule.stage not in CHEAP and budget.is_left_out(what):
        return rule.without(*given, **options)
    try:
        found = rule.apply(*given, **options)
    except budget.BudgetSpent:
        budget.leave_out(what)
        return rule.without(*given, **options)
    spent = None if context.clock is None else context.clock() - begin
    plain = rule.without(*given, **options)
    costs = chi2_of(given[0] if given else None), chi2_of(found)
    changed = not _same(found, plain)
    chi2 = None if not changed or costs[0] is None or costs[1] is None else (costs[0], costs[1])
    context.asked.append(RuleUse(name, rule.stage, max(context.searches, 1), changed, chi2, spent))
    return found


def _same(one: object, other: object) -> bool:
    """Whether a rule handed on what there would be without it."""
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(_same(a, b) for a, b in zip(one, other, strict=True))
    return one is other or (isinstance(one, bool | float | str) and one == other)


def chi2_of(value: object) -> float | None:
    """χ² of what a rule hands on, where it has one: of a fit, a trial, a step, a selection or the best of
    several."""
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
