"""An uploaded recording may belong to a cell; it moves nothing, so any number may be analysed at a time."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

_BEFORE = "state IN ('queued', 'checking', 'awaiting_arm', 'running', 'analysing') AND cell IS NOT NULL"
_AFTER = f"{_BEFORE} AND mode <> 'upload'"


def _replace(condition: str) -> None:
    op.drop_index("one_run_per_cell", "runs")
    where = sa.text(condition)
    op.create_index(
        "one_run_per_cell", "runs", ["cell"], unique=True, sqlite_where=where, postgresql_where=where
    )


def upgrade() -> None:
    """Apply."""
    _replace(_AFTER)


def downgrade() -> None:
    """Undo."""
    _replace(_BEFORE)
