"""Proposed limits as a file that a recipe takes in by ``limits_from``, or that is pasted into one.

From a golden lot to proposed limits: bounds, guard bands, risks, and what they would do to the lot itself.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from math import sqrt
from pathlib import Path
from typing import Any, Final

from cbsr_qa.config import echo, limits_digest, one_line, toml_value
from cbsr_qa.domain import RefusedError
from cbsr_qa.domain.results import Limit, Measurement, Outcome
from cbsr_qa.stats import (
    FEWEST_REPEATS,
    Ask,
    Bound,
    Distribution,
    LotLimits,
    Risks,
    Runs,
    Uncertainty,
    lot_limits,
    outward,
    repeatability,
    risks,
)
from cbsr_qa.studies.limits.golden_lot import Lot
from cbsr_qa.studies.limits.groups import Group
from cbsr_qa.system import written_whole

RULE: Final = (
    "a value beyond a limit fails; one inside by less than the guard band passes marginally, because its uncertainty"
    " reaches beyond the limit; any other passes (JCGM 106:2012, 8.3.2)"
)

_DISTRIBUTIONS: Final = {
    "auto": None,
    "normal": Distribution.NORMAL,
    "log-normal": Distribution.LOG_NORMAL,
    "any": Distribution.ANY,
}


@dataclass(frozen=True, slots=True)
class Terms:
    """What is asked of every limit.

    Parameters
    ----------
    coverage, confidence : share of good sensors that each limit holds by itself, and how sure that is to be.
    guard_factor : width of the guard band over the expanded uncertainty.
    distribution : of single values; None for the widest limit of those the lot does not refute.
    """

    coverage: float = 0.99
    confidence: float = 0.95
    guard_factor: float = 1.0
    distribution: Distribution | None = None

    @classmethod
    def of_words(
        cls, coverage_percent: float, confidence_percent: float, guard_factor: float, distribution: str
    ) -> "Terms":
        """Return the terms somebody typed.

        Raises
        ------
        RefusedError
            If a number is out of range, or there is no such distribution.
        """
        ranges = (("coverage", coverage_percent, 99.99), ("confidence", confidence_percent, 99.9))
        for name, percent, most in ranges:
            if not 50 <= percent <= most:
                raise RefusedError(f"{name} is {percent:g} %; allowed: 50 to {most:g} %")
        if not 0 <= guard_factor <= 10:
            raise RefusedError(f"the guard factor is {guard_factor:g}; allowed: 0 to 10")
        if distribution not in _DISTRIBUTIONS:
            near = get_close_matches(distribution, _DISTRIBUTIONS, n=1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise RefusedError(
                f"there is no distribution {echo(distribution)}", remedy=f"{hint}allowed: {', '.join(_DISTRIBUTIONS)}"
            )
        return cls(coverage_percent / 100, confidence_percent / 100, guard_factor, _DISTRIBUTIONS[distribution])


@dataclass(frozen=True, slots=True)
class Proposal:
    """What is proposed for one measurement, or why nothing is.

    Parameters
    ----------
    found : bounds, distribution, sensors far from the others.
    mean : of all values, every sensor alike; None where there are none.
    far_out : serials that lie far from the others; they are in the lot all the same.
    without_far_out : what the bounds would be without them; None where none lies far out.
    limit : as a recipe would hold it; None where none is proposed.
    uncertainty : of one run; None where ``no_guard`` says why there is no guard band.
    risks : of all sensors, where marginal passes are accepted and where they are not; None where ``no_risks`` says
        why nobody can tell.
    failed_now, failed, marginal : serials of the lot that fail the present limit, that fail the proposed one, and
        that pass it marginally.
    """

    group: Group
    found: LotLimits
    mean: float | None = None
    far_out: tuple[str, ...] = ()
    without_far_out: LotLimits | None = None
    limit: Limit | None = None
    uncertainty: Uncertainty | None = None
    no_guard: str = ""
    risks: tuple[Risks, Risks] | None = None
    no_risks: str = ""
    failed_now: tuple[str, ...] = ()
    failed: tuple[str, ...] = ()
    marginal: tuple[str, ...] = ()

    @property
    def bounds(self) -> tuple[Bound, ...]:
        """The proposed bounds, lower first."""
        return tuple(bound for bound in (self.found.lower, self.found.upper) if bound is not None)

    @property
    def always_positive(self) -> bool:
        """Whether no value of the lot is zero or negative."""
        return all(
            m.value is None or m.value > 0 for runs in self.group.sensors.values() for run in runs for m in run
        )


def propose(group: Group, lot: Lot, terms: Terms, version: str) -> Proposal:
    """Propose a limit for what one limit judges.

    Parameters
    ----------
    version : name of the limits' version.

    Returns
    -------
    A proposal, or the reason why there is none in its ``found.why``.
    """
    if why := group.why_not():
        return Proposal(group, LotLimits(why=why), failed_now=_failing(group, group.present))
    smallest, largest = _worst(group, min), _worst(group, max)
    ask = _ask(group, terms)
    found = lot_limits(smallest, largest, group.values, ask)
    serials = list(group.sensors)
    far_out = tuple(serials[index] for index in found.far_out)
    proposal = Proposal(
        group,
        found,
        mean=_mean(group),
        far_out=far_out,
        without_far_out=_without(found, smallest, largest, group.values, ask),
        failed_now=_failing(group, group.present),
    )
    return proposal if found.why else _guarded(proposal, lot, terms, version)


def _ask(group: Group, terms: Terms) -> Ask:
    """Bound the sides that are bounded now; both where nobody has said which matters."""
    present = group.present
    return Ask(
        terms.coverage,
        terms.confidence,
        lower=present is None or present.lower is not None,
        upper=present is None or present.upper is not None,
        distribution=terms.distribution,
    )


def _worst(group: Group, worst: Callable[[list[float]], float]) -> Runs:
    return [[worst(_values(run)) for run in runs] for runs in group.sensors.values()]


def _values(run: Iterable[Measurement]) -> list[float]:
    return [m.value for m in run if m.value is not None]


def _mean(group: Group) -> float:
    sensors = [[value for run in runs for value in _values(run)] for runs in group.sensors.values()]
    return sum(sum(values) / len(values) for values in sensors) / len(sensors)


def _without(found: LotLimits, smallest: Runs, largest: Runs, values: int, ask: Ask) -> LotLimits | None:
    if not found.far_out:
        return None
    kept = [index for index in range(len(largest)) if index not in found.far_out]
    return lot_limits([smallest[index] for index in kept], [largest[index] for index in kept], values, ask)


def _guarded(proposal: Proposal, lot: Lot, terms: Terms, version: str) -> Proposal:
    """Add guard band, limit, risks, and what the limit does to the lot."""
    group, found = proposal.group, proposal.found
    uncertainty, why = _uncertainty(proposal, lot)
    width = 0.0 if uncertainty is None else terms.guard_factor * uncertainty.expanded
    lower = None if found.lower is None else found.lower.limit
    upper = None if found.upper is None else found.upper.limit
    if lower is not None and upper is not None and 2 * width >= upper - lower:
        why = f"guard bands of {width:.3g} {group.unit} would leave nothing between the limits: measure better"
        uncertainty, width = None, 0.0
    width = outward(width, 0.0, +1) if width else 0.0
    limit = Limit(group.name, group.unit, lower, upper, width, group.phase, group.qualifier, version)
    found_risks = None if uncertainty is None else _risks(proposal.bounds, width, uncertainty)
    return replace(
        proposal,
        limit=limit,
        uncertainty=uncertainty,
        no_guard=why,
        risks=found_risks,
        no_risks=_why_no_risks(proposal.bounds, uncertainty) if found_risks is None else "",
        failed=_failing(group, limit),
        marginal=_failing(group, limit, Outcome.MARGINAL),
    )


def _uncertainty(proposal: Proposal, lot: Lot) -> tuple[Uncertainty | None, str]:
    """Find how well one run measures: from repeated runs, else from what the measurements state of themselves."""
    group, found = proposal.group, proposal.found
    sides = [_worst(group, pick) for pick, bound in ((min, found.lower), (max, found.upper)) if bound is not None]
    repeats = sum(len(runs) - 1 for runs in group.sensors.values())
    source = f"repeatability of {repeats} repeated runs{_over_stations(lot)}"
    repeated = [u for u in (repeatability(runs, source) for runs in sides) if u is not None]
    if repeated:
        return max(repeated, key=lambda u: u.standard), ""
    stated = [
        pick(run, key=lambda m: m.value or 0.0).uncertainty
        for pick, bound in ((min, found.lower), (max, found.upper))
        for runs in group.sensors.values()
        for run in runs
        if bound is not None
    ]
    known = [u for u in stated if u]
    if len(known) == len(stated):
        return Uncertainty(sqrt(sum(u * u for u in known) / len(known)), None, "stated by the measurements"), ""
    few = _too_few(repeats)
    return None, f"{few}, and {len(stated) - len(known)} of {len(stated)} values state no uncertainty"


def _too_few(repeats: int) -> str:
    if not repeats:
        return "no sensor was run twice"
    if repeats < FEWEST_REPEATS:
        return f"{repeats} of the runs repeat a sensor, and {FEWEST_REPEATS} are needed"
    return "repeated runs agree to the last digit, which is no measure of their uncertainty"


def _over_stations(lot: Lot) -> str:
    moved = any(len({run.summary.station for run in runs}) > 1 for runs in lot.sensors.values())
    return f", at stations {', '.join(lot.stations())}" if moved else ""


def _risks(bounds: Sequence[Bound], width: float, uncertainty: Uncertainty) -> tuple[Risks, Risks] | None:
    """Return the risks where marginal passes are accepted and where they are not, of all bounds together."""
    sums = []
    for guard in (0.0, width):
        each = [risks(bound, guard, uncertainty) for bound in bounds]
        total = Risks(0.0, 0.0)
        for one in each:
            if one is None:
                return None
            total += one
        sums.append(total)
    return sums[0], sums[1]


def _why_no_risks(bounds: Sequence[Bound], uncertainty: Uncertainty | None) -> str:
    if uncertainty is None:
        return "no uncertainty is known"
    if any(bound.distribution is Distribution.ANY for bound in bounds):
        return "no distribution is known"
    return "the uncertainty of a run explains all of the lot's spread"


def _failing(group: Group, limit: Limit | None, outcome: Outcome = Outcome.FAIL) -> tuple[str, ...]:
    """Name the sensors whose worst outcome over all their runs is this one."""
    if limit is None:
        return ()
    found = []
    for serial, runs in group.sensors.items():
        outcomes = {limit.judge(m.value, m.bound) for run in runs for m in run}
        if outcome in outcomes and (outcome is Outcome.FAIL or Outcome.FAIL not in outcomes):
            found.append(serial)
    return tuple(found)


def limit_table(limit: Limit) -> dict[str, Any]:
    """Return a limit as a recipe's table; what it does not have is left out."""
    table = {
        "measurement": limit.measurement,
        "unit": limit.unit,
        "lower": limit.lower,
        "upper": limit.upper,
        "marginal": limit.marginal or None,
        "phase": limit.phase or None,
        "qualifier": limit.qualifier or None,
        "version": limit.version or None,
    }
    return {key: value for key, value in table.items() if value is not None}


def limits_toml(header: Mapping[str, Any], limits: Sequence[Limit], remarks: Iterable[str]) -> str:
    """Write a file of limits.

    Parameters
    ----------
    header : keys of ``[limits_version]``; the limits' own digest is added.
    remarks : comments at the top, one a line.
    """
    tables = [limit_table(limit) for limit in limits]
    sealed = {**header, "limits_sha256": limits_digest(tables)}
    lines = [f"# {one_line(remark)}" for remark in remarks]
    lines += ["", "[limits_version]", *_keys(sealed)]
    for table in tables:
        lines += ["", "[[limits]]", *_keys(table)]
    return "\n".join(lines) + "\n"


def write_new(path: Path, text: str) -> None:
    """Write a file that is not there yet, whole or not at all.

    Raises
    ------
    RefusedError
        If it exists, or its folder cannot be written to.
    """
    refuse_existing(path)
    try:
        with written_whole(path) as file:
            file.write(text.encode())
    except OSError as error:
        raise RefusedError(f"{path} cannot be written: {error.strerror or error}") from error


def refuse_existing(path: Path) -> None:
    """Refuse to write over a file: limits that runs were judged by stay as they were."""
    try:
        there = path.exists()
    except OSError as error:
        raise RefusedError(f"{path} cannot be written: {error.strerror or error}") from error
    if there:
        raise RefusedError(f"{path} exists already", remedy="name another file: versions of limits are kept")


def _keys(table: Mapping[str, Any]) -> Iterator[str]:
    for key, value in table.items():
        yield f"{key} = {toml_value(value)}"
