"""Figures of runs: one number a run and metric, as studies over many runs take them."""

from dataclasses import dataclass
from datetime import UTC, date, datetime


@dataclass(frozen=True, slots=True, order=True)
class MetricKey:
    """What tells one metric of a run from another.

    Parameters
    ----------
    name, phase, qualifier : as of a :class:`~cbsr_qa.domain.measurement.Measurement`.
    location : of the loads the figure is of; empty for all of them together.
    """

    name: str
    phase: str = ""
    qualifier: str = ""
    location: str = ""

    @property
    def label(self) -> str:
        """Name with phase, qualifier and location, as a reader would say it."""
        detail = ", ".join(part for part in (self.phase, self.qualifier, self.location) if part)
        return f"{self.name} ({detail})" if detail else self.name


@dataclass(frozen=True, slots=True)
class RunLine:
    """A run as a point of a study.

    Parameters
    ----------
    started_at : by the station's clock, which may have been wrong: the order of runs is that of their names.
    analysis : the latest one of the run.
    """

    run: str
    serial: str
    station: str
    recipe: str
    operator: str
    started_at: datetime
    analysis: str

    @property
    def day(self) -> date:
        """The day it began on, UTC, by the same clock."""
        return self.started_at.astimezone(UTC).date()


@dataclass(frozen=True, slots=True)
class RunFigure:
    """One metric of one run: the mean over its loads.

    Parameters
    ----------
    value : None where one of the values is missing, or only a lower bound.
    places : how many values it is the mean of.
    missing, bounded : how many of them have no value, and how many are only lower bounds.
    lower, upper : the limit it was judged by; None where there was none on that side.
    units : of the run's values where they are several, sorted; there is no value then, and ``unit`` is one of them.
    """

    run: str
    key: MetricKey
    unit: str
    value: float | None
    places: int
    missing: int = 0
    bounded: int = 0
    lower: float | None = None
    upper: float | None = None
    units: tuple[str, ...] = ()

    @property
    def why(self) -> str:
        """Say why there is no value; empty where there is one."""
        if self.units:
            return f"its values are in several units within the run, {' and '.join(self.units)}"
        if self.missing:
            return f"{self.missing} of {self.places} values could not be measured"
        return f"{self.bounded} of {self.places} values are only lower bounds" if self.bounded else ""
