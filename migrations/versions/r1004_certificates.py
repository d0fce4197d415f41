"""Calibration certificates, and their replacement or revocation."""

from typing import Final

from alembic import op

revision = "1004"
down_revision = "1003"
branch_labels = None
depends_on = None

#: Names of types that differ between databases.
_WORDS: Final = {
    "sqlite": {"time": "DATETIME", "bytes": "BLOB"},
    "postgresql": {"time": "TIMESTAMP WITH TIME ZONE", "bytes": "BYTEA"},
}
_STATEMENTS: Final = (
    """
    CREATE TABLE certificates (
        certificate VARCHAR(36) NOT NULL, run VARCHAR(36) NOT NULL, calibration VARCHAR(36) NOT NULL,
        number VARCHAR(96) NOT NULL, issued_at {time} NOT NULL, signatory TEXT NOT NULL, valid_until VARCHAR(10),
        replaces VARCHAR(96), why TEXT NOT NULL, html {bytes} NOT NULL, html_sha256 VARCHAR(64) NOT NULL,
        dcc {bytes} NOT NULL, dcc_sha256 VARCHAR(64) NOT NULL, signature TEXT,
        CONSTRAINT pk_certificates PRIMARY KEY (certificate),
        CONSTRAINT fk_certificates_run_runs FOREIGN KEY(run) REFERENCES runs (run),
        CONSTRAINT fk_certificates_calibration_calibrations FOREIGN KEY(calibration)
        REFERENCES calibrations (calibration),
        CONSTRAINT uq_certificates_number UNIQUE (number))
    """,
    "CREATE INDEX ix_certificates_run ON certificates (run)",
    """
    CREATE TABLE certificate_withdrawals (
        withdrawal VARCHAR(36) NOT NULL, run VARCHAR(36) NOT NULL, number VARCHAR(96) NOT NULL,
        replaced_by VARCHAR(96), operator TEXT NOT NULL, why TEXT NOT NULL, noted_at {time} NOT NULL,
        CONSTRAINT pk_certificate_withdrawals PRIMARY KEY (withdrawal),
        CONSTRAINT fk_certificate_withdrawals_run_runs FOREIGN KEY(run) REFERENCES runs (run))
    """,
    "CREATE INDEX ix_certificate_withdrawals_run ON certificate_withdrawals (run)",
    "CREATE INDEX ix_certificate_withdrawals_number ON certificate_withdrawals (number)",
)


def upgrade() -> None:
    words = _WORDS[op.get_bind().dialect.name]
    for statement in _STATEMENTS:
        op.execute(" ".join(statement.format(**words).split()))


def downgrade() -> None:
    op.drop_table("certificate_withdrawals")
    op.drop_table("certificates")
