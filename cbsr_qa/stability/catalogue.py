"""All numerically hard cases, by area."""

from collections.abc import Sequence
from difflib import get_close_matches
from typing import Final

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.stability import (
    calibration_cases,
    forward_cases,
    geometry_cases,
    imaging_cases,
    load_cases,
    reading_cases,
    reconstruction_cases,
    relaxation_cases,
    smoothness_cases,
    statistics_cases,
    time_cases,
)
from cbsr_qa.stability.case import HardCase

#: Every case, in order of area.
CASES: Final[tuple[HardCase, ...]] = (
    *forward_cases.CASES,
    *reading_cases.CASES,
    *reconstruction_cases.CASES,
    *smoothness_cases.CASES,
    *imaging_cases.CASES,
    *geometry_cases.CASES,
    *relaxation_cases.CASES,
    *calibration_cases.CASES,
    *load_cases.CASES,
    *time_cases.CASES,
    *statistics_cases.CASES,
)

#: Areas, in the order they are shown in.
AREAS: Final[tuple[str, ...]] = tuple(dict.fromkeys(case.area for case in CASES))


#: Names that fit in a message.
_FEW: Final = 10


def chosen_cases(areas: Sequence[str] = (), names: Sequence[str] = ()) -> tuple[HardCase, ...]:
    """Return the cases of some areas or with some names; all where neither is given.

    Raises
    ------
    ConfigError
        If there is no such area or name.
    """
    known = [case.name for case in CASES]
    for what, asked, there in (("area", areas, list(AREAS)), ("case", names, known)):
        for one in asked:
            if one not in there:
                raise ConfigError(f"there is no {what} {one!r}", remedy=_nearest(what, one, there))
    if not areas and not names:
        return CASES
    return tuple(case for case in CASES if case.area in areas or case.name in names)


def _nearest(what: str, asked: str, there: Sequence[str]) -> str:
    """Names that may have been meant: all of a few, of many those that look alike or hold the same word."""
    if len(there) <= _FEW:
        return f"there are: {', '.join(there)}"
    near = [one for one in there if asked in one] or get_close_matches(asked, there, n=_FEW, cutoff=0.5)
    if near:
        return f"near are: {', '.join(near[:_FEW])}"
    return f"cbsr-qa stability --area {AREAS[0]!r} lists the {what}s of an area; areas are: {', '.join(AREAS)}"


def case_named(name: str) -> HardCase:
    """Return the case of a name that :func:`chosen_cases` knows."""
    return next(case for case in CASES if case.name == name)
