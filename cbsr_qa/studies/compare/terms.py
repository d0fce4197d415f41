"""What is compared, and by what rules: stated with every result."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from math import isfinite

from cbsr_qa.domain import RefusedError


class By(StrEnum):
    """What tells groups apart."""

    BATCH = "batch"
    MATERIAL = "material"
    STATION = "station"
    SOFTWARE = "software"
    PERIOD = "period"


class Policy(StrEnum):
    """Which of a sensor's runs decides; first-pass yield always counts the first."""

    FIRST = "first"
    LAST = "last"
    ANY = "any"  #: a sensor passed if one of its runs did


class Quarantine(StrEnum):
    """What becomes, in a yield, of sensors that could not be measured."""

    APART = "apart"  #: counted apart, not in the yield
    FAILED = "failed"  #: counted as not passed


class Period(StrEnum):
    """Length of a period, by the day a run began on (UTC)."""

    DAY = "day"
    WEEK = "week"
    MONTH = "month"
    YEAR = "year"


class Adjustment(StrEnum):
    """How p values are adjusted for how many there are."""

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
    margins, detect : name of a metric → difference that does not matter, or whose number of sensors is asked for.
    power : that numbers of sensors are for.
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
    confidence: float = 0.95
    power: float = 0.8

    @property
    def level(self) -> float:
        """Of tests."""
        return 1 - self.confidence


def read_groups(text: str | None) -> tuple[str, ...]:
    """Read ``A,B``: names of groups, the reference first; none where nothing was given.

    Raises
    ------
    RefusedError
        If a name is empty, or is there twice.
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

    Raises
    ------
    RefusedError
        If one is no such pair, its value is not a positive number, or its metric was named before.
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
