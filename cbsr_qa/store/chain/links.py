"""Rows of a run and the links of its chain, stored in one transaction.

The optional key that signs the links of runs: it never reaches a log, a message, a document or the database.
"""

import hashlib
import hmac
import os
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any, Final, Self

from sqlalchemy import Connection, Insert, TextClause, bindparam, func, insert, literal_column, select, text

from cbsr_qa.domain.errors import ConfigError, StoreError
from cbsr_qa.store.chain.run_documents import documents, sha256
from cbsr_qa.store.outbox import Kind, announce
from cbsr_qa.store.prepared import prepare
from cbsr_qa.store.tables.records import FEW_LINKS, LinkRow
from cbsr_qa.store.tables.runs import (
    AttendanceRow,
    DecisionRow,
    FrameBlockRow,
    LoadRow,
    PhaseRow,
    RunRow,
    SampleBlockRow,
    StepRow,
    UnloadedMarkRow,
)
from cbsr_qa.system.secret import secret_of

VARIABLE: Final = "CBSR_QA_SIGNING_KEY"
_LEAST: Final = 16
_REMEDY: Final = f"set {VARIABLE} to a key of at least {_LEAST} characters, or to @FILE, or unset it"


class SigningKey:
    """A key for HMAC-SHA256. ``key_id`` (12 hexadecimal digits) names it without revealing it."""

    def __init__(self, secret: bytes) -> None:
        self._secret = secret
        self.key_id = self._mac("cbsr-qa signing key")[:12]

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] = os.environ) -> Self | None:
        """Return the configured key, or None.

        Raises
        ------
        ConfigError
            If it is empty or short, or its file cannot be read. The message does not quote the setting.
        """
        secret = secret_of(VARIABLE, remedy=_REMEDY, environment=environment)
        if secret is None:
            return None
        if len(secret) < _LEAST:
            raise ConfigError(f"the signing key in {VARIABLE} has {len(secret)} characters", remedy=_REMEDY)
        return cls(secret.encode("utf-8", "surrogateescape"))

    def __repr__(self) -> str:
        return f"SigningKey({self.key_id})"

    def sign(self, run: str, link: str) -> str:
        """Return the signature of a link of a run, hexadecimal."""
        return self._mac(f"cbsr-qa link\n{run}\n{link}")

    def verify(self, run: str, link: str, mac: str) -> bool:
        """Whether a signature was made with this key."""
        return hmac.compare_digest(self.sign(run, link), mac)

    def _mac(self, text: str) -> str:
        return hmac.digest(self._secret, text.encode(), "sha256").hex()


#: Option of an engine that holds the key, and what the column ``runs.chain`` says.
KEY_OPTION: Final = "cbsr_signing_key"
PLAIN, _SIGNED = "sha256", "hmac-sha256:"


# Statements are built once, and for the plain table: there is a row and its link with every frame.
@cache
def _insertion(table: Any) -> Insert:
    return insert(table.__table__).inline()


def _insert(connection: Connection, table: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    """Insert rows that all give the columns of the first."""
    prepare(_insertion(table), connection.dialect, tuple(rows[0])).execute(connection, rows)


#: What a session stores as it goes on. It is not announced, document by document: an open run stays in the outbox.
OF_A_SESSION: Final = frozenset(
    table_row.__tablename__
    for table_row in (
        PhaseRow,
        StepRow,
        FrameBlockRow,
        SampleBlockRow,
        LoadRow,
        UnloadedMarkRow,
        AttendanceRow,
        DecisionRow,
    )
)

_NEWEST: Final = (
    select(RunRow.chain, LinkRow.number, LinkRow.sha256)
    .outerjoin(LinkRow, LinkRow.run == RunRow.run)
    .where(RunRow.run == bindparam("of_run"))
    .order_by(LinkRow.number.desc())
    .limit(literal_column("1"))
)
_ALONE: Final = select(func.pg_advisory_xact_lock(bindparam("number")))


def signing_key(connection: Connection) -> SigningKey | None:
    """Return the configured key, or None."""
    return connection.get_execution_options().get(KEY_OPTION)


def checking_key(connection: Connection, chain: str) -> SigningKey | None:
    """Return the configured key if it is the one that signs a chain; else None."""
    key = signing_key(connection)
    return key if key is not None and key.key_id == key_id_of(chain) else None


def new_chain(connection: Connection) -> str:
    """Return the chain entry of a new run: its kind and signing key."""
    key = signing_key(connection)
    return PLAIN if key is None else f"{_SIGNED}{key.key_id}"


def key_id_of(chain: str) -> str:
    """Return the key that signs a chain; empty if unsigned."""
    return chain.removeprefix(_SIGNED) if chain.startswith(_SIGNED) else ""


def match_few_links() -> TextClause:
    """Return the condition under which links are found by an index of their kind; a database must see it in words."""
    return text(f"{LinkRow.__tablename__}.{FEW_LINKS}")


def link_digest(before: str, kind: str, document: str, content: str) -> str:
    """Return the digest of a link, from the previous link's digest (empty for the first)."""
    return sha256(before, kind, document, content)


def add_rows(connection: Connection, run: str, table: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    """Insert rows of a run and link every document among them; rows of one document must be adjacent.

    Raises
    ------
    StoreError
        As :func:`key_to_continue`.
    """
    if not rows:
        return
    _insert(connection, table, rows)
    kind = table.__tablename__
    add_links(connection, run, [(kind, *document) for document in documents(table.__table__, rows)])


def add_links(connection: Connection, run: str, entries: Iterable[tuple[str, str, str]]) -> None:
    """Append links of (kind, document, content digest) to a run's chain; an unchained run gets none.

    The run is announced for synchronisation (see :mod:`cbsr_qa.store.outbox`).

    Raises
    ------
    StoreError
        As :func:`key_to_continue`.
    """
    take_turns(connection, f"chain {run}")
    chain, last, before = prepare(_NEWEST, connection.dialect).one(connection, {"of_run": run})
    key = key_to_continue(connection, run, chain)
    if chain is None:
        announce(connection, Kind.RUN, [run])
        return
    number, before = (-1, "") if last is None else (last, before)
    rows = []
    for kind, document, content in entries:
        number, before = number + 1, link_digest(before, kind, document, content)
        mac = None if key is None else key.sign(run, before)
        values = {"kind": kind, "document": document, "content_sha256": content, "sha256": before, "mac": mac}
        rows.append({"run": run, "number": number, **values})
    _insert(connection, LinkRow, rows)
    if any(row["kind"] not in OF_A_SESSION for row in rows):
        announce(connection, Kind.RUN, [run], number + 1)


def take_turns(connection: Connection, what: str) -> None:
    """Wait until nobody else adds to a chain; others wait until this transaction ends.

    SQLite has one writer anyway. To lock a row of PostgreSQL would need the right to update it.
    """
    if connection.dialect.name == "postgresql":
        number = int.from_bytes(hashlib.sha256(f"cbsr-qa {what}".encode()).digest()[:8], signed=True)
        connection.execute(_ALONE, {"number": number})


def chain_head(connection: Connection, run: str) -> str:
    """Return the digest of the last link of a run's chain; empty where it has none."""
    newest = select(LinkRow.sha256).where(LinkRow.run == run).order_by(LinkRow.number.desc()).limit(1)
    return connection.scalar(newest) or ""


def key_to_continue(connection: Connection, run: str, chain: str | None) -> SigningKey | None:
    """Return the key for a run's further links; None if it is not signed.

    Raises
    ------
    StoreError
        If the run is signed and its key is not the one set, or it is unsigned and a key is set: anyone who can write
        the database can remove signatures and chain.
    """
    needed, key = key_id_of(chain or ""), signing_key(connection)
    if not needed:
        if key is None:
            return None
        raise StoreError(
            f"run {run} {'has no chain' if chain is None else 'is not signed'}, and a signing key is set: nothing is"
            " appended",
            remedy=f"unset {VARIABLE} to continue this run without signatures",
        )
    if key is None or key.key_id != needed:
        found = "no key is set" if key is None else f"the key set here is {key.key_id}"
        raise StoreError(
            f"run {run} is signed with key {needed}, and {found}", remedy=f"set {VARIABLE} to the run's key"
        )
    return key
