"""What proposed limits promise: its condition, how often simulated lots keep it, and what few sensors cannot do."""

from collections.abc import Collection
from typing import Final

from cbsr_qa.stats.golden_lots import Bound
from cbsr_qa.stats.intervals import one_sided_factor
from cbsr_qa.stats.lot_shapes import Distribution

# Conditions of the promise, in words that follow "holds".
_WHATEVER: Final = "whatever the distribution of sensors is"
_AS_STATED: Final = "if sensors are {distribution}, as stated"
_UP_TO_STUDENT: Final = "for tails up to those of Student's t with {freedom} degrees of freedom"
_FOR_FAMILIES: Final = "for normal, log-normal, Weibull and gamma distributions of a run's worst value, and {tails}"

#: Numbers of sensors, and the shares [%] of as large lots whose limits of several families keep the promise, by what
#: their sensors are distributed like: of 600 lots of 10 and 300 larger ones, see benchmarks/limit_promises.py.
LOT_SIZES: Final = (10, 30, 100)
KEPT_PERCENT: Final = {
    "normal": (97, 99, 98),
    "log-normal, Weibull, gamma (least)": (95, 96, 94),
    "Student's t, 5 degrees of freedom": (87, 91, 94),
    "Student's t, 3 degrees of freedom": (73, 80, 96),
    "one in ten scatters twice as much": (96, 96, 94),
}
#: Coverage and confidence of those lots.
MEASURED_FOR: Final = (0.99, 0.95)

#: Sensors from which limits hold for Student's t with 3 degrees of freedom, see benchmarks/limit_promises.py.
_SHOWS_HEAVY_TAILS: Final = 100
_FEW_SENSORS: Final = 10
_GOOD_LOT: Final = 30
_FEW: Final = (
    "{sensors} sensors are few: a limit lies {factor:.3g} deviations from the mean, with 30 it would lie {usual:.3g}"
    " (one bound, normal values). It finds gross faults only, and so few cannot show whether its condition holds."
)
#: Largest value of quantities that are shares [%].
_SHARES: Final = {"area_overlap": 100.0, "force_coverage_68": 100.0, "force_coverage_95": 100.0}


def describe_condition(bounds: Collection[Bound], sensors: int, distribution: Distribution | None) -> str:
    """Return the distributions for which the stated share and confidence hold, in words that follow "holds".

    Parameters
    ----------
    distribution : the one that was stated, if any.
    """
    if all(bound.distribution is Distribution.ANY for bound in bounds):
        return _WHATEVER
    if distribution is Distribution.HEAVY:
        return _UP_TO_STUDENT.format(freedom=3)
    if distribution is not None:
        return _AS_STATED.format(distribution=distribution)
    freedom = 3 if sensors >= _SHOWS_HEAVY_TAILS else 5
    return _FOR_FAMILIES.format(tails=_UP_TO_STUDENT.format(freedom=freedom))


def warn_of_few_sensors(sensors: int, coverage: float, confidence: float) -> str:
    """Say what limits from so few sensors cannot do; empty if they are enough."""
    if sensors >= _FEW_SENSORS:
        return ""
    factor, usual = (one_sided_factor(coverage, confidence, n, n - 1) for n in (sensors, _GOOD_LOT))
    return _FEW.format(sensors=sensors, factor=factor, usual=usual)


def exceeds_share(measurement: str, upper: float | None) -> bool:
    """Whether an upper limit is beyond what a quantity can be."""
    return upper is not None and upper >= _SHARES.get(measurement, upper + 1)
