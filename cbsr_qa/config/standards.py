"""``[standards]`` of station files: certificates of what forces, heads, places, temperature and readings rest on."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from datetime import date
from math import sqrt
from typing import Annotated, Any, Final, Literal

from pydantic import ConfigDict, Field

from cbsr_qa.config.tables import PRINTABLE, FileModel, IsoDate, as_domain
from cbsr_qa.domain.plan.standards import PERCENT, ROLE_UNITS, ReferenceStandard, StandardRole
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.plugin.problems import Problem, Table

_Text = Annotated[str, Field(min_length=1, max_length=200), PRINTABLE]
#: Largest coverage factor: k of 95 % with a single degree of freedom is 12.7.
_LARGEST_K = 14.0
#: Largest expanded uncertainty, and drift in a year, relative to the value: with u of a tenth, terms of second order
#: are a tenth of u.
_LARGEST_PERCENT: Final = 20.0
#: Longest interval of calibrations: beyond it, a year is mistyped. Chosen by us.
_LONGEST_YEARS: Final = 100
#: Largest share of a range that a step may be: half of a step is then 5 % of the greatest value.
_LARGEST_STEP: Final = 0.1
#: Least expanded uncertainties, below what national institutes state for such quantities.
_LEAST: Final = {"N": 1e-7, "mm": 1e-6, "°C": 1e-4}
_LEAST_PERCENT: Final = {StandardRole.LOAD_CELL: 1e-3, StandardRole.INDENTER: 1e-3, StandardRole.SOURCE_METER: 1e-6}


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
        least = _LEAST_PERCENT[role] if self.unit == PERCENT else _LEAST[self.unit]
        if self.uncertainty < least:
            finding = f"is {self.uncertainty:g} {self.unit}, less than national institutes reach"
            yield Problem(("standards", role, "uncertainty"), finding, f"allowed: at least {least:g} {self.unit}")
        if not date.fromisoformat(self.date) < date.fromisoformat(self.due):
            yield Problem(("standards", role, "due"), f"{self.due} is not after the date of calibration, {self.date}")
        elif int(self.due[:4]) - int(self.date[:4]) > _LONGEST_YEARS:
            finding = f"is {self.due}, of a calibration on {self.date}"
            yield Problem(("standards", role, "due"), finding, f"allowed: within {_LONGEST_YEARS} years")
        covered = self._select_by_unit(role, "range")
        if covered is not None and not covered[0] < covered[1]:
            key = f"range_{_SUFFIXES[role]}"
            finding = f"is {covered[0]:g} to {covered[1]:g} {ROLE_UNITS[role]}, no range"
            yield Problem(("standards", role, key), finding, "give the lowest and then the highest")

    def size_problems(self, role: StandardRole, span: float | None) -> Iterator[Problem]:
        """Yield what is too large for the range, or contradicts the resolution.

        Parameters
        ----------
        span : width of the station's range of this quantity; None if unknown. Beside the certificate's, the smaller
            counts; of temperatures the certificate's.
        """
        covered = self._select_by_unit(role, "range")
        width = span if covered is None else covered[1] - covered[0]
        greatest = span if covered is None else covered[1]
        if width is not None and greatest is not None and span is not None and role is not StandardRole.THERMOMETER:
            width, greatest = min(width, span), min(greatest, span)
        whole = 100.0 if self.unit == PERCENT else width
        for key, value in (("uncertainty", self.uncertainty), ("drift_a_year", self.drift_a_year or 0.0)):
            if whole is not None and whole > 0 and value > whole * _LARGEST_PERCENT / 100:
                of_range = "" if self.unit == PERCENT else f", of a range of {whole:g} {self.unit}"
                finding = f"is {value:g} {self.unit}{of_range}"
                most = whole * _LARGEST_PERCENT / 100
                yield Problem(("standards", role, key), finding, f"allowed: at most {most:g} {self.unit}")
        step = self._select_by_unit(role, "resolution")
        if step is None:
            return
        key = f"resolution_{_SUFFIXES[role]}"
        if width is not None and step > width * _LARGEST_STEP > 0:
            finding = f"is {step:g}, of a range of {width:g} {ROLE_UNITS[role]}"
            yield Problem(("standards", role, key), finding, f"allowed: at most {width * _LARGEST_STEP:g}")
            return
        scale = (0.0 if greatest is None else greatest / 100) if self.unit == PERCENT else 1.0
        u, of_step = self.uncertainty / self.k * scale, step / sqrt(12)
        if 0 < u < of_step:
            unit = ROLE_UNITS[role]
            finding = f"means u = {u:.3g} {unit} at most, and steps of {step:g} {unit} alone are {of_step:.3g} {unit}"
            yield Problem(
                ("standards", role, "uncertainty"), finding, f"give one with its resolution, or correct {key}"
            )

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

    def size_problems(self, spans: Mapping[StandardRole, float]) -> Iterator[Problem]:
        """Yield what does not fit the range of its quantity: the certificate's, else the station's.

        Parameters
        ----------
        spans : widths of the station's ranges [N, mm, °C], by role.
        """
        for role, table in self.tables():
            if {problem.path[-1] for problem in table.problems(role)} <= {"due"}:
                yield from table.size_problems(role, spans.get(role))

    def instrument_problems(self, provided: Collection[str], currents_mA: Mapping[str, float]) -> Iterator[Problem]:
        """Yield certificates of what the station does not measure, or not with such a current.

        Parameters
        ----------
        provided : roles that the station's instruments provide.
        currents_mA : stated drive currents, by instrument.
        """
        if self.thermometer is not None and "temperature" not in provided:
            finding = 'is stated, and no instrument provides "temperature"'
            yield Problem(("standards", "thermometer"), finding, "leave it out, or add the thermometer's instrument")
        covered = None if self.source_meter is None else self.source_meter.range_mA
        for name, current_mA in currents_mA.items():
            if covered is not None and covered[0] < covered[1] and not covered[0] <= current_mA <= covered[1]:
                finding = (
                    f"is {covered[0]:g} to {covered[1]:g} mA, and instruments.{name}.current_mA {current_mA:g} mA"
                )
                yield Problem(("standards", "source_meter", "range_mA"), finding, "drive a current that it covers")

    def head_problems(self, head: Indenter) -> Iterator[Problem]:
        """Yield contradictions with the station's head."""
        if self.indenter is not None and self.indenter.unit == "mm" and head.outline_mm:
            finding = 'is "mm", of a diameter, and the head of the station is not round'
            yield Problem(("standards", "indenter", "unit"), finding, 'give the uncertainty of its area in "%"')
        elif self.indenter is not None and self.indenter.unit == "mm":
            most_mm = head.diameter_mm * _LARGEST_PERCENT / 100
            for key in ("uncertainty", "drift_a_year"):
                value_mm = getattr(self.indenter, key) or 0.0
                if value_mm > most_mm:
                    finding = f"is {value_mm:g} mm, of a head of {head.diameter_mm:g} mm"
                    yield Problem(("standards", "indenter", key), finding, f"allowed: at most {most_mm:g} mm")

    def temperature_problems(self, allowed_C: Sequence[float] | None) -> Iterator[Problem]:
        """Yield a contradiction with the temperatures that the station allows."""
        covered = None if self.thermometer is None else self.thermometer.range_C
        if (
            covered is not None
            and allowed_C is not None
            and covered[0] < covered[1]
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
        yield from self.standards.size_problems({})

    def to_domain(self) -> tuple[ReferenceStandard, ...]:
        return self.standards.to_domain()
