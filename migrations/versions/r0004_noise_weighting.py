"""How an analysis weighed readings by their noise."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # Before, every image was made with equal weights.
    equal = sa.Column("noise_weighting", sa.String(length=16), nullable=False, server_default="equal")
    op.add_column("analyses", equal)
    op.add_column("analyses", sa.Column("weight_ratio", sa.Double(), nullable=True))


def downgrade() -> None:
    op.drop_column("analyses", "weight_ratio")
    op.drop_column("analyses", "noise_weighting")
