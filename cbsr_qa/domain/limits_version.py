"""Which version of its limits a recipe judges by, and where they come from."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LimitsVersion:
    """A named version of limits.

    Parameters
    ----------
    version : its name; every limit that belongs to it carries it.
    date : ISO date it was made on.
    lot : in words, the golden lot it was proposed from; empty for limits that somebody set.
    coverage_percent, confidence_percent : share of good sensors each limit holds, and how sure that is; None where
        nobody stated it.
    rule : in words, how a value is judged against limit and guard band; empty where nobody stated it.
    data_sha256 : of the measurements of the lot; empty where there is none.
    sealed : whether the limits were checked to be those that were proposed.
    """

    version: str
    date: str
    lot: str = ""
    coverage_percent: float | None = None
    confidence_percent: float | None = None
    rule: str = ""
    data_sha256: str = ""
    sealed: bool = False
