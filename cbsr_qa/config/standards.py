"""``[standards]`` of station files: certificates of what forces, heads, places, temperature and readings rest on."""

from collections.abc import Iterator, Sequence
from datetime import date
from typing import Annotated, Any, Final, Literal

from pydantic import ConfigDict, Field

from cbsr_qa.config.tables import PRINTABLE, FileModel, IsoDate, as_domain
from cbsr_qa.domain.plan.standards import PERCENT, ReferenceStandard, StandardRole
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.plugin.problems import Problem, Table

_Text = Annotated[str, Field(min_length=1, max_length=200), PRINTABLE]
#: Largest coverage factor: k of 95 % with a single degree of freedom is 12.7.
_LARGEST_K = 14.0
#: Expanded uncertainty relative to a value from which nothing is known of it [%].
_LARGEST_PERCENT = 100.0


#: Ends of the keys of a role's range and resolution.
_SUFFIXES: Final = {
    StandardRole.LOAD_CELL: "N",
    StandardRole.STAGE: "mm",
    StandardRole.THERMOMETER: "C",
    StandardRole.SOURCE_METER: "mA",
}

_Range = Annotated[list[float], Field(min_length=2, max_length=2)]
_Step = Annotated[float, Field(gt=0, le=1e6)]


class _StandardTable(Table):
    """What a calibration certificate states; all of it but the drift is needed."""

    certificate: _Text
    laboratory: _Text
    date: IsoDate
    due: IsoDate
    uncertainty: Annotated[float, Field(gt=0, le=1e6)]
    k: Annotated[float, Field(ge=1, le=_LARGEST_K)]
    unit: str
    drift_a_year: Annotated[float, Field(ge=0, le=1e6)] | None = None

    def problems(self, role: StandardRole) -> Iterator[Problem]:
        if self.unit == PERCENT and self.uncertainty >= _LARGEST_PERCENT:
            finding = f"is {self.uncertainty:g} %, which states nothing of the value"
            yield Problem(("standards", role, "uncertainty"), finding, f"allowed: below {_LARGEST_PERCENT:g} %")
        if not date.fromisoformat(self.date) < date.fromisoformat(self.due):
            yield Problem(("standards", role, "due"), f"{self.due} is not after the date of calibration, {self.date}")
        covered = self._select_by_unit(role, "range")
        if covered is not None and not covered[0] < covered[1]:
            key = f"range_{_SUFFIXES[role]}"
            yield Problem(("standards", role, key), "is no range; give the lowest and then the highest")

    def to_domain(self, role: StandardRole) -> ReferenceStandard:
        low, high = self._select_by_unit(role, "range") or (None, None)
        step = self._select_by_unit(role, "resolution")
        return as_domain(ReferenceStandard, self, role=role.value, resolution=step, range_low=low, range_high=high)

    def _select_by_unit(self, role: StandardRole, what: str) -> Any:
        """Return what is stated by a key that ends with the unit of the role; None if it is not."""
        return getattr(self, f"{what}_{_SUFFIXES.get(role)}", None)


class LoadCellTable(_StandardTable):
    """``[standards.load_cell]``: certificate of the load cell; an uncertainty in % is one of the reading."""

    unit: Literal["%", "N"]
    range_N: _Range | None = None
    resolution_N: _Step | None = None


class HeadTable(_StandardTable):
    """``[standards.indenter]``: certificate of the head; in % of its area, or in mm of its diameter."""

    unit: Literal["%", "mm"]


class StageTable(_StandardTable):
    """``[standards.stage]``: certificate of what places the head; of a place along an axis."""

    unit: Literal["mm"]
    range_mm: _Range | None = None
    resolution_mm: _Step | None = None


class ThermometerTable(_StandardTable):
    """``[standards.thermometer]``: certificate of the thermometer."""

    unit: Literal["°C"]
    range_C: _Range | None = None
    resolution_C: _Step | None = None


class SourceMeterTable(_StandardTable):
    """``[standards.source_meter]``: certificate of a source meter or board, of voltage over current."""

    unit: Literal["%"]
    range_mA: _Range | None = None


class StandardsTable(Table):
    """``[standards]``: reference standards of the station; what is left out is not stated."""

    load_cell: LoadCellTable | None = None
    indenter: HeadTable | None = None
    stage: StageTable | None = None
    thermometer: ThermometerTable | None = None
    source_meter: SourceMeterTable | None = None

    def problems(self) -> Iterator[Problem]:
        """Yield contradictions of each certificate with itself."""
        for role, table in self.tables():
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

    def temperature_problems(self, allowed_C: Sequence[float] | None) -> Iterator[Problem]:
        """Yield a contradiction with the temperatures that the station allows."""
        covered = None if self.thermometer is None else self.thermometer.range_C
        if (
            covered is not None
            and allowed_C is not None
            and not covered[0] <= allowed_C[0] <= allowed_C[1] <= covered[1]
        ):
            finding = f"is {covered[0]:g} to {covered[1]:g} °C, and safety.temperature_C is not within it"
            yield Problem(("standards", "thermometer", "range_C"), finding, "allow temperatures that it covers")

    def to_domain(self) -> tuple[ReferenceStandard, ...]:
        return tuple(table.to_domain(role) for role, table in self.tables())

    def tables(self) -> Iterator[tuple[StandardRole, _StandardTable]]:
        """Yield the roles that are stated, with their tables."""
        for role in StandardRole:
            table = getattr(self, role.value)
            if table is not None:
                yield role, table


class StandardsFile(FileModel[tuple[ReferenceStandard, ...]]):
    """A file with ``[standards]``: by itself, or a station's, of which nothing else is looked at."""

    model_config = ConfigDict(extra="ignore", strict=True, frozen=True, allow_inf_nan=False)

    standards: StandardsTable

    def problems(self) -> Iterator[Problem]:
        if not list(self.standards.tables()):
            roles = " or ".join(f"[standards.{role}]" for role in StandardRole)
            yield Problem(("standards",), "states no standard", f"give {roles}")
        yield from self.standards.problems()

    def to_domain(self) -> tuple[ReferenceStandard, ...]:
        return self.standards.to_domain()
