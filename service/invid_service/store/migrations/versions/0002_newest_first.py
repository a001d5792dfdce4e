"""An index for listing the newest runs first: without it the list slows down with its history."""

from __future__ import annotations

from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply."""
    op.create_index("ix_runs_created", "runs", ["created"])


def downgrade() -> None:
    """Undo."""
    op.drop_index("ix_runs_created", "runs")
