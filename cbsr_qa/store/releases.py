"""Releases of configuration files: appended; the latest of a kind and digest holds."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Final, Literal

from sqlalchemy import Engine, insert

from cbsr_qa.domain.filling import fill_from_mapping
from cbsr_qa.domain.run.gate import Release
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.mapping import row_of
from cbsr_qa.store.odd_rows import RowsApart, read_rows_apart
from cbsr_qa.store.outbox import Kind, announce
from cbsr_qa.store.tables.records import ReleaseRow
from cbsr_qa.store.types import time_of_id

#: Stand-in for an unreadable identifier. It sorts after every identifier: such a row may be the latest.
_UNREADABLE_ID: Final = "~"


class Releases:
    """Releases and withdrawals of configuration files."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def save(self, release: Release) -> None:
        """Store a release or a withdrawal. StoreError if it is already stored, or the database cannot be written."""
        values = row_of(
            ReleaseRow,
            release,
            release_id=release.release,
            outcome=release.action,
            operator=release.by,
            noted_at=release.at,
        )
        with writing(self._engine) as connection:
            connection.execute(insert(ReleaseRow), values)
            announce(connection, Kind.RELEASE, [release.release])

    def read_latest(self, kind: str, sha256: str) -> Release | None:
        """Return the latest release or withdrawal of this content; None without one.

        A release that cannot be read does not count: the state before it stays. Any other row that cannot be read
        withdraws the release.
        """
        row = ReleaseRow
        with reading(self._engine) as connection:
            releases = _list_releases(read_rows_apart(connection, row, row.sha256 == sha256, row.kind == kind))
        return max(releases, key=lambda release: release.release, default=None)

    def read_all(self) -> tuple[Release, ...]:
        """Return all releases and withdrawals in the order they were made in.

        An unreadable release is left out; any other unreadable row counts as a withdrawal.

        Raises
        ------
        StoreError
            If the database cannot be read.
        """
        with reading(self._engine) as connection:
            releases = _list_releases(read_rows_apart(connection, ReleaseRow))
        return tuple(sorted(releases, key=lambda release: release.release))

    def name_unread(self, kind: str = "", sha256: str = "") -> tuple[str, ...]:
        """Return in words the rows of releases that cannot be read: those of one content, or all."""
        row = ReleaseRow
        of_content = (row.sha256 == sha256, row.kind == kind) if sha256 else ()
        with reading(self._engine) as connection:
            return read_rows_apart(connection, row, *of_content).problems


def _list_releases(rows: RowsApart) -> list[Release]:
    """Return releases and withdrawals; an unreadable row that is no release counts as a withdrawal."""
    releases = [_release(cells) for cells in rows.rows]
    for odd in rows.odd:
        if odd.cells.get("outcome") != "released" and odd.cells.keys() >= {"kind", "sha256"}:
            made_at = time_of_id(odd.cells.get("release_id", "")) or datetime.fromtimestamp(0, UTC)
            operator = "a row that cannot be read"
            defaults = {"release_id": _UNREADABLE_ID, "name": "", "operator": operator, "why": odd.words}
            releases.append(_release({"noted_at": made_at, **defaults, **odd.cells, "outcome": "withdrawn"}))
    return releases


def _release(cells: Mapping[str, Any]) -> Release:
    # An unknown word counts as a withdrawal.
    action: Literal["released", "withdrawn"] = "released" if cells["outcome"] == "released" else "withdrawn"
    renamed_cells = {"release": cells["release_id"], "by": cells["operator"], "at": cells["noted_at"]}
    return fill_from_mapping(Release, {**cells, **renamed_cells}, action=action)
