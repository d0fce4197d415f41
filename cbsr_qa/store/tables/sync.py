"""Tables of the synchronisation of databases: what waits to be sent, what a centre refused, whom it accepts.

Rows of ``outbox`` change and go: they say what is still to be done, not what happened.
"""

from datetime import datetime

from sqlalchemy.orm import Mapped, mapped_column

from cbsr_qa.store.tables.runs import Base, Identifier
from cbsr_qa.store.types import Word


class OutboxRow(Base):
    """Something that a central database has not confirmed; a run has one row, however much of it is new."""

    __tablename__ = "outbox"

    kind: Mapped[str] = mapped_column(Word(32), primary_key=True)  #: a Kind of outbox.py
    item: Mapped[str] = mapped_column(Word(64), primary_key=True)  #: identifier of what is to be sent
    version: Mapped[int]  #: of a chained run the number of its links when it was announced; rises
    sent: Mapped[int]  #: version that the central database has; 0: none of it
    noted_at: Mapped[datetime]  #: when the oldest part of it that was not sent was announced
    state: Mapped[str] = mapped_column(Word(16))  #: an EntryState of outbox.py
    why: Mapped[str]  #: why it was refused, or what it waits for


class SyncRefusalRow(Base):
    """Something that did not fit what this database holds, or its own digest; it was not stored."""

    __tablename__ = "sync_refusals"

    kind: Mapped[str] = mapped_column(Word(32), primary_key=True)
    item: Mapped[str] = mapped_column(Word(64), primary_key=True)
    station: Mapped[str] = mapped_column(primary_key=True)  #: as its rows name it; empty of a release
    station_sha256: Mapped[str] = mapped_column(Word(64), primary_key=True)  #: of what was sent; may be empty
    centre_sha256: Mapped[str] = mapped_column(Word(64), primary_key=True)  #: of what is stored here; may be empty
    run: Mapped[str | None] = mapped_column(Identifier)  #: which may not be stored here
    why: Mapped[str]
    noted_at: Mapped[datetime] = mapped_column(primary_key=True)


class SyncSettlementRow(Base):
    """An item that was refused was accepted after all, or is not to be sent: its earlier refusals are settled."""

    __tablename__ = "sync_settlements"

    kind: Mapped[str] = mapped_column(Word(32), primary_key=True)
    item: Mapped[str] = mapped_column(Word(64), primary_key=True)
    settled_at: Mapped[datetime] = mapped_column(primary_key=True)


class SyncAcceptsRow(Base):
    """Oldest schema of the databases that may send; a migration that breaks with older senders changes the row."""

    __tablename__ = "sync_accepts"

    oldest_schema: Mapped[str] = mapped_column(Word(32), primary_key=True)
