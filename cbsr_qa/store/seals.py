"""Seals of station checks: a digest of all rows of a check, signed where a key is set. No chain covers these rows."""

import hmac
from collections.abc import Iterable, Mapping
from typing import Any, Final

from sqlalchemy import Connection, select

from cbsr_qa.domain.run import CheckSeal
from cbsr_qa.store.chain import covered, row_text, sha256, signing_key
from cbsr_qa.store.tables import Base, StationCheckFramesRow, StationCheckLineRow, StationCheckRow

_TABLES: Final = (StationCheckRow, StationCheckLineRow, StationCheckFramesRow)
_PLAIN: Final = "sha256"

#: Tables, and the rows of one check in them as they are stored.
CheckRows = Iterable[tuple[type[Base], Mapping[str, Any]]]


def new_seal(connection: Connection, check: str, rows: CheckRows) -> str:
    """Return what column ``station_checks.seal`` holds: ``sha256:DIGEST``, or ``KEY:DIGEST:SIGNATURE``."""
    digest, key = _digest(rows), signing_key(connection)
    return f"{_PLAIN}:{digest}" if key is None else f"{key.key_id}:{digest}:{key.sign(check, digest)}"


def check_seal(connection: Connection, check: str, seal: str | None) -> tuple[CheckSeal, str]:
    """Compare the rows of a check with its seal.

    Returns
    -------
    State of the seal, and what does not match; empty if all does, and for a check of before seals.
    """
    if seal is None:
        return CheckSeal.NONE, ""
    kind, _, rest = seal.partition(":")
    digest, _, mac = rest.partition(":")
    if not hmac.compare_digest(_digest(_stored_rows(connection, check)), digest):
        return CheckSeal.NONE, f"station check {check} was altered: it does not match its seal"
    if kind == _PLAIN:
        return CheckSeal.DIGEST, ""
    key = signing_key(connection)
    if key is None or key.key_id != kind:
        return CheckSeal.NOT_CHECKED, ""
    if not key.signed(check, digest, mac):
        return CheckSeal.NONE, f"station check {check} was altered: its seal was not signed with key {kind}"
    return CheckSeal.SIGNED, ""


def _digest(rows: CheckRows) -> str:
    return sha256(*sorted(row_text(Base.metadata.tables[kind.__tablename__], row) for kind, row in rows))


def _stored_rows(connection: Connection, check: str) -> CheckRows:
    for kind in _TABLES:
        table = Base.metadata.tables[kind.__tablename__]
        for row in connection.execute(select(*covered(table)).where(table.c.check_id == check)).mappings():
            yield kind, dict(row)
