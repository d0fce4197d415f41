"""Decisions between the presses of a phase."""

from typing import Final

from alembic import op

revision = "1002"
down_revision = "1001"
branch_labels = None
depends_on = None

#: Names of types, and options, that differ between databases.
_WORDS: Final = {
    "sqlite": {"real": "DOUBLE", "without_rowid": " WITHOUT ROWID"},
    "postgresql": {"real": "DOUBLE PRECISION", "without_rowid": ""},
}
_DECISIONS: Final = """
    CREATE TABLE decisions (
        run VARCHAR(36) NOT NULL, phase INTEGER NOT NULL, pressed INTEGER NOT NULL, load_index INTEGER,
        label TEXT NOT NULL, x_mm {real}, y_mm {real}, expected_n {real}, upper_n {real}, floor_n {real},
        why VARCHAR(16) NOT NULL, time_s {real} NOT NULL,
        CONSTRAINT pk_decisions PRIMARY KEY (run, phase, pressed),
        CONSTRAINT fk_decisions_run_phase_phases FOREIGN KEY(run, phase)
        REFERENCES phases (run, phase)){without_rowid}
    """


def upgrade() -> None:
    op.execute(" ".join(_DECISIONS.format(**_WORDS[op.get_bind().dialect.name]).split()))


def downgrade() -> None:
    op.drop_table("decisions")
