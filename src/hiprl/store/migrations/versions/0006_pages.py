"""What the pages on a store know browsers by: it outlives them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """From revision 0005 to 0006: no page has been opened yet."""
    op.create_table(
        "pages",
        sa.Column("number", sa.Integer, nullable=False, autoincrement=False),
        sa.Column("secret", sa.Text, nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("number", name="pk_pages"),
        sa.CheckConstraint("number = 1", name="ck_pages_one"),
    )
