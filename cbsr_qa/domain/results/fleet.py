"""Runs of studies, and their values: which runs are meant, one line a run, and every value as columns."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.limits import Outcome, name_limit
from cbsr_qa.domain.results.measurement import metric_words
from cbsr_qa.domain.run.run import run_named
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import SensorPart

#: Ways to calibrate, see :class:`CalibrationWay`.
FIXED, ADAPTIVE, UNCALIBRATED = "fixed places", "adaptive", "no calibration"


@dataclass(frozen=True, slots=True, order=True)
class MetricKey:
    """Identity of a metric within a run.

    Parameters
    ----------
    name, phase, qualifier : name, phase and qualifier as in a
        :class:`~cbsr_qa.domain.results.measurement.Measurement`.
    location : location of the loads the figure is of; empty for all of them together.
    """

    name: str
    phase: str = ""
    qualifier: str = ""
    location: str = ""

    @property
    def label(self) -> str:
        """Name with phase, qualifier and location, as recipes and JSON write it."""
        return name_limit(self.name, self.phase, self.qualifier, self.location)

    @property
    def title(self) -> str:
        return name_limit(metric_words(self.name), self.phase, self.qualifier, self.location)


@dataclass(frozen=True, slots=True)
class RunSelection:
    """Which stored runs are meant; all given criteria must hold.

    Parameters
    ----------
    serials, stations, operators : names; none for any.
    recipe, batch : a name; None for any.
    since, until : first and last day a run began on, UTC.
    from_moment, before_moment : bounds of the start of a run, the first included and the second not; None for no
        bound.
    checks : False leaves out runs of golden sensors that checked a station.
    after, up_to : runs whose identifiers sort after the one and not after the other; empty for no bound.
    latest : largest number of runs, the latest; None for all.
    parts : parts of the sensor, all of them; a revision may be left empty.

    Raises
    ------
    RefusedError
        If the last day is before the first.
    """

    serials: tuple[str, ...] = ()
    recipe: str | None = None
    batch: str | None = None
    stations: tuple[str, ...] = ()
    operators: tuple[str, ...] = ()
    since: date | None = None
    until: date | None = None
    checks: bool = True
    after: str = ""
    up_to: str = ""
    latest: int | None = None
    from_moment: datetime | None = None
    before_moment: datetime | None = None
    parts: tuple[SensorPart, ...] = ()

    def __post_init__(self) -> None:
        if self.since and self.until and self.since > self.until:
            raise RefusedError(
                f"no day is after {self.since} and before {self.until}", remedy="swap --since and --until"
            )


@dataclass(frozen=True, slots=True, order=True)
class CalibrationWay:
    """How the calibration of a run was made, whatever its recipe is called.

    Parameters
    ----------
    places : ``"fixed places"``, ``"adaptive"`` (each was chosen after the one before it), or ``"no calibration"``.
    batch_model : digest of the batch's model that was its prior; empty without one.
    unlike : whether the sensor was not like its batch, so that its map is that of its own loads.
    """

    places: str
    batch_model: str = ""
    unlike: bool = False

    @property
    def words(self) -> str:
        """The way in words, with the first characters of the model's digest."""
        if not self.batch_model:
            return self.places
        unlike = ", which the sensor is not like" if self.unlike else ""
        return f"{self.places} with batch model {self.batch_model[:12]} as prior{unlike}"


@dataclass(frozen=True, slots=True)
class KnownNames:
    """Names that some runs have, each once."""

    recipes: frozenset[str]
    batches: frozenset[str]
    serials: frozenset[str]
    stations: frozenset[str]
    operators: frozenset[str]
    parts: frozenset[SensorPart]


@dataclass(frozen=True, slots=True)
class RunLine:
    """One run in a study: its identity and its outcome.

    Parameters
    ----------
    run : its identifier; sorted as text, runs are in the order they were made in, whatever the clock said.
    started_at : start by the station's clock, which may have been wrong.
    made_at : time when the identifier was made; None if it has none.
    end : RUNNING if it was interrupted or is in progress.
    outcome, reason, software : outcome, reason and software of its latest analysis after its last session; None and
        empty where it has none. Software as (distribution, version) pairs.
    simulated : simulated parts in words; empty for a real bench.
    of_check : whether the run is a golden sensor's, made to check its station.
    overridden_to : outcome of the latest override of that analysis; None without one.
    altered : description of what does not match the chain; the run has no outcome then. Empty where nothing does.
    way : how its calibration was made; None where nobody asked.
    """

    run: str
    serial: str
    batch: str
    material: str
    station: str
    recipe: str
    started_at: datetime
    made_at: datetime | None
    end: EndReason
    outcome: Outcome | None
    software: tuple[tuple[str, str], ...]
    simulated: tuple[str, ...]
    of_check: bool = False
    operator: str = ""
    reason: str = ""
    overridden_to: Outcome | None = None
    altered: str = ""
    way: CalibrationWay | None = None
    parts: tuple[SensorPart, ...] = ()

    @property
    def verdict(self) -> Outcome | None:
        """What counts: the outcome, or what it was overridden to; None without an analysis."""
        return self.outcome if self.overridden_to is None else self.overridden_to

    @property
    def finished(self) -> bool:
        return self.end is EndReason.FINISHED

    @property
    def day(self) -> date:
        """Start day, UTC, by the station's clock."""
        return self.started_at.astimezone(UTC).date()

    @property
    def words(self) -> str:
        """The run as people name it: see :func:`~cbsr_qa.domain.run.run.run_named`."""
        return run_named(self.serial, self.started_at, self.run)


@dataclass(frozen=True, slots=True)
class RunFigure:
    """One metric of one run: the mean over its loads.

    Parameters
    ----------
    value : None where one of the values is missing, or only a lower bound.
    places : number of values it is the mean of.
    missing, bounded : numbers of them that have no value, and that are only lower bounds.
    lower, upper : bounds of its limit; None for a side without one.
    units : units of the run's values where they are several, sorted; there is no value then, and ``unit`` is one of
        them.
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
        """Reason for a missing value; empty if there is a value."""
        if self.units:
            return f"its values are in several units within the run, {' and '.join(self.units)}"
        if self.missing:
            return f"{self.missing} of {self.places} values could not be measured"
        return f"{self.bounded} of {self.places} values are only lower bounds" if self.bounded else ""


class State(IntFlag):
    """State of one value besides its number."""

    PLAIN = 0
    LOWER_BOUND = 1  #: the quantity is at least the value
    FAILED = 2  #: outside its limit
    UNMEASURED = 4  #: judged by a limit, and could not be measured


@dataclass(frozen=True, slots=True)
class ValueKind:
    """Common attributes of values of one kind.

    Parameters
    ----------
    key : key of the metric, without a location: values of all loads are one metric.
    location : label of the load; empty if not about one.
    lower, upper : bounds of their limit; None if there was none.
    """

    key: MetricKey
    unit: str
    location: str
    lower: float | None
    upper: float | None


@dataclass(frozen=True, slots=True, eq=False)
class FleetTable:
    """Values of many runs.

    Parameters
    ----------
    runs : (R,) runs in the order they were made in.
    kinds : (K,) what there are values of.
    run, kind : (N,) index of each value's run and kind.
    value : (N,) values in the kind's unit; NaN for missing values, as in numpy.
    state : (N,) states of :class:`State`.
    places_mm : label of a load → where it is pressed.
    """

    runs: tuple[RunLine, ...]
    kinds: tuple[ValueKind, ...]
    run: NDArray[np.int32]
    kind: NDArray[np.int32]
    value: Array
    state: NDArray[np.uint8]
    places_mm: Mapping[str, tuple[float, float]] = field(default_factory=dict)
