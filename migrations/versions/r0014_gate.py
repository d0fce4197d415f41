"""Answers of the checks before a run, and releases of configuration files."""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # Runs of before have no answers: nothing was asked but for calibration dates.
    op.create_table(
        "gate_answers",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("session", sa.Integer(), nullable=False),
        sa.Column("subject", sa.String(length=32), nullable=False),
        sa.Column("policy", sa.String(length=16), nullable=False),
        sa.Column("outcome", sa.String(length=16), nullable=False),
        sa.Column("words", sa.Text(), nullable=False),
        sa.Column("remedy", sa.Text(), nullable=False),
        sa.Column("operator", sa.Text(), nullable=False),
        sa.Column("why", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["run"], ["runs.run"], name=op.f("fk_gate_answers_run_runs")),
        sa.PrimaryKeyConstraint("run", "session", "subject", name=op.f("pk_gate_answers")),
    )
    op.create_table(
        "releases",
        sa.Column("release_id", sa.String(length=36), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("outcome", sa.String(length=16), nullable=False),
        sa.Column("operator", sa.Text(), nullable=False),
        sa.Column("why", sa.Text(), nullable=False),
        sa.Column("noted_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("release_id", name=op.f("pk_releases")),
    )
    op.create_index(op.f("ix_releases_sha256_release_id"), "releases", ["sha256", "release_id"])


def downgrade() -> None:
    # The links of answers stay: the chain of a run with answers then misses rows, and the run is refused.
    op.drop_index(op.f("ix_releases_sha256_release_id"), table_name="releases")
    op.drop_table("releases")
    op.drop_table("gate_answers")
