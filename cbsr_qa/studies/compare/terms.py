"""Subject and rules of a comparison, stated with every result."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from math import isfinite

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import did_you_mean
from cbsr_qa.stats.fitted_capability import BEST
from cbsr_qa.stats.fitted_families import FAMILIES


class By(StrEnum):
    """Basis of the groups."""

    BATCH = "batch"
    MATERIAL = "material"
    STATION = "station"
    SOFTWARE = "software"
    PERIOD = "period"


class Policy(StrEnum):
    """Choice of a sensor's deciding run; first-pass yield always counts the first."""

    FIRST = "first"
    LAST = "last"
    ANY = "any"  #: a sensor passed if one of its runs did


class Quarantine(StrEnum):
    """Treatment, in a yield, of sensors that could not be measured."""

    APART = "apart"  #: counted separately, not in the yield
    FAILED = "failed"  #: counted as not passed


class Period(StrEnum):
    """Length of a period, by the day a run began on (UTC)."""

    DAY = "day"
    WEEK = "week"
    MONTH = "month"
    YEAR = "year"


class Adjustment(StrEnum):
    """Adjustment of p values for multiple tests."""

    HOLM = "holm"
    BENJAMINI_HOCHBERG = "benjamini-hochberg"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class Terms:
    """Rules of one comparison.

    Parameters
    ----------
    groups : names to compare, the reference first; empty for all, the earliest period or the largest group first.
    names : metrics to compare; empty for all.
    margins, detect : name of a metric → difference that does not matter, or for which the number of sensors is
        computed.
    distributions : name of a metric → family that is fitted for its capability; "" for all others.
    power : power for which numbers of sensors are computed.
    """

    by: By
    groups: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    policy: Policy = Policy.LAST
    quarantine: Quarantine = Quarantine.APART
    period: Period = Period.MONTH
    adjustment: Adjustment = Adjustment.HOLM
    margins: Mapping[str, float] = field(default_factory=dict)
    detect: Mapping[str, float] = field(default_factory=dict)
    distributions: Mapping[str, str] = field(default_factory=dict)
    confidence: float = 0.95
    power: float = 0.8

    @property
    def level(self) -> float:
        """Significance level of tests."""
        return 1 - self.confidence

    def distribution_of(self, metric: str) -> str | None:
        """Return the name of the family to fit to a metric; None for none."""
        return self.distributions.get(metric, self.distributions.get(""))


def read_groups(text: str | None) -> tuple[str, ...]:
    """Read ``A,B``: names of groups, the reference first; empty for empty text.

    RefusedError if a name is empty or repeated.
    """
    if text is None:
        return ()
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise RefusedError(
            f"--groups {text[:80]!r} has an empty name",
            remedy="separate names by commas, for example --groups 41,42, or leave it out for all groups",
        )
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise RefusedError(f"--groups names {twice[0][:64]!r} twice", remedy="name each group once")
    return names


def read_amounts(pairs: Sequence[str], option: str) -> dict[str, float]:
    """Read ``METRIC=VALUE`` pairs.

    RefusedError if an entry is not such a pair, its value is not a positive number, or its metric is repeated.
    """
    amounts: dict[str, float] = {}
    for pair in pairs:
        name, _, text = pair.rpartition("=")
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not (name and isfinite(value) and value > 0):
            raise RefusedError(
                f"{option} {pair[:80]!r} is not METRIC=VALUE with a positive number",
                remedy=f"for example {option} centre_of_mass_error=0.5, in the metric's unit",
            )
        if name in amounts:
            raise RefusedError(f"{option} states {name[:64]!r} twice", remedy="state one value of each metric")
        amounts[name] = value
    return amounts


def read_distributions(names: Sequence[str]) -> dict[str, str]:
    """Read ``NAME`` for all metrics, or ``METRIC=NAME`` for one; the key of the former is empty.

    RefusedError if a name is not known, or a metric is repeated.
    """
    families: dict[str, str] = {}
    allowed = [BEST, *FAMILIES]
    for entry in names:
        metric, _, family = entry.rpartition("=")
        if family not in allowed:
            nearest = did_you_mean(family, allowed)
            raise RefusedError(
                f"--distribution {entry[:80]!r} is not known",
                remedy=f"{nearest} allowed: {', '.join(allowed)}, for one metric METRIC=NAME".lstrip(),
            )
        if metric in families:
            of = f"states {metric[:64]!r}" if metric else "is stated for all metrics"
            raise RefusedError(f"--distribution {of} twice", remedy="name one distribution for each metric")
        families[metric] = family
    return families
