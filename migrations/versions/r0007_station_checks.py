"""Checks of stations, line by line, with the frames of their reference ring; notes to instruments' identities."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # Earlier instruments have no notes.
    op.add_column("instruments", sa.Column("notes", sa.JSON(), nullable=True))
    op.create_table(
        "station_checks",
        sa.Column("check_id", sa.String(length=36), nullable=False),
        sa.Column("station", sa.Text(), nullable=False),
        sa.Column("operator", sa.Text(), nullable=False),
        sa.Column("checked_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("sensor_type", sa.Text(), nullable=False),
        sa.Column("configuration_digest", sa.String(length=64), nullable=False),
        sa.Column("software", sa.JSON(), nullable=False),
        sa.Column("instruments", sa.JSON(), nullable=False),
        sa.Column("outcome", sa.String(length=16), nullable=False),
        sa.Column("golden_run", sa.String(length=36), nullable=True),
        sa.ForeignKeyConstraint(["golden_run"], ["runs.run"], name=op.f("fk_station_checks_golden_run_runs")),
        sa.PrimaryKeyConstraint("check_id", name=op.f("pk_station_checks")),
    )
    op.create_index(op.f("ix_station_checks_station_check_id"), "station_checks", ["station", "check_id"])
    op.create_table(
        "station_check_lines",
        sa.Column("check_id", sa.String(length=36), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("subject", sa.Text(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("outcome", sa.String(length=16), nullable=False),
        sa.Column("value", sa.Double(), nullable=True),
        sa.Column("unit", sa.Text(), nullable=False),
        sa.Column("allowed", sa.Text(), nullable=False),
        sa.Column("said", sa.Text(), nullable=False),
        sa.Column("remedy", sa.Text(), nullable=False),
        _of_check("station_check_lines"),
        sa.PrimaryKeyConstraint("check_id", "number", name=op.f("pk_station_check_lines")),
    )
    op.create_table(
        "station_check_frames",
        sa.Column("check_id", sa.String(length=36), nullable=False),
        sa.Column("resistances_ohm", sa.JSON(), nullable=False),
        sa.Column("frames", sa.Integer(), nullable=False),
        sa.Column("drives", sa.Integer(), nullable=False),
        sa.Column("measures", sa.Integer(), nullable=False),
        sa.Column("unit", sa.String(length=16), nullable=False),
        sa.Column("current_a", sa.Double(), nullable=True),
        sa.Column("first_s", sa.Double(), nullable=False),
        sa.Column("last_s", sa.Double(), nullable=False),
        sa.Column("time_s", sa.LargeBinary(), nullable=False),
        sa.Column("voltages", sa.LargeBinary(), nullable=False),
        sa.Column("flags", sa.LargeBinary(), nullable=False),
        sa.Column("reading_time_s", sa.LargeBinary(), nullable=True),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        _of_check("station_check_frames"),
        sa.PrimaryKeyConstraint("check_id", name=op.f("pk_station_check_frames")),
    )


def downgrade() -> None:
    op.drop_table("station_check_frames")
    op.drop_table("station_check_lines")
    op.drop_index(op.f("ix_station_checks_station_check_id"), table_name="station_checks")
    op.drop_table("station_checks")
    op.drop_column("instruments", "notes")


def _of_check(table: str) -> sa.ForeignKeyConstraint:
    name = op.f(f"fk_{table}_check_id_station_checks")
    return sa.ForeignKeyConstraint(["check_id"], ["station_checks.check_id"], name=name)
