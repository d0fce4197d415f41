"""Records of runs: sensors, runs, phases, frames, samples and presses."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

#: In the order they refer to each other.
TABLES = (
    "sensors",
    "runs",
    "run_states",
    "instruments",
    "phases",
    "steps",
    "frame_blocks",
    "sample_blocks",
    "loads",
    "unloaded_marks",
)


def upgrade() -> None:
    _create_sensors()
    _create_runs()
    _create_run_states()
    _create_instruments()
    _create_phases()
    _create_steps()
    _create_frame_blocks()
    _create_sample_blocks()
    _create_loads()
    _create_unloaded_marks()


def downgrade() -> None:
    for table in reversed(TABLES):
        op.drop_table(table)


def _create_sensors() -> None:
    op.create_table(
        "sensors",
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("batch", sa.Text(), nullable=False),
        sa.Column("sensor_type", sa.Text(), nullable=False),
        sa.Column("first_seen", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("serial", name=op.f("pk_sensors")),
    )


def _create_runs() -> None:
    op.create_table(
        "runs",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("batch", sa.Text(), nullable=False),
        sa.Column("sensor_type", sa.Text(), nullable=False),
        sa.Column("station", sa.Text(), nullable=False),
        sa.Column("recipe", sa.Text(), nullable=False),
        sa.Column("operator", sa.Text(), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("configuration", sa.Text(), nullable=False),
        sa.Column("configuration_digest", sa.String(length=64), nullable=False),
        sa.Column("software", sa.JSON(), nullable=False),
        sa.Column("simulated", sa.JSON(), nullable=False),
        sa.Column("setting", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(["serial"], ["sensors.serial"], name=op.f("fk_runs_serial_sensors")),
        sa.PrimaryKeyConstraint("run", name=op.f("pk_runs")),
    )
    op.create_index(op.f("ix_runs_batch"), "runs", ["batch"], unique=False)
    op.create_index(op.f("ix_runs_serial_run"), "runs", ["serial", "run"], unique=False)
    op.create_index(op.f("ix_runs_station"), "runs", ["station"], unique=False)


def _create_run_states() -> None:
    op.create_table(
        "run_states",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("end", sa.Text(), nullable=False),
        sa.Column("detail", sa.Text(), nullable=False),
        sa.Column("time_s", sa.Double(), nullable=False),
        sa.Column("spent", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(["run"], ["runs.run"], name=op.f("fk_run_states_run_runs")),
        sa.PrimaryKeyConstraint("run", "number", name=op.f("pk_run_states")),
    )


def _create_instruments() -> None:
    op.create_table(
        "instruments",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("position", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("role", sa.Text(), nullable=False),
        sa.Column("driver", sa.Text(), nullable=False),
        sa.Column("model", sa.Text(), nullable=False),
        sa.Column("serial", sa.Text(), nullable=False),
        sa.Column("firmware", sa.Text(), nullable=False),
        sa.Column("simulated", sa.Boolean(), nullable=False),
        sa.Column("calibration_due", sa.Text(), nullable=True),
        sa.ForeignKeyConstraint(["run"], ["runs.run"], name=op.f("fk_instruments_run_runs")),
        sa.PrimaryKeyConstraint("run", "position", name=op.f("pk_instruments")),
    )


def _create_phases() -> None:
    op.create_table(
        "phases",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("phase", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("sequence", sa.Text(), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("started_s", sa.Double(), nullable=False),
        sa.Column("ended_s", sa.Double(), nullable=True),
        sa.ForeignKeyConstraint(["run"], ["runs.run"], name=op.f("fk_phases_run_runs")),
        sa.PrimaryKeyConstraint("run", "phase", name=op.f("pk_phases")),
    )


def _create_steps() -> None:
    op.create_table(
        "steps",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("phase", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("entry", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("step", sa.JSON(), nullable=False),
        sa.Column("why", sa.Text(), nullable=False),
        sa.Column("time_s", sa.Double(), nullable=True),
        sa.ForeignKeyConstraint(
            ["run", "phase"], ["phases.run", "phases.phase"], name=op.f("fk_steps_run_phase_phases")
        ),
        sa.PrimaryKeyConstraint("run", "phase", "entry", name=op.f("pk_steps")),
    )


def _create_frame_blocks() -> None:
    op.create_table(
        "frame_blocks",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("phase", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("block", sa.Integer(), autoincrement=False, nullable=False),
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
        sa.ForeignKeyConstraint(
            ["run", "phase"], ["phases.run", "phases.phase"], name=op.f("fk_frame_blocks_run_phase_phases")
        ),
        sa.PrimaryKeyConstraint("run", "phase", "block", name=op.f("pk_frame_blocks")),
    )


def _create_sample_blocks() -> None:
    op.create_table(
        "sample_blocks",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("phase", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("block", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("channel", sa.Text(), nullable=False),
        sa.Column("unit", sa.String(length=16), nullable=False),
        sa.Column("samples", sa.Integer(), nullable=False),
        sa.Column("time_s", sa.LargeBinary(), nullable=False),
        sa.Column("sample_values", sa.LargeBinary(), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(
            ["run", "phase"], ["phases.run", "phases.phase"], name=op.f("fk_sample_blocks_run_phase_phases")
        ),
        sa.PrimaryKeyConstraint("run", "phase", "block", name=op.f("pk_sample_blocks")),
    )


def _create_loads() -> None:
    op.create_table(
        "loads",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("phase", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("load_index", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("label", sa.Text(), nullable=False),
        sa.Column("x_mm", sa.Double(), nullable=False),
        sa.Column("y_mm", sa.Double(), nullable=False),
        sa.Column("strain", sa.Double(), nullable=False),
        sa.Column("trial", sa.Integer(), nullable=False),
        sa.Column("press_start_s", sa.Double(), nullable=False),
        sa.Column("hold_start_s", sa.Double(), nullable=False),
        sa.Column("release_start_s", sa.Double(), nullable=False),
        sa.Column("release_end_s", sa.Double(), nullable=False),
        sa.Column("rest_end_s", sa.Double(), nullable=False),
        sa.Column("clear_s", sa.Double(), nullable=True),
        sa.ForeignKeyConstraint(
            ["run", "phase"], ["phases.run", "phases.phase"], name=op.f("fk_loads_run_phase_phases")
        ),
        sa.PrimaryKeyConstraint("run", "phase", "load_index", name=op.f("pk_loads")),
    )


def _create_unloaded_marks() -> None:
    op.create_table(
        "unloaded_marks",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("phase", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("mark", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("time_s", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(
            ["run", "phase"], ["phases.run", "phases.phase"], name=op.f("fk_unloaded_marks_run_phase_phases")
        ),
        sa.PrimaryKeyConstraint("run", "phase", "mark", name=op.f("pk_unloaded_marks")),
    )
