"""What metrics of a whole run share: a figure in percent, and a refusal with its reason."""

from cbsr_qa.calibrate.data_sheet import Estimate
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.measurement import Measurement


def percent(name: str, estimate: Estimate, how: str, *, qualifier: str = "", location: str = "") -> Measurement:
    """Make a measurement in percent of an estimate that is a fraction."""
    stderr = None if estimate.stderr is None else 100 * estimate.stderr
    return Measurement(
        name, 100 * estimate.value, "%", uncertainty=stderr, qualifier=qualifier, location=location, how=how
    )


def refused(name: str, unit: str, error: NumericsError, *, qualifier: str = "") -> Measurement:
    """Make a measurement without a value that says why, and what would help."""
    how = f"{error.reason}; {error.remedy}" if error.remedy else error.reason
    return Measurement(name, None, unit, qualifier=qualifier, how=how)


def counted(count: int, one: str, many: str = "") -> str:
    """Write a count with its noun: ``1 press``, ``3 presses``."""
    return f"{count} {one if count == 1 else many or f'{one}s'}"
