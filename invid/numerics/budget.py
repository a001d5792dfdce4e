"""Bound how long a computation takes and report how far it is, at the heads of its loops.

The budget in force is a context variable: searches and fits are reached through thirty functions that
neither know nor need it. No clock is read here; whoever sets a budget
gives it one (``run_clock``: processor time). Without a budget nothing is ever spent, and the same data give
the same answer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TypeVar

from invid.wording.sentence import Sentence, joined, marked, sentence

T = TypeVar("T")

SEEN = 0.03
"""Share of the work from which the time it took says how long the rest will take. A guess."""


class BudgetSpent(Exception):
    """No time is left; caught where there is an answer so far."""


@dataclass(frozen=True)
class Found:
    """A cause found so far, and where."""

    cause: str
    axis: str
    other_axis: str | None = None
    element: str | None = None

    def __str__(self) -> str:
        """ "backlash A2 spring 1"."""
        words = (self.cause.replace("_", " "), self.axis, self.other_axis, self.element)
        return " ".join(word for word in words if word)


@dataclass(frozen=True)
class Progress:
    """How far a computation is.

    ``stage`` says in words what is done, ``cause``, ``axis`` and ``element`` for what and where, ``fraction``
    (0 to 1) how much of the work lies behind, ``seconds_left`` how long the rest will take, at most; ``None``
    where that cannot be told yet.
    """

    stage: str
    axis: str | None = None
    cause: str | None = None
    fraction: float = 0.0
    seconds_left: float | None = None
    element: str | None = None
    found: tuple[Found, ...] = ()
    """The causes found so far; the search still looks."""

    def __str__(self) -> str:
        """ "weighing backlash, A2 spring 1"."""
        cause = None if self.cause is None else self.cause.replace("_", " ")
        what = " ".join(word for word in (self.stage, cause) if word)
        where = " ".join(word for word in (self.axis, self.element) if word)
        return sentence("{stage}, {where}", stage=what, where=where) if where else what


@dataclass(eq=False)
class Budget:
    """``seconds`` from now on by ``clock`` [s], ``None`` for no end; ``report`` is called with progress."""

    seconds: float | None
    clock: Callable[[], float]
    report: Callable[[Progress], None] | None = None
    began: float = field(init=False)
    end: float = field(init=False)
    reach: tuple[float, float] = (0.0, 1.0)
    """Shares of the whole between which the present part lies."""
    behind: float = 0.0
    left_out: list[str] = field(default_factory=list)
    found: tuple[Found, ...] = ()
    is_stopped: bool = False
    """Whether somebody asked for the best answer so far (``stop``)."""

    def __post_init__(self) -> None:
        self.began = self.clock()
        self.end = float("inf") if self.seconds is None else self.began + self.seconds


_IN_FORCE: ContextVar[Budget | None] = ContextVar("invid_budget", default=None)


@contextmanager
def use_budget(budget: Budget | None) -> Iterator[None]:
    """Context manager in which ``budget`` is in force; with ``None`` the one already in force, if any."""
    if budget is None:
        yield
        return
    token = _IN_FORCE.set(budget)
    try:
        yield
    finally:
        _IN_FORCE.reset(token)


@contextmanager
def use_share(share: float, low: float = 0.0, high: float = 1.0) -> Iterator[None]:
    """Context manager for a part of the work: a share of the time that is left, and of the progress
    from ``low`` to ``high``.
    """
    budget = _IN_FORCE.get()
    if budget is None:
        yield
        return
    end, reach = budget.end, budget.reach
    width = reach[1] - reach[0]
    budget.reach = reach[0] + low * width, reach[0] + high * width
    if budget.seconds is not None:
        now = budget.clock()
        budget.end = now + share * max(end - now, 0.0)
    try:
        yield
    finally:
        budget.end, budget.reach = end, reach


def is_spent() -> bool:
    """Return whether the budget in force, or that of the present part, is used up."""
    budget = _IN_FORCE.get()
    return budget is not None and (
        budget.is_stopped or (budget.seconds is not None and budget.clock() >= budget.end)
    )


def stop() -> bool:
    """Spend the budget in force here and now, for the best answer so far; False where there is none."""
    budget = _IN_FORCE.get()
    if budget is None or budget.is_stopped:
        return False
    budget.is_stopped = True
    return True


def check() -> None:
    """Raise BudgetSpent where the budget is used up."""
    if is_spent():
        raise BudgetSpent


FURTHER_CAUSES = sentence("further causes")
"""What a spent budget leaves out without which nothing is certain."""


def leave_out(what: str) -> None:
    """Note what was not looked at, for the result's warnings."""
    budget = _IN_FORCE.get()
    if budget is not None and what not in budget.left_out:
        budget.left_out.append(what)


def is_left_out(what: str) -> bool:
    """Return whether the budget is used up, and note what is not looked at for that."""
    if not is_spent():
        return False
    leave_out(what)
    return True


def or_else(what: str, run: Callable[[], T], otherwise: T) -> T:
    """Return what ``run`` returns, or ``otherwise`` where the budget is used up before or meanwhile;
    ``what`` is then noted as not looked at.
    """
    if is_left_out(what):
        return otherwise
    try:
        return run()
    except BudgetSpent:
        leave_out(what)
        return otherwise


def left_out() -> Sequence[str]:
    """All that was not looked at so far."""
    budget = _IN_FORCE.get()
    return () if budget is None else tuple(budget.left_out)


_LEFT_OUT = marked(
    "{spent}; this is the best answer so far, nothing is concluded from what was not looked at: "
    "{left} ({way_out})"
)


def warning() -> str | None:
    """Return the warning about what was not looked at; ``None`` where everything was."""
    budget = _IN_FORCE.get()
    if budget is None or not budget.left_out:
        return None
    if budget.is_stopped or budget.seconds is None:
        spent = sentence("the budget of this search was ended by whoever waited")
        way_out = sentence("let it run to its end")
    else:
        used = budget.clock() - budget.began
        spent = sentence(
            "the budget of {seconds:g} s of the processor, at most twice that on the clock, was spent",
            seconds=budget.seconds,
        )
        if used < budget.seconds:
            spent = sentence(
                "the budget of {seconds:g} s of the processor, at most twice that on the clock, ended "
                "parts of the work at their shares of it, after {used:.2g} s in all",
                seconds=budget.seconds,
                used=used,
            )
        larger = marked("a larger --budget than {seconds:g} lets the search end by itself")
        way_out = sentence(larger, seconds=budget.seconds)
    return sentence(_LEFT_OUT, spent=spent, left=joined(budget.left_out, "; "), way_out=way_out)


def is_warning(text: str) -> bool:
    """Return whether a text is what ``warning`` returned."""
    return isinstance(text, Sentence) and text.template == _LEFT_OUT


def tell(
    stage: str,
    fraction: float,
    *,
    axis: str | None = None,
    cause: str | None = None,
    element: str | None = None,
) -> None:
    """Report progress; ``fraction`` is of the present part. It never goes back."""
    budget = _IN_FORCE.get()
    if budget is None or budget.report is None:
        return
    low, high = budget.reach
    budget.behind = max(budget.behind, low + min(max(fraction, 0.0), 1.0) * (high - low))
    now = budget.clock()
    left = None if budget.seconds is None else max(budget.began + budget.seconds - now, 0.0)
    if budget.behind > SEEN:
        rest = (now - budget.began) * (1.0 - budget.behind) / budget.behind
        left = rest if left is None else min(left, rest)
    budget.report(Progress(stage, axis, cause, budget.behind, left, element, budget.found))


def tell_found(causes: Sequence[Found]) -> None:
    """Report the causes found so far, while the search still looks."""
    budget = _IN_FORCE.get()
    if budget is None:
        return
    budget.found = tuple(causes)
    tell("still looking", 0.0)
