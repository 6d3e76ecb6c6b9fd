"""Questions about clips, and answers of every kind."""

from __future__ import annotations

import json

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """From revision 0001 to 0002: an old question compares two whole trajectories, an old answer is a number."""
    op.add_column("questions", sa.Column("clips", sa.Text))
    op.add_column("answers", sa.Column("said", sa.Text))
    _fill_in()
    # SQLite alters a table by copying it, and drops none that another one refers to.
    with op.batch_alter_table("answers") as answers:
        answers.drop_constraint("fk_answers_question_id", type_="foreignkey")
    with op.batch_alter_table("questions") as questions:
        questions.alter_column("clips", existing_type=sa.Text, nullable=False)
    with op.batch_alter_table("answers") as answers:
        answers.alter_column("said", existing_type=sa.Text, nullable=False)
        answers.alter_column("g", existing_type=sa.Double, nullable=True)
        answers.create_foreign_key("fk_answers_question_id", "questions", ["question_id"], ["id"])


def _fill_in() -> None:
    """The new columns of the old rows. In Python: SQLite writes a number with 15 digits, which loses its last bits."""
    connection = op.get_bind()
    questions = sa.table("questions", *map(sa.column, ("id", "first", "second", "clips")))
    for row in connection.execute(sa.select(questions.c.id, questions.c.first, questions.c.second)).all():
        clips = json.dumps([[row.first, 0, None], [row.second, 0, None]])
        connection.execute(sa.update(questions).where(questions.c.id == row.id).values(clips=clips))
    answers = sa.table("answers", *map(sa.column, ("id", "g", "said")))
    for row in connection.execute(sa.select(answers.c.id, answers.c.g)).all():
        said = json.dumps({"form": "number", "value": row.g})
        connection.execute(sa.update(answers).where(answers.c.id == row.id).values(said=said))
