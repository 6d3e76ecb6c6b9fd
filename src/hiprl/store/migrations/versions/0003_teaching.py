"""What a person needs who answers: films of trajectories, the scene they play in, the goal in words, and claims."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """From revision 0002 to 0003: old trajectories have no film, and old questions do not say what was at hand."""
    moment = sa.DateTime(timezone=True)
    number = sa.BigInteger().with_variant(sa.Integer, "sqlite")
    op.add_column("trajectories", sa.Column("film", sa.LargeBinary))
    op.add_column("questions", sa.Column("at_hand", sa.Integer))
    op.create_table(
        "scenes",
        sa.Column("run_id", sa.Text, sa.ForeignKey("runs.id"), primary_key=True),
        sa.Column("scene", sa.Text, nullable=False),
    )
    op.create_table(
        "goals",
        sa.Column("id", number, primary_key=True),
        sa.Column("run_id", sa.Text, sa.ForeignKey("runs.id"), nullable=False, index=True),
        sa.Column("words", sa.Text, nullable=False),
        sa.Column("created_at", moment, nullable=False),
    )
    op.create_table(
        "claims",
        sa.Column("question_id", number, sa.ForeignKey("questions.id"), primary_key=True, autoincrement=False),
        sa.Column("judge", sa.Text, nullable=False),
        sa.Column("expires_at", moment, nullable=False),
    )
