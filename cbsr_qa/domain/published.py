"""A publication's numbers beside ours: what is compared, by which rule, and why they differ."""

from dataclasses import dataclass
from enum import StrEnum


class Rule(StrEnum):
    """When a number of ours agrees with a printed one."""

    DEVIATION = "within one printed deviation"
    DIGITS = "within the printed digits and two of our standard deviations"
    RANGE = "inside a printed range, give or take our standard error"
    BAND = "in the same band"
    SCATTER = "deviations within two of their standard errors"
    NONE = "not compared"


class Kind(StrEnum):
    """Where a number of ours comes from."""

    INPUT = "input"  #: the simulation is given it, and measures it back
    OUTCOME = "outcome"  #: it follows from the simulation


@dataclass(frozen=True, slots=True)
class Printed:
    """What a publication prints of one quantity.

    Parameters
    ----------
    value : None where only ranges are printed.
    deviation : printed behind ±; None where nothing is.
    half_digit : half a unit of the last printed digit.
    ranges : (where it is printed, lowest, highest).
    """

    value: float | None = None
    deviation: float | None = None
    half_digit: float = 0.0
    ranges: tuple[tuple[str, float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Ours:
    """The same quantity of a simulated sensor.

    Parameters
    ----------
    sheet : ``"uniform"``, ``"bench"`` or ``"strip"``.
    value : None where it could not be told; ``of`` then says why.
    uncertainty : what ``of`` says.
    count : how many values it is of.
    at_least : the value is a lower bound.
    """

    sheet: str
    value: float | None
    uncertainty: float | None = None
    of: str = ""
    count: int = 0
    at_least: bool = False


@dataclass(frozen=True, slots=True)
class Comparison:
    """One printed number beside ours.

    Parameters
    ----------
    group : rows of one group stand together, e.g. ``"8 wt%"``.
    name, unit : of the quantity.
    kind : whether our number is an input of the simulation or follows from it.
    ours : the one that is held against the paper's.
    beside : further ones, shown only.
    agrees : None where it is not compared, or could not be told.
    bands : names of the bands of the printed number and of ours, where there are such.
    reason : why they differ, or what to know where they do not.
    """

    group: str
    name: str
    unit: str
    kind: Kind
    rule: Rule
    printed: Printed
    ours: Ours
    beside: tuple[Ours, ...] = ()
    agrees: bool | None = None
    bands: tuple[str, str] = ("", "")
    reason: str = ""


@dataclass(frozen=True, slots=True)
class ComparedTable:
    """All rows of one printed table or figure.

    Parameters
    ----------
    key : ``"table1"`` … ``"table5"``, ``"tableF6"``, ``"settling"``, ``"force"``.
    title : says that ours is a simulation.
    notes : misprints and contradictions, and what holds for all rows.
    """

    key: str
    title: str
    rows: tuple[Comparison, ...]
    notes: tuple[str, ...] = ()

    @property
    def counts(self) -> tuple[int, int]:
        """How many rows agree, of how many that are compared."""
        judged = [row.agrees for row in self.rows if row.agrees is not None]
        return sum(judged), len(judged)
