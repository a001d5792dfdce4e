"""Tell the service's log when a run began and how it ended; facts go beside the words, to filter by."""

from __future__ import annotations

import logging
from typing import Any

from invid_service.jobs.states import State
from invid_service.store.store import RunRecord

log = logging.getLogger(__name__)
FACTS = (
    "run",
    "cell",
    "mode",
    "axes",
    "caller",
    "state",
    "verdict",
    "grade",
    "headline",
    "error",
    "fix",
    "by",
)
"""Names of facts that a line of the log may carry."""
_AGAINST = {State.FAILED, State.STOPPED, State.INTERRUPTED}


def tell_began(record: RunRecord) -> None:
    """Log that a run was taken."""
    axes = ",".join(record.axes) or None
    _tell(logging.INFO, "run began", record, axes=axes, caller=record.requested_by)


def tell_ended(record: RunRecord) -> None:
    """Log that a run ended, or that its result awaits a decision, with its verdict or its error."""
    facts = record.facts
    summary, error, decision = (facts.get(name) or {} for name in ("summary", "error", "decision"))
    level = logging.WARNING if record.state in _AGAINST else logging.INFO
    _tell(
        level,
        "run awaits a decision" if record.state is State.AWAITING_ACCEPT else "run ended",
        record,
        state=str(record.state),
        **{name: summary.get(name) for name in ("verdict", "grade", "headline")},
        error=f"{error['code']}: {error['text']}" if error else None,
        fix=error.get("fix"),
        by=decision.get("by"),
    )


def _tell(level: int, what: str, record: RunRecord, **facts: Any) -> None:
    said = {"run": record.id, "cell": record.cell, "mode": record.mode, **facts}
    log.log(level, what, extra={name: value for name, value in said.items() if value is not None})
