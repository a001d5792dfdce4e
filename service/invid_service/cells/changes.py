"""Show the comparison of two models in the interface: one entry a parameter."""

from __future__ import annotations

from typing import Any

from invid.comparison.changes import Change, Comparison
from invid.wording.sentence import joined


def changes_view(c: Comparison, sides: tuple[list[str], list[str]]) -> dict[str, Any]:
    """Return the body of ``GET /cells/{cell}/changes``, without the names of the two models.

    ``sides``: the models that the old and the new side are the mean of.
    """
    return {
        "sentence": joined(c.sentences, " "),
        "sentences": list(c.sentences),
        "headline": c.headline,
        "parameters": [_entry(p) for p in c.parameters],
        "effects": [_entry(p) for p in c.effects],
        "causes": [_entry(x) for x in c.causes],
        "structure": list(c.structure),
        "false_alarm_rate": c.alpha,
        "repeatability": {"factor": c.repeatability.factor, "pairs": c.repeatability.pairs},
        "averaged": {"from": sides[0], "to": sides[1]},
        "warnings": list(c.warnings),
    }


def _entry(c: Change) -> dict[str, Any]:
    """One number or cause; of a number its rivals too."""
    document = c.to_json()
    document["from"], document["to"] = document.pop("old"), document.pop("new")
    document["difference_std"] = document.pop("std")
    document["reason"] = c.why or None
    return document if c.is_cause else {**document, "rivals": list(c.rivals)}
