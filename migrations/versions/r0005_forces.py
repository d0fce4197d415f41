"""The force model of a calibration: its map and how readings become rows; templates are computed again."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # Earlier calibrations have no force model, and no reason for that.
    op.add_column("calibrations", sa.Column("no_force", sa.Text(), nullable=False, server_default=""))
    op.create_table(
        "calibration_forces",
        sa.Column("calibration", sa.String(length=36), nullable=False),
        sa.Column("merged", sa.Integer(), nullable=False),
        sa.Column("readings", sa.Integer(), nullable=False),
        sa.Column("merging", sa.LargeBinary(), nullable=False),
        sa.Column("nodes", sa.Integer(), nullable=False),
        sa.Column("log_response", sa.LargeBinary(), nullable=False),
        sa.Column("log_response_stderr", sa.LargeBinary(), nullable=False),
        sa.Column("force_sha256", sa.String(length=64), nullable=False),
        *(
            sa.Column(name, sa.Double(), nullable=False)
            for name in (
                "scatter",
                "stress_low_kpa",
                "stress_high_kpa",
                "threshold",
                "misfit",
                "residue_share",
                "residue_stderr",
                "residue_strength",
                "steady_s",
                "place_scatter_mm",
            )
        ),
        sa.Column("kernels", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(
            ["calibration"],
            ["calibrations.calibration"],
            name=op.f("fk_calibration_forces_calibration_calibrations"),
        ),
        sa.PrimaryKeyConstraint("calibration", name=op.f("pk_calibration_forces")),
    )


def downgrade() -> None:
    op.drop_table("calibration_forces")
    op.drop_column("calibrations", "no_force")
