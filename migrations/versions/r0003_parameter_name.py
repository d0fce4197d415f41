"""Name and criterion of a regularisation parameter, beside its value and the reason."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

#: Names used by earlier methods, which stored only a value; all others had a λ.
_CALLED = {
    "truncated-svd": "components kept",
    "linear-back-projection": "no parameter",
    "pyeit-jac": "pyEIT's lamb",
    "pyeit-greit": "pyEIT's lamb",
}


def upgrade() -> None:
    # Columns are added in place: SQLite's copy of a table that others refer to would break the references.
    op.add_column("calibrations", sa.Column("regularisation_name", sa.Text(), nullable=False, server_default="λ"))
    op.add_column("calibrations", sa.Column("regularisation_criterion", sa.Text(), nullable=False, server_default=""))
    rows = sa.table("calibrations", sa.column("method", sa.Text), sa.column("regularisation_name", sa.Text))
    for method, name in _CALLED.items():
        op.execute(rows.update().where(rows.c.method == method).values(regularisation_name=name))


def downgrade() -> None:
    op.drop_column("calibrations", "regularisation_criterion")
    op.drop_column("calibrations", "regularisation_name")
