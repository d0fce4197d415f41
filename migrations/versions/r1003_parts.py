"""Parts of the sensor of a run."""

from typing import Final

from alembic import op

revision = "1003"
down_revision = "1002"
branch_labels = None
depends_on = None

_PARTS: Final = """
    CREATE TABLE run_parts (
        run VARCHAR(36) NOT NULL, name VARCHAR(64) NOT NULL, identifier VARCHAR(64) NOT NULL, revision TEXT NOT NULL,
        CONSTRAINT pk_run_parts PRIMARY KEY (run, name),
        CONSTRAINT fk_run_parts_run_runs FOREIGN KEY(run) REFERENCES runs (run)){without_rowid}
    """
#: Options that differ between databases.
_WITHOUT_ROWID: Final = {"sqlite": " WITHOUT ROWID", "postgresql": ""}


def upgrade() -> None:
    without_rowid = _WITHOUT_ROWID[op.get_bind().dialect.name]
    op.execute(" ".join(_PARTS.format(without_rowid=without_rowid).split()))
    op.create_index("ix_run_parts_name_identifier", "run_parts", ["name", "identifier"])


def downgrade() -> None:
    op.drop_table("run_parts")
