"""Trajectories that nobody executed: what a policy does in the model."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """From revision 0004 to 0005: all that there was had been executed."""
    op.add_column("trajectories", sa.Column("imagined", sa.Boolean, nullable=False, server_default=sa.false()))
