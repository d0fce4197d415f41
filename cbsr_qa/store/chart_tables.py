"""Table of what control charts of stations rest on. Rows are never changed: the latest of a chart holds."""

from datetime import datetime
from typing import Any

from sqlalchemy import ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from cbsr_qa.store.run_tables import Base, Identifier


class ChartReferenceRow(Base):
    """Limits of one chart, from a reference period."""

    __tablename__ = "chart_references"
    __table_args__ = (Index(None, "station", "reference"),)

    reference: Mapped[str] = mapped_column(Identifier, primary_key=True)
    station: Mapped[str]
    recipe: Mapped[str]
    golden: Mapped[str]  #: serial number of a golden sensor; empty for production runs
    name: Mapped[str] = mapped_column(String(64))
    phase: Mapped[str]
    qualifier: Mapped[str]
    location: Mapped[str]
    unit: Mapped[str]
    kind: Mapped[str] = mapped_column(String(16))  #: a ChartKind
    settings: Mapped[
        dict[str, Any]
    ]  #: subgroup, rules, weight, width, slack, threshold; retired of a row that ends a chart
    mean: Mapped[float]
    deviation: Mapped[float]
    runs: Mapped[int]
    first_run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"))
    last_run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"))
    operator: Mapped[str]
    made_at: Mapped[datetime]
    why: Mapped[str]
