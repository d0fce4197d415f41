"""Control charts of a station: what their limits rest on, and which of them signal."""

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from cbsr_qa.domain.naming import of_kind
from cbsr_qa.domain.run_figures import MetricKey


class ChartKind(StrEnum):
    """What is charted of a metric's values."""

    INDIVIDUALS = "i-mr"  #: single values and their moving range
    MEANS = "xbar-r"  #: means and ranges of so many runs after each other
    EWMA = "ewma"
    CUSUM = "cusum"


@dataclass(frozen=True, slots=True)
class ChartSettings:
    """How a chart is made.

    Parameters
    ----------
    subgroup : runs a point; 1 but for means and ranges.
    rules : numbers of Nelson's tests, for individuals and means.
    weight, width : of EWMA; limits are ``width`` deviations of the average wide.
    slack, threshold : of CUSUM, in deviations.
    """

    kind: ChartKind = ChartKind.INDIVIDUALS
    subgroup: int = 1
    rules: tuple[int, ...] = (1, 2)
    weight: float = 0.2
    width: float = 3.0
    slack: float = 0.5
    threshold: float = 5.0


@dataclass(frozen=True, slots=True)
class ChartReference:
    """What a chart's limits rest on: stored once, and followed by another where it is changed.

    Parameters
    ----------
    reference : its name, time-ordered.
    golden : serial number where only runs of this sensor are charted; empty for production runs.
    mean, deviation : of single values, in ``unit``.
    runs, first_run, last_run : the reference period (phase I).
    operator, made_at, why : who set it, when by the computer's clock, and for what reason.
    retired : nothing is charted against these limits from here on; all else is what held before.
    """

    reference: str
    station: str
    recipe: str
    golden: str
    key: MetricKey
    unit: str
    settings: ChartSettings
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
    def label(self) -> str:
        """Metric and chart as a reader would say them, with the golden sensor where it is of one."""
        of = f" of golden sensor {self.golden}" if self.golden else ""
        return f"{self.key.label}{of}, chart {self.settings.kind}"


@dataclass(frozen=True, slots=True)
class StandingSignal:
    """A chart that signals.

    Parameters
    ----------
    rules : those that spoke, the earliest first.
    since_run, since : the run at which it began, and when that began by the station's clock.
    runs : how many runs there were from then on, that one included.
    at_least : it may have begun earlier than was looked back.
    began_run, began : of a cumulative sum the run after the last at which it was zero, about when the change began;
        empty and None of other charts.
    """

    reference: ChartReference
    rules: tuple[str, ...]
    since_run: str
    since: datetime
    runs: int
    at_least: bool
    began_run: str = ""
    began: datetime | None = None

    def words(self) -> str:
        """Say which chart signals since when, and by which rule."""
        when = f"{'at least ' if self.at_least else ''}{self.runs} run{'' if self.runs == 1 else 's'}"
        return (
            f"{self.reference.label}, signals since run {self.since_run} of {self.since:%Y-%m-%d} ({when}): "
            f"{'; '.join(self.rules)}{self._began_words()}"
        )

    def _began_words(self) -> str:
        if self.began is None:
            return ""
        return f"; the change began about run {self.began_run} of {self.began:%Y-%m-%d}, at which the sum left zero"


@dataclass(frozen=True, slots=True)
class StationCharts:
    """How a station's charts stood when a run ended.

    Parameters
    ----------
    charts : how many have a stored reference and were looked at.
    signals : those that signal; none where the station is in control.
    notes : what could not be charted, and doubtful clocks, in sentences.
    """

    station: str
    charts: int
    signals: tuple[StandingSignal, ...]
    notes: tuple[str, ...] = ()

    def warnings(self) -> tuple[str, ...]:
        """Return one warning a chart that signals."""
        here = of_kind("station", self.station)
        return tuple(f"{here} is out of control: {signal.words()}" for signal in self.signals)
