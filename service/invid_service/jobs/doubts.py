"""List why a result is no model to run a robot with: typed reasons, the weightiest first."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from invid.model.doubts import Doubt, DoubtCode, by_weight, doubts_of
from invid.wording.clauses import doubt_statement
from invid.wording.statement import ENGLISH, LANGUAGES, say

Reason = dict[str, Any]
"""``code``, ``values``, ``text`` (the long sentence, English) and ``texts`` by language."""


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
    said = doubt_statement(doubt)
    texts = {language: say(said, language) for language in LANGUAGES}
    return {**doubt.to_json(), "text": doubt.text or texts[ENGLISH], "texts": texts}


def why_untrusted(mode: str, summary: Mapping[str, Any] | None) -> str | None:
    """Return the weightiest reason in words; ``None`` where nothing speaks against accepting a result, or
    where it is of a short check or of the drives' loops, which nobody accepts.
    """
    if summary is None or mode in ("screen", "verify"):
        return None
    known = summary.get("doubts")
    if known is None:  # a run of an earlier release
        known = [doubt_view(d) for d in doubts_against(mode, summary)]
    return str(known[0]["texts"][ENGLISH]) if known else None
