"""Reference standards that a station's forces are traced to, as their calibration certificates state them."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import date
from enum import StrEnum
from typing import Annotated

from cbsr_qa.domain.kept import Kept

#: Unit of an uncertainty relative to the value.
PERCENT = "%"


class StandardRole(StrEnum):
    """What a reference standard is used for."""

    LOAD_CELL = "load_cell"  #: forces of loads
    INDENTER = "indenter"  #: area of the head


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
    unit : ``"%"`` of the value (of the area, for an indenter), ``"N"``, or ``"mm"`` of a round head's diameter.
    """

    role: str
    certificate: str
    laboratory: str
    date: str
    due: str
    uncertainty: Annotated[float, Kept(least=0)]
    k: Annotated[float, Kept(least=0)]
    unit: str

    @property
    def role_words(self) -> str:
        return self.role.replace("_", " ")

    @property
    def standard_uncertainty(self) -> float:
        """Standard uncertainty in its unit; a fraction where that is ``"%"``."""
        return self.uncertainty / self.k / (100 if self.unit == PERCENT else 1)

    def words(self) -> str:
        """Return what is stated, e.g. ``U = 0.2 % (k = 2), certificate K-7 of D-K-1, due 2027-03-31``."""
        uncertainty = f"U = {self.uncertainty:g} {self.unit} (k = {self.k:g})"
        return f"{uncertainty}, certificate {self.certificate} of {self.laboratory}, due {self.due}"


def find_standard(standards: Iterable[ReferenceStandard], role: StandardRole) -> ReferenceStandard | None:
    """Return the standard of a role; None if it is not stated."""
    return next((standard for standard in standards if standard.role == role), None)


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


def find_doubtful_dates(standards: Iterable[ReferenceStandard], today: date) -> Iterator[str]:
    """Yield standards that were due before today, or whose certificates are dated later."""
    for standard in standards:
        if past_due(standard.due, today):
            certified = f"the {standard.role_words} (certificate {standard.certificate})"
            yield f"the calibration of {certified} was due on {standard.due}"
        if is_dated_later(standard.date, today):
            words = f"the certificate {standard.certificate} of the {standard.role_words} is dated {standard.date}"
            yield f"{words}, later than today, {today}"
