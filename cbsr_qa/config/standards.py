"""``[standards]`` of station files: certificates of the load cell and the indenter."""

from collections.abc import Iterator
from datetime import date
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from cbsr_qa.config.tables import FileModel, IsoDate, as_domain
from cbsr_qa.domain.plan.standards import PERCENT, ReferenceStandard, StandardRole
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.plugin.problems import Problem, Table

_Text = Annotated[str, Field(min_length=1, max_length=200)]
#: Largest coverage factor: k of 95 % with a single degree of freedom is 12.7.
_LARGEST_K = 14.0
#: Expanded uncertainty relative to a value from which nothing is known of it [%].
_LARGEST_PERCENT = 100.0


class _StandardTable(Table):
    """What a calibration certificate states; all of it is needed."""

    certificate: _Text
    laboratory: _Text
    date: IsoDate
    due: IsoDate
    uncertainty: Annotated[float, Field(gt=0, le=1e6)]
    k: Annotated[float, Field(ge=1, le=_LARGEST_K)]
    unit: str

    def problems(self, role: StandardRole) -> Iterator[Problem]:
        if self.unit == PERCENT and self.uncertainty >= _LARGEST_PERCENT:
            finding = f"is {self.uncertainty:g} %, which states nothing of the value"
            yield Problem(("standards", role, "uncertainty"), finding, f"allowed: below {_LARGEST_PERCENT:g} %")
        if not date.fromisoformat(self.date) < date.fromisoformat(self.due):
            yield Problem(("standards", role, "due"), f"{self.due} is not after the date of calibration, {self.date}")


class LoadCellTable(_StandardTable):
    """``[standards.load_cell]``: certificate of the load cell; an uncertainty in % is one of the reading."""

    unit: Literal["%", "N"]


class HeadTable(_StandardTable):
    """``[standards.indenter]``: certificate of the head; in % of its area, or in mm of its diameter."""

    unit: Literal["%", "mm"]


class StandardsTable(Table):
    """``[standards]``: reference standards of the station; what is left out is not stated."""

    load_cell: LoadCellTable | None = None
    indenter: HeadTable | None = None

    def problems(self) -> Iterator[Problem]:
        """Yield contradictions of each certificate with itself."""
        for role, table in self._tables():
            yield from table.problems(role)

    def head_problems(self, head: Indenter) -> Iterator[Problem]:
        """Yield contradictions with the station's head."""
        if self.indenter is not None and self.indenter.unit == "mm" and head.outline_mm:
            finding = 'is "mm", of a diameter, and the head of the station is not round'
            yield Problem(("standards", "indenter", "unit"), finding, 'give the uncertainty of its area in "%"')
        elif (
            self.indenter is not None and self.indenter.unit == "mm" and self.indenter.uncertainty >= head.diameter_mm
        ):
            finding = f"is {self.indenter.uncertainty:g} mm, of a head of {head.diameter_mm:g} mm"
            yield Problem(("standards", "indenter", "uncertainty"), finding, "allowed: less than the diameter")

    def to_domain(self) -> tuple[ReferenceStandard, ...]:
        return tuple(as_domain(ReferenceStandard, table, role=role.value) for role, table in self._tables())

    def _tables(self) -> Iterator[tuple[StandardRole, LoadCellTable | HeadTable]]:
        for role, table in ((StandardRole.LOAD_CELL, self.load_cell), (StandardRole.INDENTER, self.indenter)):
            if table is not None:
                yield role, table


class StandardsFile(FileModel[tuple[ReferenceStandard, ...]]):
    """A file with ``[standards]``: by itself, or a station's, of which nothing else is looked at."""

    model_config = ConfigDict(extra="ignore", strict=True, frozen=True, allow_inf_nan=False)

    standards: StandardsTable

    def problems(self) -> Iterator[Problem]:
        if self.standards.load_cell is None and self.standards.indenter is None:
            yield Problem(("standards",), "states no standard", "give [standards.load_cell] or [standards.indenter]")
        yield from self.standards.problems()

    def to_domain(self) -> tuple[ReferenceStandard, ...]:
        return self.standards.to_domain()
