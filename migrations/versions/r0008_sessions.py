"""Who began or resumed a session of a run, when by the wall clock, and with which software."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # Earlier sessions are known only from the run itself.
    op.add_column("run_states", sa.Column("operator", sa.Text(), nullable=True))
    op.add_column("run_states", sa.Column("software", sa.JSON(), nullable=True))
    op.add_column("run_states", sa.Column("noted_at", sa.DateTime(timezone=True), nullable=True))


def downgrade() -> None:
    op.drop_column("run_states", "noted_at")
    op.drop_column("run_states", "software")
    op.drop_column("run_states", "operator")
