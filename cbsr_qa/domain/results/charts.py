"""Control charts of a station: their settings, references and standing signals."""

from dataclasses import dataclass, fields
from datetime import datetime
from enum import StrEnum

from cbsr_qa.domain.numbers import prefix_kind
from cbsr_qa.domain.results.fleet import MetricKey


class ChartKind(StrEnum):
    """Kind of control chart."""

    INDIVIDUALS = "i-mr"  #: single values and their moving range
    MEANS = "xbar-r"  #: means and ranges of so many runs after each other
    EWMA = "ewma"
    CUSUM = "cusum"


@dataclass(frozen=True, slots=True)
class ChartSettings:
    """Settings of a chart.

    Parameters
    ----------
    subgroup : runs a point; 1 but for means and ranges.
    rules : numbers of Nelson's tests, for individuals and means.
    weight, width : weight and width of EWMA; limits are ``width`` deviations of the average wide.
    slack, threshold : slack and threshold of CUSUM, in deviations.
    """

    chart: ChartKind = ChartKind.INDIVIDUALS
    subgroup: int = 1
    rules: tuple[int, ...] = (1, 2)
    weight: float = 0.2
    width: float = 3.0
    slack: float = 0.5
    threshold: float = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartReference(ChartSettings):
    """Reference of a chart's limits: stored once, superseded by a new one.

    Parameters
    ----------
    golden : serial number where only runs of this sensor are charted; None for production runs.
    name, phase, qualifier, location : name, phase, qualifier and location of the metric.
    mean, deviation : mean and deviation of single values, in ``unit``.
    runs, first_run, last_run : the reference period (phase I).
    operator, made_at, why : person who set it, time by the computer's clock, and reason.
    retired : whether nothing is charted against these limits from here on; all other fields hold as before.
    """

    reference: str
    station: str
    recipe: str
    golden: str | None
    name: str
    phase: str = ""
    qualifier: str = ""
    location: str = ""
    unit: str
    mean: float
    deviation: float
    runs: int
    first_run: str
    last_run: str
    operator: str
    made_at: datetime
    why: str
    retired: bool = False

    @property
    def key(self) -> MetricKey:
        return MetricKey(self.name, self.phase, self.qualifier, self.location)

    @property
    def settings(self) -> ChartSettings:
        return ChartSettings(**{field.name: getattr(self, field.name) for field in fields(ChartSettings)})

    @property
    def label(self) -> str:
        """Metric and chart for people, with the golden sensor if there is one."""
        golden_words = f" of golden sensor {self.golden}" if self.golden else ""
        return f"{self.key.title}{golden_words}, chart {self.chart}"


@dataclass(frozen=True, slots=True)
class StandingSignal:
    """A chart that signals.

    Parameters
    ----------
    rules : those that spoke, the earliest first.
    since_run, since_serial, since : the run at which it began, its sensor, and when by the station's clock.
    runs : number of runs from then on, that one included.
    at_least : whether it may have begun earlier than was looked back.
    began_run, began_serial, began : identifier, sensor and start of the run after the last at which a cumulative sum
        was zero, about when the change began; None of other charts.
    """

    label: str
    rules: tuple[str, ...]
    since_run: str
    since_serial: str
    since: datetime
    runs: int
    at_least: bool
    began_run: str | None = None
    began_serial: str | None = None
    began: datetime | None = None

    def words(self) -> str:
        """Describe which chart signals, since when, and by which rule."""
        return f"{self.label}, {self.describe_since()}"

    def describe_since(self) -> str:
        """Say since when the chart signals, and by which rule."""
        at_least, plural_s = "at least " if self.at_least else "", "" if self.runs == 1 else "s"
        rules = "; ".join(f"rule {rule}" if rule[0].isdigit() else rule for rule in self.rules)
        began = "" if self.began is None else f"; the change began at about {_run(self.began_serial, self.began)}"
        since = _run(self.since_serial, self.since)
        return f"signals since {since} ({at_least}{self.runs} run{plural_s}), {rules}{began}"


def _run(serial: str | None, begun: datetime) -> str:
    return f"the run of {prefix_kind('sensor', serial or '')} on {begun.astimezone():%Y-%m-%d %H:%M %Z}"


@dataclass(frozen=True, slots=True)
class StationCharts:
    """State of a station's charts at the end of a run.

    Parameters
    ----------
    charts : number of charts that have a stored reference and were looked at.
    notes : notes on what could not be charted, and on doubtful clocks, in sentences.
    """

    station: str
    charts: int
    signals: tuple[StandingSignal, ...]
    notes: tuple[str, ...] = ()

    def warnings(self) -> tuple[str, ...]:
        """Return one warning per signalling chart."""
        station_words = prefix_kind("station", self.station)
        return tuple(f"{station_words} is out of control: {signal.words()}" for signal in self.signals)
