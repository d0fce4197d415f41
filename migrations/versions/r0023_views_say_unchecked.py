"""Views say of themselves that they are not compared with the chains of the runs; an upgrade makes them again."""

revision = "0023"
down_revision = "0021"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Change no table."""


def downgrade() -> None:
    """Change no table."""
