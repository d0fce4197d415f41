"""From a golden lot to proposed limits: bounds, guard bands, risks, and their effect on the lot itself."""

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from math import sqrt
from typing import Final

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.numbers import did_you_mean
from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.results.fleet import MetricKey
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.stats.golden_lots import Ask, Bound, LotLimits, Runs, lot_limits, outward
from cbsr_qa.stats.guard_bands import Risks, Uncertainty, repeatability, risks
from cbsr_qa.stats.lot_shapes import Distribution
from cbsr_qa.stats.variance_components import FEWEST_REPEATS
from cbsr_qa.studies.limits.golden_lot import Lot
from cbsr_qa.studies.limits.groups import Group
from cbsr_qa.studies.limits.promise import describe_condition
from cbsr_qa.system.words import echo

_DISTRIBUTIONS: Final = {
    "auto": None,
    "normal": Distribution.NORMAL,
    "log-normal": Distribution.LOG_NORMAL,
    "heavy": Distribution.HEAVY,
    "any": Distribution.ANY,
}

# Reasons for missing guard bands or risks.
_NOTHING_LEFT: Final = "guard bands of {width:.3g} {unit} would leave nothing between the limits: measure better"
_UNSTATED: Final = "{few}, and {silent} of {values} values state no uncertainty"
_NEVER_TWICE: Final = "no sensor was run twice"
_FEW_REPEATS: Final = "{repeats} of the runs repeat a sensor, and {least} are needed"
_NO_SPREAD: Final = "repeated runs agree to the last digit, which gives no estimate of their uncertainty"
_NO_UNCERTAINTY: Final = "no uncertainty is known"
_NO_DISTRIBUTION: Final = "no distribution is known"
_ALL_UNCERTAIN: Final = "the uncertainty of a run explains all of the lot's spread"


@dataclass(frozen=True, slots=True)
class Terms:
    """Requirements on every limit.

    Parameters
    ----------
    coverage, confidence : share of good sensors within each limit by itself, and its confidence.
    guard_factor : width of the guard band over the expanded uncertainty.
    distribution : distribution of single values; None for all that the lot may come from.
    """

    coverage: float = 0.99
    confidence: float = 0.95
    guard_factor: float = 1.0
    distribution: Distribution | None = None

    @classmethod
    def from_words(
        cls, coverage_percent: float, confidence_percent: float, guard_factor: float, distribution: str
    ) -> "Terms":
        """Return terms from a user's input.

        RefusedError if a number is out of range, or the distribution does not exist.
        """
        ranges = (("coverage", coverage_percent, 99.99), ("confidence", confidence_percent, 99.9))
        for name, percent, largest_percent in ranges:
            if not 50 <= percent <= largest_percent:
                raise RefusedError(f"{name} is {percent:g} %; allowed: 50 to {largest_percent:g} %")
        if not 0 <= guard_factor <= 10:
            raise RefusedError(f"the guard factor is {guard_factor:g}; allowed: 0 to 10")
        if distribution not in _DISTRIBUTIONS:
            remedy = f"{did_you_mean(distribution, _DISTRIBUTIONS)} allowed: {', '.join(_DISTRIBUTIONS)}".lstrip()
            raise RefusedError(f"there is no distribution {echo(distribution)}", remedy=remedy)
        return cls(coverage_percent / 100, confidence_percent / 100, guard_factor, _DISTRIBUTIONS[distribution])


@dataclass(frozen=True, slots=True)
class RunUncertainty:
    """Uncertainty of one run, in the measurement's unit.

    Parameters
    ----------
    standard, coverage_factor, expanded : u, k and k u; None if there is no guard band, for the reason ``source``.
    degrees_of_freedom : None if stated rather than found from repeats.
    """

    standard: float | None
    coverage_factor: float | None
    expanded: float | None
    degrees_of_freedom: int | None
    source: str


@dataclass(frozen=True, slots=True)
class ProposedRisks:
    """Risks of all sensors, if marginal passes are accepted and if they are not."""

    marginal_accepted: Risks
    marginal_refused: Risks


@dataclass(frozen=True, slots=True)
class BareLimits:
    """Limits alone; None on a side without a limit, and on both if there are none for the reason ``why``."""

    lower: float | None
    upper: float | None
    why: str


@dataclass(frozen=True, slots=True)
class Judged:
    """A judged measurement, in its unit, of a phase and with a qualifier."""

    measurement: str
    unit: str
    phase: str
    qualifier: str

    @property
    def label(self) -> str:
        """Name with phase and qualifier, for a reader."""
        return MetricKey(self.measurement, self.phase, self.qualifier).label


@dataclass(frozen=True, slots=True)
class NoLimit(Judged):
    """A measurement without a proposed limit, the reason, and the serials far from the others."""

    why: str
    far_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ProposedLimit(Judged):
    """A proposed limit.

    Parameters
    ----------
    sensors, values : number of sensors, and of values per run.
    mean : mean of all values, with equal weight of sensors.
    marginal : width of the guard band, in ``unit``.
    bounds : basis of each side.
    condition : distributions for which the stated share and confidence hold, in words.
    positive : whether no value of the lot is zero or negative.
    risks : None if unknown for the reason ``no_risks``.
    far_out, without_far_out : serials far from the others, which remain in the lot; limits without them.
    present : current limit of the recipe.
    lot_fails_present, lot_fails, lot_marginal : serials of the lot that fail the present limit, that fail the
        proposed one, and that pass it marginally.
    """

    sensors: int
    values: int
    sides: str
    mean: float
    lower: float | None
    upper: float | None
    marginal: float
    bounds: dict[str, Bound]
    condition: str
    positive: bool
    uncertainty: RunUncertainty
    risks: ProposedRisks | None
    no_risks: str
    far_out: tuple[str, ...]
    without_far_out: BareLimits | None
    present: Limit | None
    lot_fails_present: tuple[str, ...] | None
    lot_fails: tuple[str, ...]
    lot_marginal: tuple[str, ...]

    def limit(self, version: str) -> Limit:
        ends = self.lower, self.upper, self.marginal
        return Limit(self.measurement, self.unit, *ends, self.phase, self.qualifier, version)


def propose(group: Group, lot: Lot, terms: Terms) -> ProposedLimit | NoLimit:
    """Propose a limit for one group of measurements, or give the reason for none."""
    key = group.key
    identity = key.name, group.unit, key.phase, key.qualifier
    if why := group.why_not():
        return NoLimit(*identity, why)
    present, smallest, largest = group.present, _pick_worst(group, min), _pick_worst(group, max)
    ask = Ask(
        terms.coverage,
        terms.confidence,
        lower=present is None or present.lower is not None,
        upper=present is None or present.upper is not None,
        distribution=terms.distribution,
    )
    limits = lot_limits(smallest, largest, group.values, ask)
    serials = list(group.sensors)
    far_out = tuple(serials[index] for index in limits.far_out)
    if limits.why:
        return NoLimit(*identity, limits.why, far_out)
    bounds = {side: bound for side, bound in (("lower", limits.lower), ("upper", limits.upper)) if bound is not None}
    uncertainty, width, source = _guard(group, bounds, lot, terms)
    of_run = RunUncertainty(None, None, None, None, source)
    if uncertainty is not None:
        of_run = fill_from_object(RunUncertainty, uncertainty, degrees_of_freedom=uncertainty.freedom)
    lower, upper = _read_limits(limits)
    limit = Limit(key.name, group.unit, lower, upper, width, key.phase, key.qualifier)
    found_risks, no_risks = _risks(bounds.values(), width, uncertainty)
    values_by_sensor = [[value for run in runs for value in _list_values(run)] for runs in group.sensors.values()]
    return ProposedLimit(
        *identity,
        sensors=len(group.sensors),
        values=group.values,
        sides="both, because the recipe sets no limit" if present is None else "those of the present limit",
        mean=sum(sum(values) / len(values) for values in values_by_sensor) / len(values_by_sensor),
        lower=lower,
        upper=upper,
        marginal=width,
        bounds=bounds,
        condition=describe_condition(bounds.values(), len(group.sensors), terms.distribution),
        positive=all(value > 0 for values in values_by_sensor for value in values),
        uncertainty=of_run,
        risks=found_risks,
        no_risks=no_risks,
        far_out=far_out,
        without_far_out=_refit_without(limits, smallest, largest, group.values, ask),
        present=present,
        lot_fails_present=None if present is None else _list_failing(group, present),
        lot_fails=_list_failing(group, limit),
        lot_marginal=_list_failing(group, limit, Outcome.MARGINAL),
    )


def _pick_worst(group: Group, worst: Callable[[list[float]], float]) -> Runs:
    return [[worst(_list_values(run)) for run in runs] for runs in group.sensors.values()]


def _list_values(run: Iterable[Measurement]) -> list[float]:
    return [m.value for m in run if m.value is not None]


def _read_limits(limits: LotLimits) -> tuple[float | None, float | None]:
    lower, upper = (None if bound is None else bound.limit for bound in (limits.lower, limits.upper))
    return lower, upper


def _refit_without(limits: LotLimits, smallest: Runs, largest: Runs, values: int, ask: Ask) -> BareLimits | None:
    if not limits.far_out:
        return None
    kept_indices = [index for index in range(len(largest)) if index not in limits.far_out]
    other = lot_limits(
        [smallest[index] for index in kept_indices], [largest[index] for index in kept_indices], values, ask
    )
    return BareLimits(*_read_limits(other), other.why)


def _guard(group: Group, bounds: dict[str, Bound], lot: Lot, terms: Terms) -> tuple[Uncertainty | None, float, str]:
    """Return the uncertainty of one run and the guard band, with their source or the reason for none."""
    uncertainty, source = _uncertainty(group, bounds, lot)
    if uncertainty is None:
        return None, 0.0, source
    width = terms.guard_factor * uncertainty.expanded
    if len(bounds) > 1 and 2 * width >= bounds["upper"].limit - bounds["lower"].limit:
        return None, 0.0, _NOTHING_LEFT.format(width=width, unit=group.unit)
    return uncertainty, outward(width, 0.0, +1) if width else 0.0, source


def _uncertainty(group: Group, bounds: Iterable[str], lot: Lot) -> tuple[Uncertainty | None, str]:
    """Find the uncertainty of one run: from repeated runs, else as stated by the measurements."""
    picks = [min if side == "lower" else max for side in bounds]
    repeats = sum(len(runs) - 1 for runs in group.sensors.values())
    at_several_stations = any(len({run.line.station for run in runs}) > 1 for runs in lot.analysed.values())
    over_stations = f", at stations {', '.join(lot.stations)}" if at_several_stations else ""
    source = f"repeatability of {repeats} repeated runs{over_stations}"
    repeated = [repeatability(_pick_worst(group, pick), source) for pick in picks]
    known = [u for u in repeated if u is not None]
    if known:
        return max(known, key=lambda u: u.standard), source
    runs = [run for runs in group.sensors.values() for run in runs]
    stated_uncertainties = [pick(run, key=lambda m: m.value or 0.0).uncertainty for pick in picks for run in runs]
    known_uncertainties = [u for u in stated_uncertainties if u]
    if len(known_uncertainties) == len(stated_uncertainties):
        source = "stated by the measurements"
        return Uncertainty(
            sqrt(sum(u * u for u in known_uncertainties) / len(known_uncertainties)), None, source
        ), source
    few_words = _NEVER_TWICE if not repeats else _NO_SPREAD
    if 0 < repeats < FEWEST_REPEATS:
        few_words = _FEW_REPEATS.format(repeats=repeats, least=FEWEST_REPEATS)
    stated = [bool(measurement.uncertainty) for run in runs for measurement in run]
    return None, _UNSTATED.format(few=few_words, silent=stated.count(False), values=len(stated))


def _risks(
    bounds: Collection[Bound], width: float, uncertainty: Uncertainty | None
) -> tuple[ProposedRisks | None, str]:
    """Return the risks, or the reason for none."""
    if uncertainty is None:
        return None, _NO_UNCERTAINTY
    sums = [Risks(0.0, 0.0), Risks(0.0, 0.0)]
    for bound in bounds:
        for place, guard in enumerate((0.0, width)):
            bound_risks = risks(bound, guard, uncertainty)
            if bound_risks is None:
                is_ordered = any(bound.distribution is Distribution.ANY for bound in bounds)
                return None, _NO_DISTRIBUTION if is_ordered else _ALL_UNCERTAIN
            sums[place] += bound_risks
    return ProposedRisks(*sums), ""


def _list_failing(group: Group, limit: Limit, outcome: Outcome = Outcome.FAIL) -> tuple[str, ...]:
    """Name the sensors with this worst outcome over all their runs."""
    failing_sensors = []
    for serial, runs in group.sensors.items():
        outcomes = {limit.judge(m.value, m.bound) for run in runs for m in run}
        if outcome in outcomes and (outcome is Outcome.FAIL or Outcome.FAIL not in outcomes):
            failing_sensors.append(serial)
    return tuple(failing_sensors)
