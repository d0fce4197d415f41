"""All numerically hard cases, by area, run and compared with truth."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from difflib import get_close_matches
from os import cpu_count
from typing import Final

from cbsr_qa.domain import ConfigError
from cbsr_qa.studies.hard_cases.case import CaseResult, HardCase, examine
from cbsr_qa.studies.hard_cases.cases import (
    calibration,
    forward,
    forward_exact,
    forward_loads,
    geometry,
    imaging,
    loads,
    readings,
    reconstruction,
    relaxation,
    smoothness,
    statistics,
    time,
)
from cbsr_qa.studies.sweep import finished

_AREAS: Final = (
    forward.AREA, forward_exact.AREA, forward_loads.AREA, readings.AREA, reconstruction.AREA, smoothness.AREA,
    imaging.AREA, geometry.AREA, relaxation.AREA, calibration.AREA, loads.AREA, time.AREA, statistics.AREA,
)  # fmt: skip
#: Every case, in order of area.
CASES: Final[tuple[HardCase, ...]] = tuple(case for area in _AREAS for case in area.cases)

#: Areas, in the order of display.
AREAS: Final[tuple[str, ...]] = tuple(dict.fromkeys(case.area for case in CASES))
#: Number of names that fit in a message.
_FEW: Final = 10


def chosen_cases(areas: Sequence[str] = (), names: Sequence[str] = ()) -> tuple[HardCase, ...]:
    """Return the cases of some areas or with some names; all if neither is given. ConfigError for unknown ones."""
    for what, wanted, known in (("area", areas, AREAS), ("case", names, [case.name for case in CASES])):
        for name in wanted:
            if name not in known:
                raise ConfigError(f"there is no {what} {name!r}", remedy=_nearest(what, name, known))
    if not areas and not names:
        return CASES
    return tuple(case for case in CASES if case.area in areas or case.name in names)


def _nearest(what: str, name: str, known: Sequence[str]) -> str:
    """Suggest names: all of a few; of many, those that look alike or contain the same word."""
    if len(known) <= _FEW:
        return f"there are: {', '.join(known)}"
    near = [other for other in known if name in other] or get_close_matches(name, known, n=_FEW, cutoff=0.5)
    if near:
        return f"did you mean one of: {', '.join(near[:_FEW])}"
    return f"cbsr-qa stability --area {AREAS[0]!r} lists the {what}s of an area; areas are: {', '.join(AREAS)}"


@dataclass(frozen=True, slots=True)
class Stability:
    """Results of hard cases, in the order of the catalogue."""

    cases: tuple[CaseResult, ...]


def examine_cases(
    *,
    areas: Sequence[str] = (),
    names: Sequence[str] = (),
    progress: Callable[[int, int], None] = lambda done, of: None,
    processes: int | None = None,
) -> Stability:
    """Run the cases of some areas or names; all if neither is given.

    Parameters
    ----------
    progress : called with the numbers of cases done and in total.
    processes : number in parallel; by default two, or one on a single core.

    Raises
    ------
    ConfigError
        If an area or case does not exist.
    """
    cases = chosen_cases(areas, names)
    count = min(2, cpu_count() or 1, len(cases)) if processes is None else processes
    examined: dict[str, CaseResult] = {}
    progress(0, len(cases))
    # Processes receive names: functions of cases need not be picklable.
    with closing(finished([case.name for case in cases], _examine_named, count)) as results:
        for name, result in results:
            examined[name] = result
            progress(len(examined), len(cases))
    return Stability(tuple(examined[case.name] for case in cases))


def _examine_named(name: str) -> CaseResult:
    return examine(next(case for case in CASES if case.name == name))
