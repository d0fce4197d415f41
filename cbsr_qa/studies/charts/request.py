"""What control charts are asked for: which, of which runs, and a reference period that is to be stored."""

from dataclasses import dataclass
from datetime import date
from typing import Final

from cbsr_qa.config import validate_operator
from cbsr_qa.domain import RefusedError
from cbsr_qa.domain.run import ChartKind, ChartSettings
from cbsr_qa.stats import MOST
from cbsr_qa.stats.gauge import FEWEST_CHARTED
from cbsr_qa.studies.charts.charting import RULES

#: Fewer runs make limits that are next to none.
FEWEST_RUNS: Final = FEWEST_CHARTED
#: Fewer ranges of groups hardly tell a deviation.
FEWEST_GROUPS: Final = 3
_DEFAULT: Final = ChartSettings()


@dataclass(frozen=True, slots=True)
class ReferencePeriod:
    """A reference period that is to be stored.

    Parameters
    ----------
    since : first day, UTC; None for the first run there is.
    runs, until : so many runs, or all to the end of this day; one of them.
    operator, why : who sets it, and for what reason.
    stored : False shows what it would give and stores nothing.
    """

    since: date | None
    runs: int | None
    until: date | None
    operator: str
    why: str = ""
    stored: bool = True


@dataclass(frozen=True, slots=True)
class Retirement:
    """Charts that are to be retired: those of one kind, by whom and for what reason."""

    kind: ChartKind
    operator: str
    why: str = ""


@dataclass(frozen=True, slots=True)
class ChartsRequest:
    """Which charts.

    Parameters
    ----------
    recipe : of the runs; None where the station's are of one.
    golden : only runs of this sensor; empty for production runs.
    metrics : names; none for all with a stored reference, or (with a new period) those the recipe limits.
    by_location : a chart a location.
    period : to be set; None to chart against what is stored.
    retirement : charts to retire before; None for none.
    """

    station: str
    recipe: str | None = None
    golden: str = ""
    metrics: tuple[str, ...] = ()
    by_location: bool = False
    settings: ChartSettings = _DEFAULT
    period: ReferencePeriod | None = None
    retirement: Retirement | None = None


def check_request(request: ChartsRequest) -> None:
    """Refuse what cannot be charted, before anything is read.

    Raises
    ------
    RefusedError
        If rules or groups are none, or the reference period has no end, is too short, or is set by nobody.
    """
    settings, period = request.settings, request.period
    unknown = [str(number) for number in settings.rules if number not in RULES]
    if unknown or not settings.rules:
        raise RefusedError(f"--rules names {', '.join(unknown) or 'none'}", remedy="allowed: 1 to 8, Nelson's tests")
    grouped = settings.kind is ChartKind.MEANS
    if not (2 <= settings.subgroup <= MOST if grouped else settings.subgroup == 1):
        allowed = f"2 to {MOST} with --chart xbar-r, and none with another chart"
        raise RefusedError(f"--subgroup is {settings.subgroup}", remedy=f"allowed: {allowed}")
    _check_retirement(request)
    if period is None:
        return
    if (period.runs is None) == (period.until is None):
        raise RefusedError(
            "the reference period has no end, or two", remedy="give --reference-runs N or --reference-until DATE"
        )
    if period.runs is not None and period.runs < FEWEST_RUNS:
        raise RefusedError(f"a reference period of {period.runs} runs is too short", remedy=f"at least {FEWEST_RUNS}")
    if period.runs is not None and grouped:
        _check_groups(period.runs, settings.subgroup)
    validate_operator(period.operator)
    if period.stored and not period.operator:
        raise RefusedError(
            "nobody sets this reference", remedy="give --operator: who sets limits is kept with them (or --dry-run)"
        )


def _check_retirement(request: ChartsRequest) -> None:
    if request.retirement is None:
        return
    if request.period is not None:
        raise RefusedError("--retire beside a new reference period", remedy="do one after the other")
    validate_operator(request.retirement.operator)
    if not request.retirement.operator:
        raise RefusedError("nobody retires these charts", remedy="give --operator: who retires charts is kept")


def _check_groups(runs: int, size: int) -> None:
    """Refuse a reference period of which some runs would be in no group, or that has too few groups."""
    least = FEWEST_GROUPS * size
    if runs < least or runs % size:
        near = sorted({max(least, runs - runs % size), max(least, runs - runs % size + size)})
        raise RefusedError(
            f"a reference period of {runs} runs is not {FEWEST_GROUPS} or more whole groups of {size}",
            remedy=f"give {' or '.join(map(str, near))}",
        )
