"""Tables of what people changed: files of a known name, and verdicts. Rows are never changed."""

from datetime import datetime
from typing import Any

from sqlalchemy import ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from cbsr_qa.store.run_tables import Base, Identifier


class ConfigurationChangeRow(Base):
    """A run used a file of a known name with another content than the latest run before it."""

    __tablename__ = "configuration_changes"
    __table_args__ = (Index(None, "kind", "name"),)

    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"), primary_key=True)
    kind: Mapped[str] = mapped_column(String(16), primary_key=True)  #: a FileKind
    name: Mapped[str]
    earlier_run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"))  #: the latest with the old content
    old_sha256: Mapped[str] = mapped_column(String(64))
    new_sha256: Mapped[str] = mapped_column(String(64))
    differences: Mapped[list[Any]]  #: [[key, before, after], …] as JSON text; null where the key was not there
    operator: Mapped[str]
    noted_at: Mapped[datetime]
    why: Mapped[str]


class VerdictOverrideRow(Base):
    """Somebody's decision against the verdict of an analysis; the latest of an analysis holds."""

    __tablename__ = "verdict_overrides"
    __table_args__ = (Index(None, "run"),)

    override_id: Mapped[str] = mapped_column(Identifier, primary_key=True)
    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"))
    analysis: Mapped[str] = mapped_column(Identifier, ForeignKey("analyses.analysis"))
    outcome: Mapped[str] = mapped_column(String(16))
    operator: Mapped[str]
    why: Mapped[str]
    noted_at: Mapped[datetime]
