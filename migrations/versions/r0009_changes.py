"""Changes of files that runs are configured by, and overrides of verdicts: who, when, why."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # Reasons for earlier changes were not recorded; the changes are in the configurations of the runs.
    op.create_table(
        "configuration_changes",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("earlier_run", sa.String(length=36), nullable=False),
        sa.Column("old_sha256", sa.String(length=64), nullable=False),
        sa.Column("new_sha256", sa.String(length=64), nullable=False),
        sa.Column("differences", sa.JSON(), nullable=False),
        sa.Column("operator", sa.Text(), nullable=False),
        sa.Column("noted_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("why", sa.Text(), nullable=False),
        _reference("configuration_changes", "run", "runs.run"),
        _reference("configuration_changes", "earlier_run", "runs.run"),
        sa.PrimaryKeyConstraint("run", "kind", name=op.f("pk_configuration_changes")),
    )
    op.create_index(op.f("ix_configuration_changes_kind_name"), "configuration_changes", ["kind", "name"])
    op.create_table(
        "verdict_overrides",
        sa.Column("override_id", sa.String(length=36), nullable=False),
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("analysis", sa.String(length=36), nullable=False),
        sa.Column("outcome", sa.String(length=16), nullable=False),
        sa.Column("operator", sa.Text(), nullable=False),
        sa.Column("why", sa.Text(), nullable=False),
        sa.Column("noted_at", sa.DateTime(timezone=True), nullable=False),
        _reference("verdict_overrides", "run", "runs.run"),
        _reference("verdict_overrides", "analysis", "analyses.analysis"),
        sa.PrimaryKeyConstraint("override_id", name=op.f("pk_verdict_overrides")),
    )
    op.create_index(op.f("ix_verdict_overrides_run"), "verdict_overrides", ["run"])


def downgrade() -> None:
    op.drop_index(op.f("ix_verdict_overrides_run"), table_name="verdict_overrides")
    op.drop_table("verdict_overrides")
    op.drop_index(op.f("ix_configuration_changes_kind_name"), table_name="configuration_changes")
    op.drop_table("configuration_changes")


def _reference(table: str, column: str, to: str) -> sa.ForeignKeyConstraint:
    name = op.f(f"fk_{table}_{column}_{to.partition('.')[0]}")
    return sa.ForeignKeyConstraint([column], [to], name=name)
