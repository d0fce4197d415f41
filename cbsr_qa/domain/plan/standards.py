"""Reference standards that a station's forces are traced to, as their calibration certificates state them."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import date
from enum import StrEnum
from math import inf, sqrt
from typing import Annotated, Final

from cbsr_qa.domain.kept import Kept

#: Unit of an uncertainty relative to the value.
PERCENT = "%"
#: Time since the reference frame for which a calibration in use is stated: meters drift by so much a year.
IN_USE_YEARS: Final = 1.0


class StandardRole(StrEnum):
    """What a reference standard is used for."""

    LOAD_CELL = "load_cell"  #: forces of loads
    INDENTER = "indenter"  #: area of the head
    STAGE = "stage"  #: places of loads
    THERMOMETER = "thermometer"  #: temperature of a run
    SOURCE_METER = "source_meter"  #: readings per current, of a source meter or a board


#: Roles whose readings have steps.
_SHOW_STEPS: Final = (StandardRole.LOAD_CELL, StandardRole.STAGE, StandardRole.THERMOMETER)
#: Unit of a role's range and resolution; a head has neither.
ROLE_UNITS: Final[Mapping[str, str]] = {
    StandardRole.LOAD_CELL: "N",
    StandardRole.STAGE: "mm",
    StandardRole.THERMOMETER: "°C",
    StandardRole.SOURCE_METER: "mA",
}


@dataclass(frozen=True, slots=True)
class ReferenceStandard:
    """A reference standard, as its calibration certificate states it.

    Parameters
    ----------
    role : value of :class:`StandardRole`.
    certificate, laboratory : number of the certificate, and who issued it.
    date, due : ISO dates of the calibration, and of the next one.
    uncertainty : expanded uncertainty U, with the coverage factor ``k``.
    k : coverage factor; the standard uncertainty is U/k (JCGM 100, 6.2).
    unit : ``"%"`` of the value (of the area, for an indenter), ``"N"``, ``"mm"`` of a round head's diameter or of a
        place, or ``"°C"``.
    drift_a_year : most that the value may have changed in a year since ``date``, in ``unit``; None if not stated.
    resolution : smallest step that it shows, in the unit of :data:`ROLE_UNITS`; None if not stated.
    range_low, range_high : values that the certificate covers, in the same unit; None if not stated.
    """

    role: str
    certificate: str
    laboratory: str
    date: str
    due: str
    uncertainty: Annotated[float, Kept(least=0)]
    k: Annotated[float, Kept(least=0)]
    unit: str
    drift_a_year: Annotated[float | None, Kept(since=8)] = None
    resolution: Annotated[float | None, Kept(since=8)] = None
    range_low: Annotated[float | None, Kept(since=8)] = None
    range_high: Annotated[float | None, Kept(since=8)] = None

    @property
    def role_words(self) -> str:
        return self.role.replace("_", " ")

    @property
    def standard_uncertainty(self) -> float:
        """Standard uncertainty in its unit; a fraction where that is ``"%"``."""
        return self.uncertainty / self.k / (100 if self.unit == PERCENT else 1)

    def drift_uncertainty(self, years: float) -> float | None:
        """Standard uncertainty of its drift in some years since its date, as above; None if it states none.

        A change of at most a has the standard uncertainty a/√3 (JCGM 100, 4.3.7).
        """
        if self.drift_a_year is None:
            return None
        return self.drift_a_year * max(years, 0.0) / sqrt(3) / (100 if self.unit == PERCENT else 1)

    def covers(self, value: float) -> bool:
        """Whether a value is in the certificate's range, or none is stated."""
        return self.range_low is None or self.range_high is None or self.range_low <= value <= self.range_high

    @property
    def span(self) -> float:
        """Width of the certificate's range; infinite if none is stated."""
        return inf if self.range_low is None or self.range_high is None else self.range_high - self.range_low

    def range_words(self) -> str:
        """Return the range, e.g. ``0.5 to 20 N``; it must be stated."""
        return f"{self.range_low:g} to {self.range_high:g} {ROLE_UNITS[self.role]}"

    def words(self) -> str:
        """Return what is stated, e.g. ``U = 0.2 % (k = 2), certificate K-7 of D-K-1, due 2027-03-31``."""
        uncertainty = f"U = {self.uncertainty:g} {self.unit} (k = {self.k:g})"
        return f"{uncertainty}, certificate {self.certificate} of {self.laboratory}, due {self.due}"

    def all_words(self) -> str:
        """Return :meth:`words` with range, resolution and drift; ``not stated`` for what is not."""
        drift = "not stated" if self.drift_a_year is None else f"at most {self.drift_a_year:g} {self.unit} a year"
        parts = [self.words()]
        if self.role in ROLE_UNITS:
            parts.append(f"range {'not stated' if self.range_low is None else self.range_words()}")
        if self.resolution is None and self.role in _SHOW_STEPS:
            parts.append("resolution not stated")
        elif self.resolution is not None:
            parts.append(f"resolution {self.resolution:g} {ROLE_UNITS[self.role]}")
        return ", ".join([*parts, f"drift {drift}"])


def find_standard(standards: Iterable[ReferenceStandard], role: StandardRole) -> ReferenceStandard | None:
    """Return the standard of a role; None if it is not stated."""
    return next((standard for standard in standards if standard.role == role), None)


def name_unstated(standards: Iterable[ReferenceStandard]) -> tuple[str, ...]:
    """Return the roles that no certificate is stated for, in words."""
    stated = {standard.role for standard in standards}
    return tuple(role.replace("_", " ") for role in StandardRole if role not in stated)


def describe_force_error(standards: Iterable[ReferenceStandard]) -> str:
    """Return what standard errors of force include, as the rest of a sentence that begins with them."""
    load_cell = find_standard(standards, StandardRole.LOAD_CELL)
    return (
        "scatter only; load cell not stated" if load_cell is None else f"scatter and load cell ({load_cell.words()})"
    )


def past_due(due: str | None, today: date) -> bool:
    """Whether a calibration was due before today, an ISO date; the day itself is in time."""
    return due is not None and date.fromisoformat(due) < today


def is_dated_later(certificate_date: str, today: date) -> bool:
    """Whether a certificate is dated after today, so that it cannot exist yet."""
    return date.fromisoformat(certificate_date) > today


def find_overdue(due_by_name: Mapping[str, str | None], today: date) -> Iterator[str]:
    """Yield instruments, by name with an ISO date or None, that were due before today."""
    for name, due in due_by_name.items():
        if past_due(due, today):
            yield f"the calibration of {name} was due on {due}"


def find_doubtful_dates(standards: Iterable[ReferenceStandard], today: date) -> Iterator[str]:
    """Yield standards that were due before today, or whose certificates are dated later."""
    for standard in standards:
        if past_due(standard.due, today):
            certified = f"the {standard.role_words} (certificate {standard.certificate})"
            yield f"the calibration of {certified} was due on {standard.due}"
        if is_dated_later(standard.date, today):
            words = f"the certificate {standard.certificate} of the {standard.role_words} is dated {standard.date}"
            yield f"{words}, later than today, {today}"
