"""What is compared, and by what rules: stated with every result."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType


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


POLICY_WORDS = MappingProxyType(
    {
        Policy.FIRST: "a sensor's first finished run decides, retests do not count",
        Policy.LAST: "a sensor's last finished run decides, so that retests count",
        Policy.ANY: "a sensor passed if any of its finished runs did; otherwise its last run decides",
    }
)
QUARANTINE_WORDS = MappingProxyType(
    {
        Quarantine.APART: "sensors that could not be measured are counted apart and not in the yield",
        Quarantine.FAILED: "sensors that could not be measured count as not passed",
    }
)


@dataclass(frozen=True, slots=True)
class Terms:
    """Rules of one comparison.

    Parameters
    ----------
    groups : names to compare, the reference first; empty for all, with the earliest period or the group with most
        sensors as reference.
    names : metrics to compare; empty for all.
    margins : name of a metric → difference that does not matter, in its unit.
    detect : name of a metric → difference whose number of sensors is asked for, in its unit.
    confidence : of every interval.
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
