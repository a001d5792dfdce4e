"""Write the service's log to stderr, as JSON lines or text: when a run began, how it ended."""

from __future__ import annotations

import logging
import sys
from typing import Any

import structlog

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


def configure_logging(*, json_lines: bool) -> None:
    """Set one formatter for our own and the libraries' records."""
    renderer: structlog.typing.Processor = (
        structlog.processors.JSONRenderer() if json_lines else structlog.dev.ConsoleRenderer(colors=False)
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, renderer],
            foreign_pre_chain=[
                structlog.stdlib.add_log_level,
                structlog.stdlib.add_logger_name,
                structlog.stdlib.ExtraAdder(FACTS),
                structlog.processors.TimeStamper(fmt="iso", utc=True),
                structlog.processors.format_exc_info,
            ],
        )
    )
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.INFO)
    for noisy in ("alembic", "uvicorn.access"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
