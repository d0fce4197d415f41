"""Releases of configuration files: appended; the latest of a kind and digest holds."""

from typing import Any, Literal

from sqlalchemy import Engine, Row, insert, select

from cbsr_qa.domain.run.gate import Release
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.mapping import convert_row, row_of
from cbsr_qa.store.outbox import Kind, announce
from cbsr_qa.store.tables.gate import ReleaseRow


def save_release(engine: Engine, release: Release) -> None:
    """Store a release or a withdrawal. StoreError if it is already stored, or the database cannot be written."""
    values = row_of(
        ReleaseRow,
        release,
        release_id=release.release,
        outcome=release.action,
        operator=release.by,
        noted_at=release.at,
    )
    with writing(engine) as connection:
        connection.execute(insert(ReleaseRow), values)
        announce(connection, Kind.RELEASE, [release.release])


def latest_release(engine: Engine, kind: str, sha256: str) -> Release | None:
    """Return what was last said about a file of this content; None if nothing was."""
    row = ReleaseRow
    query = select(*row.__table__.columns).where(row.sha256 == sha256, row.kind == kind)
    with reading(engine) as connection:
        found = connection.execute(query.order_by(row.release_id.desc()).limit(1)).one_or_none()
    return None if found is None else _release(found)


def all_releases(engine: Engine) -> tuple[Release, ...]:
    """Return all releases and withdrawals in the order they were made in. StoreError if they cannot be read."""
    row = ReleaseRow
    with reading(engine) as connection:
        found = connection.execute(select(*row.__table__.columns).order_by(row.release_id)).all()
    return tuple(map(_release, found))


def _release(row: Row[Any]) -> Release:
    # An unknown word is no release.
    action: Literal["released", "withdrawn"] = "released" if row.outcome == "released" else "withdrawn"
    return convert_row(Release, row, release=row.release_id, action=action, by=row.operator, at=row.noted_at)
