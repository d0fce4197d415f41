"""The table of links: the chain of digests each run is under. Rows are added and never changed."""

from sqlalchemy import ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from cbsr_qa.store.run_tables import Base, Identifier


class LinkRow(Base):
    """One link of a run's chain, stored in the transaction of the rows it covers: they are one document."""

    __tablename__ = "run_links"
    __table_args__ = (Index(None, "run", "kind", "document", unique=True),)

    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    kind: Mapped[str] = mapped_column(String(32))  #: the table its rows are in, see links.py
    document: Mapped[str] = mapped_column(String(64))  #: which of its rows: their common key
    content_sha256: Mapped[str] = mapped_column(String(64))  #: of these rows
    sha256: Mapped[str] = mapped_column(String(64))  #: of the link before, kind, document and content
    mac: Mapped[str | None] = mapped_column(String(64))  #: HMAC-SHA256 of ``sha256``; None where no key was set
