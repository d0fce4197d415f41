"""Seals of station checks: a digest of all rows of a check, signed where a key is set. No chain covers these rows."""

import hmac
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from sqlalchemy import Connection, select

from cbsr_qa.domain.run.station import CheckSeal
from cbsr_qa.store.chain.links import signing_key
from cbsr_qa.store.chain.run_documents import list_covered, row_text, sha256
from cbsr_qa.store.damage import FOREIGN_CELL
from cbsr_qa.store.tables.records import StationCheckFramesRow, StationCheckLineRow, StationCheckRow
from cbsr_qa.store.tables.runs import Base

_TABLES: Final = (StationCheckRow, StationCheckLineRow, StationCheckFramesRow)
_PLAIN: Final = "sha256"
#: Checks whose rows are in memory at once.
_CHECKS_AT_ONCE: Final = 500

#: Tables, and the rows of one check in them as they are stored.
CheckRows = Iterable[tuple[type[Base], Mapping[str, Any]]]


def new_seal(connection: Connection, check: str, rows: CheckRows) -> str:
    """Return the value of column ``station_checks.seal``: ``sha256:DIGEST``, or ``KEY:DIGEST:SIGNATURE``."""
    digest, key = _digest(rows), signing_key(connection)
    return f"{_PLAIN}:{digest}" if key is None else f"{key.key_id}:{digest}:{key.sign(check, digest)}"


def key_of_seal(seal: str) -> str:
    """Return the key that signed a seal; empty where none did."""
    kind = str(seal).partition(":")[0]
    return "" if kind == _PLAIN else kind


def check_seal(connection: Connection, check: str, seal: str | None) -> tuple[CheckSeal, str]:
    """Compare the rows of a check with its seal.

    Returns
    -------
    State of the seal, and what does not match; empty if all does, and for a check without a seal.
    """
    return check_seals(connection, {check: seal})[check]


def check_seals(connection: Connection, seals: Mapping[str, str | None]) -> dict[str, tuple[CheckSeal, str]]:
    """Compare the rows of checks with their seals; return state and problem by check, see :func:`check_seal`."""
    sealed_checks = [check for check, seal in seals.items() if seal is not None]
    digests = {
        check: digest
        for start in range(0, len(sealed_checks), _CHECKS_AT_ONCE)
        for check, digest in _digest_checks(connection, sealed_checks[start : start + _CHECKS_AT_ONCE]).items()
    }
    return {check: _state(connection, check, seal, digests.get(check, "")) for check, seal in seals.items()}


def _state(connection: Connection, check: str, seal: str | None, stored: str) -> tuple[CheckSeal, str]:
    if seal is None:
        return CheckSeal.NONE, ""
    kind, _, digest_and_mac = str(seal).partition(":")
    digest, _, mac = digest_and_mac.partition(":")
    if not hmac.compare_digest(stored.encode(), digest.encode()):
        return CheckSeal.NONE, f"station check {check} was altered: it does not match its seal"
    if kind == _PLAIN:
        return CheckSeal.DIGEST, ""
    key = signing_key(connection)
    if key is None or key.key_id != kind:
        return CheckSeal.NOT_CHECKED, ""
    if not key.verify(check, digest, mac):
        return CheckSeal.NONE, f"station check {check} was altered: its seal was not signed with key {kind}"
    return CheckSeal.SIGNED, ""


def _digest(rows: CheckRows) -> str:
    return sha256(*sorted(row_text(Base.metadata.tables[kind.__tablename__], row) for kind, row in rows))


def _digest_checks(connection: Connection, checks: Sequence[str]) -> dict[str, str]:
    """Return the digest of the rows of each check; empty for a check with an unreadable cell."""
    rows: dict[str, list[tuple[type[Base], Mapping[str, Any]]]] = {check: [] for check in checks}
    try:
        for kind in _TABLES:
            table = Base.metadata.tables[kind.__tablename__]
            query = select(*list_covered(table)).where(table.c.check_id.in_(checks))
            for row in connection.execute(query).mappings():
                rows[row["check_id"]].append((kind, dict(row)))
        return {check: _digest(check_rows) for check, check_rows in rows.items()}
    except FOREIGN_CELL:
        if len(checks) == 1:
            return {checks[0]: ""}
        return {check: _digest_checks(connection, [check])[check] for check in checks}
