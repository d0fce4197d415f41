"""Request for control charts: which charts, of which runs, and a reference period to store."""

from dataclasses import dataclass
from datetime import date
from typing import Final

from cbsr_qa.config.serials import validate_operator
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.results.charts import ChartKind, ChartSettings
from cbsr_qa.domain.sensor.sensor_type import SensorPart
from cbsr_qa.stats.gauge.reference import FEWEST_CHARTED
from cbsr_qa.stats.nelson import MOST
from cbsr_qa.studies.charts.charting import RULES

#: Smallest number of runs; limits from fewer are almost meaningless.
FEWEST_RUNS: Final = FEWEST_CHARTED
#: Smallest number of groups; with fewer ranges the deviation is almost unknown.
FEWEST_GROUPS: Final = 3
_DEFAULT: Final = ChartSettings()


@dataclass(frozen=True, slots=True)
class ReferencePeriod:
    """A reference period to set.

    Parameters
    ----------
    since : first day, UTC; None for the first run.
    runs, until : number of runs, or last day; one of them.
    """

    since: date | None
    runs: int | None
    until: date | None


@dataclass(frozen=True, slots=True)
class ChartsRequest:
    """Which charts.

    Parameters
    ----------
    parts : parts that the sensors have; none for all sensors.
    recipe : recipe of the runs; None if the station's runs have only one.
    golden : serial of the golden sensor whose runs are charted; None for production runs.
    metrics : names; none for all with a stored reference, or (with a new period) those the recipe limits.
    by_location : True for one chart per location.
    period : reference period to set; None to use stored references.
    dry_run : show the result of a new period, but store nothing.
    retire : kind of charts to retire first, or None.
    operator, why : who sets the period or retires charts, and the reason.
    """

    station: str
    recipe: str | None = None
    golden: str | None = None
    metrics: tuple[str, ...] = ()
    by_location: bool = False
    settings: ChartSettings = _DEFAULT
    period: ReferencePeriod | None = None
    dry_run: bool = False
    retire: ChartKind | None = None
    operator: str = ""
    why: str = ""
    parts: tuple[SensorPart, ...] = ()


def check_request(request: ChartsRequest) -> None:
    """Check a request before anything is read.

    Raises
    ------
    RefusedError
        If rules or the size of groups are not allowed, the reference period has no end, is too short, has no
        operator, or would be stored although it is of the sensors with some part alone.
    """
    settings, period = request.settings, request.period
    unknown = [str(number) for number in settings.rules if number not in RULES]
    if unknown or not settings.rules:
        raise RefusedError(f"--rules names {', '.join(unknown) or 'none'}", remedy="allowed: 1 to 8, Nelson's tests")
    grouped = settings.chart is ChartKind.MEANS
    if not (2 <= settings.subgroup <= MOST if grouped else settings.subgroup == 1):
        allowed = f"2 to {MOST} with --chart xbar-r, and none with another chart"
        raise RefusedError(f"--subgroup is {settings.subgroup}", remedy=f"allowed: {allowed}")
    validate_operator(request.operator)
    if request.retire is not None and period is not None:
        raise RefusedError("--retire beside a new reference period", remedy="do one after the other")
    if request.retire is not None and not request.operator:
        raise RefusedError(
            "the operator who retires these charts is not named", remedy="give --operator: who retires charts is kept"
        )
    if period is not None and request.parts and not request.dry_run:
        raise RefusedError(
            "--part beside a new reference period: a stored one holds for all sensors of the station",
            remedy="give --dry-run to see limits of these sensors alone, or leave --part out",
        )
    if period is not None:
        _check_period(period, settings.subgroup)
        if not (request.operator or request.dry_run):
            remedy = "give --operator: who sets limits is kept with them (or --dry-run)"
            raise RefusedError("the operator who sets this reference is not named", remedy=remedy)


def _check_period(period: ReferencePeriod, size: int) -> None:
    """Refuse a period without exactly one end, or one that is too short or leaves runs in no group."""
    runs = period.runs
    if (runs is None) == (period.until is None):
        raise RefusedError(
            "the reference period has no end, or two", remedy="give --reference-runs N or --reference-until DATE"
        )
    if runs is not None and runs < FEWEST_RUNS:
        raise RefusedError(f"a reference period of {runs} runs is too short", remedy=f"at least {FEWEST_RUNS}")
    least = FEWEST_GROUPS * size
    if runs is not None and size > 1 and (runs < least or runs % size):
        nearest_counts = sorted({max(least, runs - runs % size), max(least, runs - runs % size + size)})
        raise RefusedError(
            f"a reference period of {runs} runs is not {FEWEST_GROUPS} or more whole groups of {size}",
            remedy=f"give {' or '.join(map(str, nearest_counts))}",
        )
