"""A load that changes while the machine is measured: the period in which it does fits no plant."""

from __future__ import annotations

from invid.discrepancy.select import Selection
from invid.effects.base import Record


def around_change(selection: Selection) -> tuple[list[Record], list[Record]] | None:
    """Training and held-out records without the period in which the load changes; none where none does.

    That period is half of one plant, half of the other, with what the change sets ringing: no model here.
    """
    time = change_of(selection)
    if time is None:
        return None
    parts = [selection.final.fit.evaluation.records, selection.final.held.records]
    kept = [[r for r in part if not _within(r, time)] for part in parts]
    if kept == parts or not all(kept):
        return None
    return kept[0], kept[1]


def change_of(selection: Selection) -> float | None:
    """When the load changes [s], by the selected causes."""
    candidate = selection.final.fit.candidate
    for term, x in zip(candidate.terms, candidate.x, strict=True):
        if term.effect.cause == "payload_change":
            return float(x[1])
    return None


def _within(record: Record, time: float) -> bool:
    """Whether ``time`` is inside the record by more than its sampling."""
    return record.start_time + record.step < time < record.end_time - record.step
