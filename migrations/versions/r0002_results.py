"""Results: analyses with their measurements, and calibrations with their rows."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

#: In the order they refer to each other.
TABLES = (
    "analyses",
    "warnings",
    "measurements",
    "calibrations",
    "calibration_baselines",
    "calibration_settling",
    "calibration_relaxations",
    "calibration_parameters",
    "calibration_overlap_bands",
)


def upgrade() -> None:
    _create_analyses()
    _create_warnings()
    _create_measurements()
    _create_calibrations()
    _create_calibration_baselines()
    _create_calibration_settling()
    _create_calibration_relaxations()
    _create_calibration_parameters()
    _create_calibration_overlap_bands()


def downgrade() -> None:
    for table in reversed(TABLES):
        op.drop_table(table)


def _create_analyses() -> None:
    op.create_table(
        "analyses",
        sa.Column("analysis", sa.String(length=36), nullable=False),
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("analysed_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("software", sa.JSON(), nullable=False),
        sa.Column("outcome", sa.String(length=16), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("calibration_why", sa.Text(), nullable=False),
        sa.Column("compute_s", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(["run"], ["runs.run"], name=op.f("fk_analyses_run_runs")),
        sa.PrimaryKeyConstraint("analysis", name=op.f("pk_analyses")),
    )
    op.create_index(op.f("ix_analyses_run_analysis"), "analyses", ["run", "analysis"], unique=False)


def _create_warnings() -> None:
    op.create_table(
        "warnings",
        sa.Column("analysis", sa.String(length=36), nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["analysis"], ["analyses.analysis"], name=op.f("fk_warnings_analysis_analyses")),
        sa.PrimaryKeyConstraint("analysis", "number", name=op.f("pk_warnings")),
    )


def _create_measurements() -> None:
    op.create_table(
        "measurements",
        sa.Column("analysis", sa.String(length=36), nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("value", sa.Double(), nullable=True),
        sa.Column("unit", sa.Text(), nullable=False),
        sa.Column("uncertainty", sa.Double(), nullable=True),
        sa.Column("phase", sa.Text(), nullable=False),
        sa.Column("location", sa.Text(), nullable=False),
        sa.Column("trial", sa.Integer(), nullable=True),
        sa.Column("qualifier", sa.Text(), nullable=False),
        sa.Column("how", sa.Text(), nullable=False),
        sa.Column("bound", sa.String(length=16), nullable=False),
        sa.Column("load_index", sa.Integer(), nullable=True),
        sa.Column("strain", sa.Double(), nullable=True),
        sa.Column("outcome", sa.String(length=16), nullable=False),
        sa.Column("limited", sa.Boolean(), nullable=False),
        sa.Column("lower_limit", sa.Double(), nullable=True),
        sa.Column("upper_limit", sa.Double(), nullable=True),
        sa.Column("marginal", sa.Double(), nullable=True),
        sa.Column("limit_phase", sa.Text(), nullable=True),
        sa.Column("limit_qualifier", sa.Text(), nullable=True),
        sa.ForeignKeyConstraint(["analysis"], ["analyses.analysis"], name=op.f("fk_measurements_analysis_analyses")),
        sa.PrimaryKeyConstraint("analysis", "number", name=op.f("pk_measurements")),
    )
    op.create_index(op.f("ix_measurements_name"), "measurements", ["name"], unique=False)


def _create_calibrations() -> None:
    op.create_table(
        "calibrations",
        sa.Column("calibration", sa.String(length=36), nullable=False),
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("analysis", sa.String(length=36), nullable=False),
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("issued_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("superseded_by", sa.String(length=36), nullable=True),
        sa.Column("response", sa.String(length=16), nullable=False),
        sa.Column("current_a", sa.Double(), nullable=False),
        sa.Column("scale", sa.Double(), nullable=False),
        sa.Column("noise_floor", sa.Double(), nullable=False),
        sa.Column("mask", sa.Double(), nullable=False),
        sa.Column("measured_noise_figure", sa.Double(), nullable=True),
        sa.Column("method", sa.Text(), nullable=False),
        sa.Column("regularisation", sa.Double(), nullable=False),
        sa.Column("regularisation_how", sa.Text(), nullable=False),
        sa.Column("noise_figure", sa.Double(), nullable=False),
        sa.Column("drives", sa.Integer(), nullable=False),
        sa.Column("measures", sa.Integer(), nullable=False),
        sa.Column("reference", sa.LargeBinary(), nullable=False),
        sa.Column("used", sa.LargeBinary(), nullable=False),
        sa.Column("reference_sha256", sa.String(length=64), nullable=False),
        sa.Column("overlap_threshold", sa.Double(), nullable=False),
        sa.Column("size_ratio_low", sa.Double(), nullable=True),
        sa.Column("size_ratio_high", sa.Double(), nullable=True),
        sa.Column("stress_covariance", sa.Double(), nullable=True),
        sa.Column("strain_covariance", sa.Double(), nullable=True),
        sa.Column("force_low_n", sa.Double(), nullable=True),
        sa.Column("force_high_n", sa.Double(), nullable=True),
        sa.Column("strain_low", sa.Double(), nullable=False),
        sa.Column("strain_high", sa.Double(), nullable=False),
        sa.Column("temperature_low_c", sa.Double(), nullable=True),
        sa.Column("temperature_high_c", sa.Double(), nullable=True),
        sa.Column("radius_mm", sa.Double(), nullable=False),
        sa.Column("reduced", sa.JSON(), nullable=False),
        sa.Column("assumed", sa.JSON(), nullable=False),
        sa.Column("simulated", sa.JSON(), nullable=False),
        sa.Column("setting", sa.JSON(), nullable=False),
        sa.Column("content_sha256", sa.String(length=64), nullable=False),
        sa.Column("record_sha256", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(["analysis"], ["analyses.analysis"], name=op.f("fk_calibrations_analysis_analyses")),
        sa.ForeignKeyConstraint(["run"], ["runs.run"], name=op.f("fk_calibrations_run_runs")),
        sa.ForeignKeyConstraint(["serial"], ["sensors.serial"], name=op.f("fk_calibrations_serial_sensors")),
        sa.ForeignKeyConstraint(
            ["superseded_by"], ["calibrations.calibration"], name=op.f("fk_calibrations_superseded_by_calibrations")
        ),
        sa.PrimaryKeyConstraint("calibration", name=op.f("pk_calibrations")),
    )
    op.create_index(op.f("ix_calibrations_run"), "calibrations", ["run"], unique=False)
    op.create_index(
        op.f("ix_calibrations_serial_calibration"), "calibrations", ["serial", "calibration"], unique=False
    )


def _create_calibration_baselines() -> None:
    op.create_table(
        "calibration_baselines",
        sa.Column("calibration", sa.String(length=36), nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("location", sa.Text(), nullable=False),
        sa.Column("x_mm", sa.Double(), nullable=False),
        sa.Column("y_mm", sa.Double(), nullable=False),
        sa.Column("value", sa.Double(), nullable=True),
        sa.Column("stderr", sa.Double(), nullable=True),
        sa.Column("loads", sa.Integer(), nullable=False),
        sa.Column("why", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(
            ["calibration"],
            ["calibrations.calibration"],
            name=op.f("fk_calibration_baselines_calibration_calibrations"),
        ),
        sa.PrimaryKeyConstraint("calibration", "number", name=op.f("pk_calibration_baselines")),
    )


def _create_calibration_settling() -> None:
    op.create_table(
        "calibration_settling",
        sa.Column("calibration", sa.String(length=36), nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("signal", sa.Text(), nullable=False),
        sa.Column("loading", sa.Boolean(), nullable=False),
        sa.Column("mean_s", sa.Double(), nullable=True),
        sa.Column("deviation_s", sa.Double(), nullable=True),
        sa.Column("accepted", sa.Integer(), nullable=False),
        sa.Column("censored", sa.Integer(), nullable=False),
        sa.Column("rejected", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(
            ["calibration"],
            ["calibrations.calibration"],
            name=op.f("fk_calibration_settling_calibration_calibrations"),
        ),
        sa.PrimaryKeyConstraint("calibration", "number", name=op.f("pk_calibration_settling")),
    )


def _create_calibration_relaxations() -> None:
    op.create_table(
        "calibration_relaxations",
        sa.Column("calibration", sa.String(length=36), nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("phase", sa.Text(), nullable=False),
        sa.Column("load_index", sa.Integer(), nullable=True),
        sa.Column("location", sa.Text(), nullable=False),
        sa.Column("trial", sa.Integer(), nullable=False),
        sa.Column("strain", sa.Double(), nullable=True),
        sa.Column("signal", sa.Text(), nullable=False),
        sa.Column("unit", sa.Text(), nullable=False),
        sa.Column("loading", sa.Boolean(), nullable=False),
        sa.Column("status", sa.String(length=32), nullable=False),
        sa.Column("level", sa.Double(), nullable=False),
        sa.Column("level_stderr", sa.Double(), nullable=False),
        sa.Column("amplitude_1", sa.Double(), nullable=True),
        sa.Column("amplitude_2", sa.Double(), nullable=True),
        sa.Column("time_constant_1_s", sa.Double(), nullable=True),
        sa.Column("time_constant_2_s", sa.Double(), nullable=True),
        sa.Column("time_constant_1_stderr_s", sa.Double(), nullable=True),
        sa.Column("time_constant_2_stderr_s", sa.Double(), nullable=True),
        sa.Column("r_squared", sa.Double(), nullable=False),
        sa.Column("why", sa.Text(), nullable=False),
        sa.Column("settling_s", sa.Double(), nullable=True),
        sa.Column("settling_censored", sa.Boolean(), nullable=False),
        sa.Column("settling_band", sa.Double(), nullable=False),
        sa.Column("settling_why", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(
            ["calibration"],
            ["calibrations.calibration"],
            name=op.f("fk_calibration_relaxations_calibration_calibrations"),
        ),
        sa.PrimaryKeyConstraint("calibration", "number", name=op.f("pk_calibration_relaxations")),
    )


def _create_calibration_parameters() -> None:
    op.create_table(
        "calibration_parameters",
        sa.Column("calibration", sa.String(length=36), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("value", sa.Double(), nullable=False),
        sa.Column("stderr", sa.Double(), nullable=True),
        sa.Column("unit", sa.Text(), nullable=False),
        sa.Column("source", sa.Text(), nullable=False),
        sa.Column("assumed", sa.Boolean(), nullable=False),
        sa.ForeignKeyConstraint(
            ["calibration"],
            ["calibrations.calibration"],
            name=op.f("fk_calibration_parameters_calibration_calibrations"),
        ),
        sa.PrimaryKeyConstraint("calibration", "name", name=op.f("pk_calibration_parameters")),
    )


def _create_calibration_overlap_bands() -> None:
    op.create_table(
        "calibration_overlap_bands",
        sa.Column("calibration", sa.String(length=36), nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("lower_percent", sa.Double(), nullable=False),
        sa.Column("upper_percent", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(
            ["calibration"],
            ["calibrations.calibration"],
            name=op.f("fk_calibration_overlap_bands_calibration_calibrations"),
        ),
        sa.PrimaryKeyConstraint("calibration", "number", name=op.f("pk_calibration_overlap_bands")),
    )
