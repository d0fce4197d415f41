"""Numerically hard cases, run and held against truth: as a document or a page."""

import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from os import cpu_count
from pathlib import Path
from typing import Any

from cbsr_qa.app.stability_page import stability_page, stability_sections
from cbsr_qa.frontier.sweep import begin_worker
from cbsr_qa.report.render import render_sections, write_report
from cbsr_qa.stability.case import CaseResult, Ending, examine
from cbsr_qa.stability.catalogue import case_named, chosen_cases


@dataclass(frozen=True, slots=True)
class Stability:
    """How hard cases came out.

    Parameters
    ----------
    results : in the order of the catalogue.
    """

    results: tuple[CaseResult, ...]

    @property
    def counts(self) -> dict[Ending, int]:
        """How many ended in which way."""
        counted = Counter(result.outcome for result in self.results)
        return {ending: counted[ending] for ending in Ending}

    @property
    def exit_code(self) -> int:
        """0, or 1 where a case is broken."""
        return 1 if self.counts[Ending.BROKEN] else 0

    def document(self) -> dict[str, Any]:
        """Return what ``--json`` prints."""
        return {"cases": [_case_document(result) for result in self.results]}

    def write(self, path: Path) -> None:
        """Write a page that stands by itself.

        Raises
        ------
        RefusedError
            If its folder cannot be written to.
        """
        write_report(path, render_sections(stability_page(self.results), stability_sections(self.results)))


def examine_cases(
    *,
    areas: Sequence[str] = (),
    names: Sequence[str] = (),
    progress: Callable[[int, int], None] = lambda done, of: None,
    processes: int | None = None,
) -> Stability:
    """Run hard cases.

    Parameters
    ----------
    areas, names : of the cases to run; all where neither is given.
    progress : told how many are done, and of how many.
    processes : how many work at once; by default two, or one where there is one core.

    Raises
    ------
    ConfigError
        If there is no such area or case.
    """
    cases = chosen_cases(areas, names)
    count = min(2, cpu_count() or 1, len(cases)) if processes is None else processes
    found: dict[str, CaseResult] = {}
    progress(0, len(cases))
    for result in _examined([case.name for case in cases], count):
        found[result.case.name] = result
        progress(len(found), len(cases))
    return Stability(tuple(found[case.name] for case in cases))


def _examined(names: Sequence[str], processes: int) -> Iterator[CaseResult]:
    """Results as they come. Processes are given names: functions of cases need not be picklable."""
    if processes < 2:
        for name in names:
            yield examine(case_named(name))
        return
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"), begin_worker) as pool:
        waiting = {pool.submit(_bare, name): name for name in names}
        try:
            for future in as_completed(waiting):
                yield replace(future.result(), case=case_named(waiting[future]))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)  # what has not begun never does
            raise


def _bare(name: str) -> CaseResult:
    """Result of a case, without what cannot leave its process."""
    result = examine(case_named(name))
    return replace(result, case=replace(result.case, run=_gone, refuses=None))


def _gone() -> Any:
    raise AssertionError("the case has been run in another process")


def _case_document(result: CaseResult) -> dict[str, Any]:
    case, answer = result.case, result.answer
    return {
        "name": case.name,
        "area": case.area,
        "hard": case.hard,
        "truth": case.truth,
        "outcome": str(result.outcome),
        "error": _number(answer.error if answer else None),
        "bound": _number(answer.bound if answer else None),
        "unit": answer.unit if answer else None,
        "condition": _number(answer.condition if answer else None),
        "reason": result.reason or None,
        "remedy": result.remedy or None,
        "note": (answer.note or None) if answer else None,
        "seconds": round(result.seconds, 3),
    }


def _number(value: float | None) -> float | None:
    """Return a number, or None where there is none: JSON knows no NaN."""
    if value is None or not abs(value) < float("inf"):
        return None
    return float(value)
