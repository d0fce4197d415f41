"""Presses that were eased to other strains before their release: what these were, and when."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # Earlier presses had only one strain.
    op.add_column("loads", sa.Column("eased", sa.JSON(), nullable=True))


def downgrade() -> None:
    op.drop_column("loads", "eased")
