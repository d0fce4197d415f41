"""The view of calibrations requires a link, and a run of the same sensor; no table changes.

Views are dropped and created again by every upgrade.
"""

revision = "0024"
down_revision = "0023"
branch_labels = None
depends_on = None


def upgrade() -> None:
    pass


def downgrade() -> None:
    pass
