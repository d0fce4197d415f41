"""Re-analyses of runs, and who adopted them."""

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "reanalyses",
        sa.Column("reanalysis", sa.String(length=36), nullable=False),
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("key_sha256", sa.String(length=64), nullable=False),
        sa.Column("recipe", sa.Text(), nullable=False),
        sa.Column("analysed_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("software", sa.JSON(), nullable=False),
        sa.Column("outcome", sa.String(length=16), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("noise_weighting", sa.String(length=16), nullable=False),
        sa.Column("weight_ratio", sa.Double(), nullable=True),
        sa.Column("compute_s", sa.JSON(), nullable=False),
        sa.Column("warnings", sa.JSON(), nullable=False),
        sa.Column("measurements", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(["run"], ["runs.run"], name=op.f("fk_reanalyses_run_runs")),
        sa.PrimaryKeyConstraint("reanalysis", name=op.f("pk_reanalyses")),
    )
    op.create_index(op.f("ix_reanalyses_run_key_sha256"), "reanalyses", ["run", "key_sha256"])
    op.create_table(
        "adoptions",
        sa.Column("analysis", sa.String(length=36), nullable=False),
        sa.Column("reanalysis", sa.String(length=36), nullable=False),
        sa.Column("operator", sa.Text(), nullable=False),
        sa.Column("why", sa.Text(), nullable=False),
        sa.Column("adopted_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["analysis"], ["analyses.analysis"], name=op.f("fk_adoptions_analysis_analyses")),
        sa.ForeignKeyConstraint(
            ["reanalysis"], ["reanalyses.reanalysis"], name=op.f("fk_adoptions_reanalysis_reanalyses")
        ),
        sa.PrimaryKeyConstraint("analysis", name=op.f("pk_adoptions")),
    )


def downgrade() -> None:
    # The links of re-analyses stay: the chain of a run with one then misses rows, and the run is refused.
    op.drop_table("adoptions")
    op.drop_index(op.f("ix_reanalyses_run_key_sha256"), table_name="reanalyses")
    op.drop_table("reanalyses")
