"""Views of runs, measurements and calibrations that hold: what they select stands in ``cbsr_qa/store/views.py``.

The environment drops all views before migrations and creates them at the latest schema: nothing is left to do here.
"""

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    pass


def downgrade() -> None:
    pass
