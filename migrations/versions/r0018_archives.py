"""Runs whose frames are archived in files."""

import sqlalchemy as sa
from alembic import op

from cbsr_qa.domain.errors import StoreError

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "archives",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("file", sa.Text(), nullable=False),
        sa.Column("file_bytes", sa.Integer(), nullable=False),
        sa.Column("file_sha256", sa.LargeBinary(length=32), nullable=False),
        sa.Column("archived_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["run"], ["runs.run"], name=op.f("fk_archives_run_runs")),
        sa.PrimaryKeyConstraint("run", name=op.f("pk_archives")),
    )


def downgrade() -> None:
    archived = op.get_bind().execute(sa.text("SELECT count(*) FROM archives")).scalar()
    if archived:  # the earlier program would find frames without readings
        raise StoreError(
            f"archived runs: {archived}; an earlier schema has no archives",
            remedy="bring each back first: cbsr-qa db unarchive RUN",
        )
    op.drop_table("archives")
