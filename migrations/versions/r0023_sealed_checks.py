"""Station checks get a seal; earlier ones stay without. Views, which an upgrade makes again, say what they are."""

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("station_checks", sa.Column("seal", sa.Text(), nullable=True))


def downgrade() -> None:
    op.drop_column("station_checks", "seal")
