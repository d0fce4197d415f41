"""A chain of digests over everything a run's verdict rests on."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # Earlier runs stay unchained: their original rows cannot be verified now.
    op.add_column("runs", sa.Column("chain", sa.String(length=64), nullable=True))
    op.create_table(
        "run_links",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("document", sa.String(length=64), nullable=False),
        sa.Column("content_sha256", sa.String(length=64), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("mac", sa.String(length=64), nullable=True),
        sa.ForeignKeyConstraint(["run"], ["runs.run"], name=op.f("fk_run_links_run_runs")),
        sa.PrimaryKeyConstraint("run", "number", name=op.f("pk_run_links")),
    )
    op.create_index(op.f("ix_run_links_run_kind_document"), "run_links", ["run", "kind", "document"], unique=True)


def downgrade() -> None:
    op.drop_index(op.f("ix_run_links_run_kind_document"), table_name="run_links")
    op.drop_table("run_links")
    op.drop_column("runs", "chain")
