"""List why a result is no model to run a robot with: typed reasons, the weightiest first."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from invid.clauses import doubt_sentence
from invid.model.doubts import Doubt, DoubtCode, by_weight, doubts_of

Reason = dict[str, Any]
"""``code``, ``values``, ``text`` (the long sentence) and ``short``, what it comes to."""


def doubts_against(mode: str, summary: Mapping[str, Any]) -> tuple[Doubt, ...]:
    """Return what speaks against a result, by weight: its model, its verdict, how it was measured."""
    found = list(doubts_of(summary))
    if summary.get("verdict") == "unexplained":
        found.append(Doubt(DoubtCode.UNEXPLAINED, ""))
    if mode == "test":
        found.append(Doubt(DoubtCode.TEST, ""))
    return by_weight(found)


def doubt_view(doubt: Doubt) -> Reason:
    """Return a reason as the interface shows it."""
    short = doubt_sentence(doubt)
    return {**doubt.to_json(), "text": doubt.text or short, "short": short}


def why_untrusted(mode: str, summary: Mapping[str, Any] | None) -> str | None:
    """Return the weightiest reason in words; ``None`` where nothing speaks against accepting a result, or
    where it is of a short check or of the drives' loops, which nobody accepts.
    """
    if summary is None or mode in ("screen", "verify"):
        return None
    known = summary.get("doubts")
    if known is None:  # a run of an earlier release
        known = [doubt_view(d) for d in doubts_against(mode, summary)]
    return known[0].get("short", known[0]["text"]) if known else None
