"""References of control charts of stations, each beside the earlier ones; runs of a station by age."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "chart_references",
        sa.Column("reference", sa.String(length=36), nullable=False),
        sa.Column("station", sa.Text(), nullable=False),
        sa.Column("recipe", sa.Text(), nullable=False),
        sa.Column("golden", sa.Text(), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("phase", sa.Text(), nullable=False),
        sa.Column("qualifier", sa.Text(), nullable=False),
        sa.Column("location", sa.Text(), nullable=False),
        sa.Column("unit", sa.Text(), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("settings", sa.JSON(), nullable=False),
        sa.Column("mean", sa.Double(), nullable=False),
        sa.Column("deviation", sa.Double(), nullable=False),
        sa.Column("runs", sa.Integer(), nullable=False),
        sa.Column("first_run", sa.String(length=36), nullable=False),
        sa.Column("last_run", sa.String(length=36), nullable=False),
        sa.Column("operator", sa.Text(), nullable=False),
        sa.Column("made_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("why", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["first_run"], ["runs.run"], name=op.f("fk_chart_references_first_run_runs")),
        sa.ForeignKeyConstraint(["last_run"], ["runs.run"], name=op.f("fk_chart_references_last_run_runs")),
        sa.PrimaryKeyConstraint("reference", name=op.f("pk_chart_references")),
    )
    op.create_index(op.f("ix_chart_references_station_reference"), "chart_references", ["station", "reference"])
    # The latest runs of a station are looked up at the end of each run: 0.2 ms of 10 000 runs instead of 64 ms.
    op.create_index(op.f("ix_runs_station_run"), "runs", ["station", "run"])
    op.drop_index(op.f("ix_runs_station"), table_name="runs")


def downgrade() -> None:
    op.create_index(op.f("ix_runs_station"), "runs", ["station"])
    op.drop_index(op.f("ix_runs_station_run"), table_name="runs")
    op.drop_index(op.f("ix_chart_references_station_reference"), table_name="chart_references")
    op.drop_table("chart_references")
