"""What a check of a station came to, for whoever asked for it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cbsr_qa.domain.station_check import CheckOutcome, CheckResult, StationCheck


@dataclass(frozen=True, slots=True)
class CheckedStation:
    """What came of a check: stored, and written as a page.

    Parameters
    ----------
    page : None where it could not be written; ``page_why`` then says why.
    answered : whether any instrument answered.
    """

    check: StationCheck
    page: Path | None
    page_why: str
    answered: bool

    @property
    def exit_code(self) -> int:
        """0 all well or warnings only, 1 something failed, 3 no instrument answered."""
        if not self.answered:
            return 3
        return 1 if self.check.outcome is CheckOutcome.FAILED else 0

    def document(self) -> dict[str, Any]:
        """Return the check as one JSON document."""
        check = self.check
        return {
            "check": check.check,
            "station": check.station,
            "operator": check.operator,
            "checked_at": check.checked_at.isoformat(),
            "outcome": str(check.outcome),
            "results": [result_row(line) for line in check.results],
            "instruments": [
                {
                    "role": one.role,
                    "driver": one.driver,
                    "model": one.model,
                    "serial": one.serial,
                    "firmware": one.firmware,
                    "simulated": one.simulated,
                    "calibration_due": one.calibration_due,
                    "notes": dict(one.notes),
                }
                for one in check.instruments
            ],
            "golden_run": check.golden_run,
            "configuration_digest": check.configuration_digest,
            "page": None if self.page is None else str(self.page),
            "page_why": self.page_why,
        }


def result_row(line: CheckResult) -> dict[str, Any]:
    """Return a line of a check as a JSON object; what it does not have is null or empty."""
    return {
        "subject": line.subject,
        "name": line.name,
        "outcome": str(line.outcome),
        "value": line.value,
        "unit": line.unit,
        "allowed": line.allowed,
        "said": line.said,
        "remedy": line.remedy,
    }
