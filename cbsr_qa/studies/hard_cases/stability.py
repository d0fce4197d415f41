"""All numerically hard cases, by area, run and compared with truth."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from difflib import get_close_matches
from os import cpu_count
from typing import Final

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.studies.hard_cases.case import CaseResult, HardCase, examine
from cbsr_qa.studies.hard_cases.cases import all_cases
from cbsr_qa.studies.sweep import run_jobs

#: Every case, in order of area.
CASES: Final = all_cases()
#: Areas, in the order of display.
AREAS: Final[tuple[str, ...]] = tuple(dict.fromkeys(case.area for case in CASES))
#: Number of names that fit in a message.
_FEW: Final = 10


def choose_cases(areas: Sequence[str] = (), names: Sequence[str] = ()) -> tuple[HardCase, ...]:
    """Return the cases of some areas or with some names; all if neither is given. ConfigError for unknown ones."""
    for area in areas:
        if area not in AREAS:
            raise ConfigError(f"there is no area {area!r}", remedy=f"there are: {', '.join(AREAS)}")
    known_names = [case.name for case in CASES]
    for name in names:
        if name not in known_names:
            raise ConfigError(f"there is no case {name!r}", remedy=_nearest(name, known_names))
    return tuple(case for case in CASES if case.area in areas or case.name in names or not (areas or names))


def _nearest(name: str, known: Sequence[str]) -> str:
    """Suggest names of cases that contain the same word or look alike."""
    similar = [other for other in known if name in other] or get_close_matches(name, known, n=_FEW, cutoff=0.5)
    if similar:
        return f"did you mean one of: {', '.join(similar[:_FEW])}"
    return f"cbsr-qa stability --area {AREAS[0]!r} lists the cases of an area; areas are: {', '.join(AREAS)}"


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
    cases = choose_cases(areas, names)
    count = min(2, cpu_count() or 1, len(cases)) if processes is None else processes
    examined: dict[str, CaseResult] = {}
    progress(0, len(cases))
    # Processes receive names: functions of cases need not be picklable.
    with closing(run_jobs([case.name for case in cases], _examine_named, count)) as results:
        for name, result in results:
            examined[name] = result
            progress(len(examined), len(cases))
    return Stability(tuple(examined[case.name] for case in cases))


def _examine_named(name: str) -> CaseResult:
    return examine(next(case for case in CASES if case.name == name))
