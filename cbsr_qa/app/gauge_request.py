"""What a gauge study is asked for: by options, or by a study's file, whose lines refusals then name."""

from dataclasses import dataclass
from datetime import date

from cbsr_qa.app.gauge_references import ReferenceValue
from cbsr_qa.config.echo import echo
from cbsr_qa.config.lines import line_of
from cbsr_qa.config.tables import dotted
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.run_figures import MetricKey, RunLine

#: What may be an appraiser.
APPRAISERS = ("station", "operator")


@dataclass(frozen=True, slots=True)
class StudySource:
    """The file a study was read from.

    Parameters
    ----------
    name : what the study calls itself.
    file : its path as it was given.
    sha256 : of the file's text.
    text : to find lines in.
    """

    name: str
    file: str
    sha256: str
    text: str


@dataclass(frozen=True, slots=True)
class MetricWanted:
    """One metric of a study.

    Parameters
    ----------
    phase : empty for any.
    qualifier : exactly this one; None for any.
    unit : the metric must be in; empty where no number here is in it.
    lower, upper, tolerance : limits, or their width alone; all None for those of the recipe.
    """

    name: str
    phase: str = ""
    qualifier: str | None = None
    unit: str = ""
    lower: float | None = None
    upper: float | None = None
    tolerance: float | None = None

    def means(self, key: MetricKey) -> bool:
        """Whether a figure is of this metric."""
        fits = self.phase in ("", key.phase) and self.qualifier in (None, key.qualifier)
        return self.name == key.name and fits

    @property
    def width(self) -> float | None:
        """The tolerance that is stated here; None where the recipe's is taken."""
        if self.lower is not None and self.upper is not None:
            return self.upper - self.lower
        return self.tolerance


@dataclass(frozen=True, slots=True)
class GaugeRequest:
    """What a study is of.

    Parameters
    ----------
    serials, recipe : which runs; at least one of them.
    stations, operators : only their runs; none for any.
    since, until : first and last day the runs began on, UTC.
    metrics : none for those the recipe limits.
    by_location : one study a location instead of one of the mean over all.
    appraiser : ``"station"`` or ``"operator"``.
    largest_balanced : of a crossing that is not whole, take the largest part that is.
    references : what golden sensors truly are.
    source : the file this was read from; None for options.
    """

    serials: tuple[str, ...] = ()
    recipe: str | None = None
    stations: tuple[str, ...] = ()
    operators: tuple[str, ...] = ()
    since: date | None = None
    until: date | None = None
    metrics: tuple[MetricWanted, ...] = ()
    by_location: bool = False
    appraiser: str = "station"
    largest_balanced: bool = False
    references: tuple[ReferenceValue, ...] = ()
    confidence: float = 0.95
    source: StudySource | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the metrics, each once."""
        return tuple(dict.fromkeys(one.name for one in self.metrics))

    def at(self, *path: str | int) -> str:
        """Where a refusal is about a key of the study's file, its line and the key; empty for options."""
        if self.source is None:
            return ""
        line = line_of(self.source.text, path)
        return f"{self.source.file}{f' line {line}' if line else ''}: {dotted(path)}: "

    def takes(self, line: RunLine) -> bool:
        """Whether a run is of the period, the stations and the operators."""
        in_period = (self.since is None or line.day >= self.since) and (self.until is None or line.day <= self.until)
        at_station = not self.stations or line.station in self.stations
        return in_period and at_station and (not self.operators or line.operator in self.operators)

    def check(self) -> None:
        """Refuse what cannot be meant, before anything is read.

        Raises
        ------
        RefusedError
            If nothing says which runs, the appraiser or the confidence is none, or the period ends before it begins.
        """
        if self.appraiser not in APPRAISERS:
            raise RefusedError(f"--appraiser is {echo(self.appraiser)}", remedy=f"allowed: {', '.join(APPRAISERS)}")
        if not 0.5 < self.confidence < 1:
            raise RefusedError(
                f"a confidence of {100 * self.confidence:g} % is none",
                remedy="allowed: above 50 and below 100 %; give per cent, 95 for 95 %",
            )
        if not self.serials and self.recipe is None:
            raise RefusedError(
                "no study is named", remedy="name a study's file, or choose runs by --serials S1,S2,… or --recipe R"
            )
        if self.since and self.until and self.since > self.until:
            raise RefusedError(
                f"no day is after {self.since} and before {self.until}", remedy="swap --since and --until"
            )
