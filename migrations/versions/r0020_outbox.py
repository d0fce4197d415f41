"""Synchronisation with a central database: what waits to be sent, what was refused, which senders are accepted.

A later revision that only adds tables or nullable columns leaves ``sync_accepts`` alone. One after which rows of
older senders would not fit, or would not match their digests, sets ``oldest_schema`` to itself.
"""

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None

#: Kind, table and key of what is sent besides runs.
_OTHERS = (
    ("station check", "station_checks", "check_id"),
    ("chart reference", "chart_references", "reference"),
    ("release", "releases", "release_id"),
)


def upgrade() -> None:
    op.create_table(
        "outbox",
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("item", sa.String(length=64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("sent", sa.Integer(), nullable=False),
        sa.Column("noted_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("why", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("kind", "item", name=op.f("pk_outbox")),
    )
    op.create_table(
        "sync_refusals",
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("item", sa.String(length=64), nullable=False),
        sa.Column("station", sa.Text(), nullable=False),
        sa.Column("station_sha256", sa.String(length=64), nullable=False),
        sa.Column("centre_sha256", sa.String(length=64), nullable=False),
        sa.Column("run", sa.String(length=36), nullable=True),
        sa.Column("why", sa.Text(), nullable=False),
        sa.Column("noted_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint(
            "kind", "item", "station", "station_sha256", "centre_sha256", name=op.f("pk_sync_refusals")
        ),
    )
    accepts = op.create_table(
        "sync_accepts",
        sa.Column("oldest_schema", sa.String(length=32), nullable=False),
        sa.PrimaryKeyConstraint("oldest_schema", name=op.f("pk_sync_accepts")),
    )
    op.bulk_insert(accepts, [{"oldest_schema": revision}])
    if op.get_bind().dialect.name == "postgresql":
        # HDF5 files do not get smaller: trying takes half of the time of storing a run.
        op.execute("ALTER TABLE calibrations ALTER COLUMN file SET STORAGE EXTERNAL")
    # What the database holds already is announced now.
    links = "CASE WHEN chain IS NULL THEN 1 ELSE (SELECT count(*) FROM run_links WHERE run_links.run = runs.run) END"
    for kind, table, key, version in (("run", "runs", "run", links), *((*one, "1") for one in _OTHERS)):
        op.execute(
            "INSERT INTO outbox (kind, item, version, sent, noted_at, state, why)"
            f" SELECT '{kind}', {key}, {version}, 0, CURRENT_TIMESTAMP, 'waiting', '' FROM {table}"
        )


def downgrade() -> None:
    # What was not sent is announced again by the next upgrade, with everything else; the centre knows what it has.
    if op.get_bind().dialect.name == "postgresql":
        op.execute("ALTER TABLE calibrations ALTER COLUMN file SET STORAGE EXTENDED")
    op.drop_table("sync_accepts")
    op.drop_table("sync_refusals")
    op.drop_table("outbox")
