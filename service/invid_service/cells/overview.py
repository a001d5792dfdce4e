"""Summarise a cell in one line of the plant's list: what it does, what its last run found, what changed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from invid.wording.statement import LANGUAGES
from invid_service.cells.readiness import Readiness
from invid_service.cells.schema import LastRun, Overview
from invid_service.jobs.live import LiveRun
from invid_service.jobs.states import ENDED, State
from invid_service.store.store import RunRecord

_NEWS = {"appeared", "grew", "shrank", "gone", "changed"}


def overview(runs: Sequence[RunRecord], occupied_by: LiveRun | None, ready: Readiness) -> Overview:
    """Return the line of a cell; ``runs`` are its measurements, the last started first."""
    done = [r for r in runs if r.state in ENDED or r.state is State.AWAITING_ACCEPT]
    last = done[0] if done else None
    changes = None if last is None else (last.facts.get("summary") or {}).get("changes")
    if occupied_by is not None:
        state = str(occupied_by.record.state)
    elif last is not None and last.state is State.AWAITING_ACCEPT:
        state = str(last.state)
    else:
        state = ("ready" if ready.is_asked else "unknown") if ready.can_start else "not_ready"
    return Overview(
        state=state,
        last_run=None if last is None else _last_run(last),
        changed=str(changes["sentence"]) if changes is not None and _has_news(changes) else None,
        news=None if changes is None else _news(changes),
    )


def _last_run(run: RunRecord) -> LastRun:
    summary = run.facts.get("summary") or {}
    return LastRun(
        id=run.id,
        state=run.state,
        ended=run.ended,
        verdict=summary.get("verdict"),
        headline=summary.get("headline") or (run.facts.get("error") or {}).get("text"),
        grade=summary.get("grade"),
    )


def _has_news(changes: dict[str, Any] | None) -> bool:
    if changes is None:
        return False
    found = [*changes.get("parameters", []), *changes.get("causes", []), *changes.get("effects", [])]
    return any(entry.get("status") in _NEWS for entry in found) or bool(changes.get("structure"))


def _news(changes: dict[str, Any]) -> dict[str, str]:
    """Return the first of what changed by language; a run of an earlier release tells none."""
    if not _has_news(changes):
        return dict.fromkeys(LANGUAGES, "")
    return {language: lines[0] for language, lines in changes.get("lines", {}).items() if lines}
