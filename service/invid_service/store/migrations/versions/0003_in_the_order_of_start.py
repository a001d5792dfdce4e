"""Runs are numbered in the order in which they were started: a clock may be set back, a history may not."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply; what is there is numbered by its clock, the only order that was kept."""
    op.add_column("runs", sa.Column("number", sa.Integer(), nullable=False, server_default="0"))
    runs = sa.table("runs", sa.column("id", sa.String()), sa.column("number"), sa.column("created"))
    connection = op.get_bind()
    identities = connection.execute(sa.select(runs.c.id).order_by(runs.c.created, runs.c.id)).scalars()
    numbered = [{"identity": identity, "to": n} for n, identity in enumerate(identities, start=1)]
    if numbered:
        change = sa.update(runs).where(runs.c.id == sa.bindparam("identity"))
        connection.execute(change.values(number=sa.bindparam("to")), numbered)
    op.create_index("ix_runs_number", "runs", ["number"])
    op.drop_index("ix_runs_created", "runs")


def downgrade() -> None:
    """Undo."""
    op.create_index("ix_runs_created", "runs", ["created"])
    op.drop_index("ix_runs_number", "runs")
    op.drop_column("runs", "number")
