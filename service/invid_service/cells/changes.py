"""Show the comparison of two models in the interface: one entry a parameter."""

from __future__ import annotations

from typing import Any

from invid.comparison.changes import CauseChange, Change, Comparison
from invid.wording.statement import LANGUAGES


def changes_view(c: Comparison, sides: tuple[list[str], list[str]]) -> dict[str, Any]:
    """Return the body of ``GET /cells/{cell}/changes``, without the names of the two models.

    ``sides``: the models that the old and the new side are the mean of.
    """
    return {
        "sentence": " ".join(c.sentences),
        "sentences": list(c.sentences),
        "headlines": c.headlines,
        "lines": {language: list(c.sentences_in(language)) for language in LANGUAGES},
        "parameters": [_entry(p) for p in c.parameters],
        "effects": [_entry(p) for p in c.effects],
        "causes": [_cause(x) for x in c.causes],
        "structure": list(c.structure),
        "false_alarm_rate": c.alpha,
        "repeatability": {"factor": c.repeatability.factor, "pairs": c.repeatability.pairs},
        "averaged": {"from": sides[0], "to": sides[1]},
        "warnings": list(c.warnings),
    }


def _cause(c: CauseChange) -> dict[str, Any]:
    document = c.to_json()
    document["from"], document["to"] = document.pop("old"), document.pop("new")
    document["difference_std"] = document.pop("std")
    document["reason"] = c.reason or None
    return document


def _entry(p: Change) -> dict[str, Any]:
    return {
        "parameter": p.name,
        "label": p.label,
        "axis": p.axis,
        "kind": p.kind,
        "unit": p.unit,
        "status": str(p.status),
        "from": None if p.old is None else {"value": p.old.value, "std": p.old.std},
        "to": None if p.new is None else {"value": p.new.value, "std": p.new.std},
        "difference": p.difference,
        "difference_std": p.std,
        "within_percent": None if p.bound is None else 100.0 * p.bound,
        "detectable_percent": None if p.detectable is None else 100.0 * p.detectable,
        "reason": p.reason or None,
        "rivals": list(p.rivals),
    }
