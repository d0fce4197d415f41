"""Tables of the checks before a run: their answers, and releases of configuration files. Rows are never changed."""

from datetime import datetime

from sqlalchemy import ForeignKey, Index
from sqlalchemy.orm import Mapped, mapped_column

from cbsr_qa.store.tables.runs import Base, Identifier
from cbsr_qa.store.types import Word


class GateAnswerRow(Base):
    """One answer; a resumed run has those that were asked again under a session of their own."""

    __tablename__ = "gate_answers"

    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"), primary_key=True)
    session: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)  #: 0 when the run began
    subject: Mapped[str] = mapped_column(Word(32), primary_key=True)  #: a GateCheck
    policy: Mapped[str] = mapped_column(Word(16))
    outcome: Mapped[str] = mapped_column(Word(16))  #: a GateOutcome
    words: Mapped[str]
    remedy: Mapped[str]
    operator: Mapped[str]  #: who overrode a refusal; empty otherwise
    why: Mapped[str]


class ReleaseRow(Base):
    """A configuration file was released, or withdrawn; the latest row of a kind and digest holds."""

    __tablename__ = "releases"
    __table_args__ = (Index(None, "sha256", "release_id"),)

    release_id: Mapped[str] = mapped_column(Identifier, primary_key=True)
    kind: Mapped[str] = mapped_column(Word(16))
    name: Mapped[str]
    sha256: Mapped[str] = mapped_column(Word(64))  #: of the content of the file
    outcome: Mapped[str] = mapped_column(Word(16))  #: "released" or "withdrawn"
    operator: Mapped[str]
    why: Mapped[str]
    noted_at: Mapped[datetime]
