"""The first schema."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

_ACTIVE = "state IN ('queued', 'checking', 'awaiting_arm', 'running', 'analysing') AND cell IS NOT NULL"


def upgrade() -> None:
    """Apply."""
    when = sa.DateTime(timezone=True)
    op.create_table(
        "runs",
        sa.Column("id", sa.String(40), primary_key=True),
        sa.Column("cell", sa.String(64), nullable=True, index=True),
        sa.Column("robot", sa.Text, nullable=False),
        sa.Column("mode", sa.String(16), nullable=False),
        sa.Column("axes", sa.JSON, nullable=False),
        sa.Column("simulated", sa.Boolean, nullable=False),
        sa.Column("state", sa.String(20), nullable=False, index=True),
        sa.Column("created", when, nullable=False),
        sa.Column("started", when, nullable=True),
        sa.Column("ended", when, nullable=True),
        sa.Column("requested_by", sa.Text, nullable=False),
        sa.Column("facts", sa.JSON, nullable=False),
    )
    op.create_index(
        "one_run_per_cell",
        "runs",
        ["cell"],
        unique=True,
        sqlite_where=sa.text(_ACTIVE),
        postgresql_where=sa.text(_ACTIVE),
    )
    op.create_table(
        "events",
        sa.Column("run", sa.String(40), sa.ForeignKey("runs.id"), primary_key=True),
        sa.Column("id", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("type", sa.String(20), nullable=False),
        sa.Column("data", sa.JSON, nullable=False),
    )
    op.create_table(
        "artefacts",
        sa.Column("run", sa.String(40), sa.ForeignKey("runs.id"), primary_key=True),
        sa.Column("kind", sa.String(20), primary_key=True),
        sa.Column("path", sa.Text, nullable=False),
        sa.Column("size", sa.BigInteger, nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("created", when, nullable=False),
        sa.Column("deleted", when, nullable=True),
    )
    op.create_table(
        "models",
        sa.Column("id", sa.String(40), primary_key=True),
        sa.Column("cell", sa.String(64), nullable=False, index=True),
        sa.Column("created", when, nullable=False),
        sa.Column("mode", sa.String(16), nullable=False),
        sa.Column("document", sa.Text, nullable=False),
    )
    op.create_table(
        "approvals",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("cell", sa.String(64), nullable=False, index=True),
        sa.Column("model", sa.String(40), sa.ForeignKey("models.id"), nullable=False),
        sa.Column("at", when, nullable=False),
        sa.Column("by", sa.Text, nullable=False),
        sa.Column("how", sa.String(10), nullable=False),
    )
    op.create_table(
        "idempotency",
        sa.Column("cell", sa.String(64), primary_key=True),
        sa.Column("key", sa.String(255), primary_key=True),
        sa.Column("body_sha256", sa.String(64), nullable=False),
        sa.Column("run", sa.String(40), sa.ForeignKey("runs.id"), nullable=False),
        sa.Column("created", when, nullable=False),
    )


def downgrade() -> None:
    """Undo."""
    for table in ("idempotency", "approvals", "models", "artefacts", "events", "runs"):
        op.drop_table(table)
