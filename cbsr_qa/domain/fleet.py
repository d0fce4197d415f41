"""Many runs of many sensors as columns: what a comparison of batches, stations or periods is made from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.outcome import Outcome
from cbsr_qa.domain.run_figures import MetricKey


class State(IntFlag):
    """What is known of one value besides its number."""

    PLAIN = 0
    LOWER_BOUND = 1  #: the quantity is at least the value
    FAILED = 2  #: outside its limit
    UNMEASURED = 4  #: judged by a limit, and could not be measured


@dataclass(frozen=True, slots=True)
class FleetRun:
    """One run as a comparison sees it.

    Parameters
    ----------
    run : its identifier; sorted as text, runs are in the order they were made in, whatever the clock said.
    made_at : when the identifier was made; None where it does not say.
    finished : whether it ran to its end.
    outcome : of its latest analysis; None where it has none.
    software : (distribution, version) pairs it was analysed with.
    simulated : in words; empty for a real bench.
    of_check : whether it is a golden sensor's, made to check its station.
    """

    run: str
    serial: str
    batch: str
    material: str
    station: str
    recipe: str
    started_at: datetime
    made_at: datetime | None
    finished: bool
    outcome: Outcome | None
    software: tuple[tuple[str, str], ...]
    simulated: tuple[str, ...]
    of_check: bool = False


@dataclass(frozen=True, slots=True)
class Kind:
    """What values of one kind have in common.

    Parameters
    ----------
    key : of the metric, without a location: values of all loads are one metric.
    location : label of the load; empty where it is not about one.
    lower, upper : of the limit they were held against; None where there was none.
    """

    key: MetricKey
    unit: str
    location: str
    lower: float | None
    upper: float | None


@dataclass(frozen=True, slots=True, eq=False)
class FleetTable:
    """Values of runs.

    Parameters
    ----------
    runs : (R,) in the order they were made in.
    kinds : (K,) what there are values of.
    run, kind : (N,) index of each value's run and kind.
    value : (N,) in the kind's unit; NaN where there is none, as numpy marks what is missing.
    state : (N,) of :class:`State`.
    places_mm : label of a load → where it is pressed.
    """

    runs: tuple[FleetRun, ...]
    kinds: tuple[Kind, ...]
    run: NDArray[np.int32]
    kind: NDArray[np.int32]
    value: NDArray[np.float64]
    state: NDArray[np.uint8]
    places_mm: Mapping[str, tuple[float, float]] = field(default_factory=dict)
