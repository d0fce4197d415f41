"""Report of numerically hard cases: the result of each, by area, and how to read it."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Final

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.report import Banner, Block, Cell, CommandOutcome, Figure, Page, Paragraph, Section
from cbsr_qa.report.tables import number, plural, text_table, unit_shown
from cbsr_qa.studies.hard_cases.case import CaseResult, Ending
from cbsr_qa.studies.hard_cases.stability import Stability

_NONE: Final = "–"
_READING: Final = (
    "A sensor's force is computed in many steps with sixteen digits. Some inputs cost digits: contacts a billion "
    "times too poor, a load of a hundred million times the sheet's conductance, readings on an offset a million "
    "times as large. This page lists such cases. Each is computed like any measurement, and compared with a truth "
    "found in another way: a formula, the same equations in fifty digits, or an identity that must hold exactly.",
    "Errors and bounds are relative unless a unit is given. The condition number states how much the problem itself "
    "magnifies an error in the last digit: no method can do better than condition × 2.2 × 10⁻¹⁶, and a bound "
    "derived from it allows a hundred times that. If the truth is continuous and the answer comes from a mesh, the "
    "bound is the mesh's, and says so.",
    "A case may also be refused: the program says what it found and what to do, and gives no number. That is right "
    "only where the number would be rounding error. A case beyond its bound, without a number or with a warning is "
    "broken, and the command ends with exit code 1.",
)
_CELLS: Final = {Ending.OK: Outcome.PASS, Ending.REFUSED: Outcome.NOT_JUDGED, Ending.BROKEN: Outcome.FAIL}
_WORDS: Final = {Ending.OK: "within its bound", Ending.REFUSED: "refused", Ending.BROKEN: "BROKEN"}

# Sentences, in reading order.
_COUNTS: Final = "{cases}: {ok} within their bound, {refused} refused as they should be, {broken} broken"
_ENDED: Final = "{name}, {outcome}: {reason}."
_REMEDY: Final = " What to do: {remedy}."
_CONDITIONS: Final = (
    "Relative error against condition number × one rounding error (hollow: exactly zero). Above "
    "the upper line digits would be lost for no reason; cases whose bound is of a mesh or of a limit may lie above "
    "it, and say so."
)
_ERRORS: Final = (
    "Error of every case (dot; hollow if exactly zero) and its bound (bar). A red dot is beyond its bound."
)
_ALTERNATIVE: Final = "Errors of {cases}; the tables have the numbers."


def stability_outcome(stability: Stability) -> CommandOutcome[Stability]:
    """Lay results out; the exit code is 1 if a case is broken."""
    cases = stability.cases
    areas = dict.fromkeys(case.area for case in cases)
    columns = ("case", "area", "what is hard", "compared with", "note")
    rows = [(case.name, case.area, case.hard, case.truth, case.note or _NONE) for case in cases]
    reading: list[Block] = [Paragraph(text) for text in _READING]
    if any(case.condition is not None for case in cases):
        reading.append(_figure(_CONDITIONS, cases, "conditions_svg"))
    sections = (
        Section("How to read this page", tuple(reading), page_only=True),
        *(Section(area.capitalize(), tuple(_area(area, cases))) for area in areas),
        Section("What is hard in each case", (text_table("Cases", columns, rows),), page_only=True),
    )
    broken = any(case.outcome is Ending.BROKEN for case in cases)
    return CommandOutcome(stability, _page(cases), sections, 1 if broken else 0)


def _page(cases: Sequence[CaseResult]) -> Page:
    counts = Counter(case.outcome for case in cases)
    broken = [case.name for case in cases if case.outcome is Ending.BROKEN]
    ok, refused = counts[Ending.OK], counts[Ending.REFUSED]
    reason = _COUNTS.format(cases=plural(len(cases), "case"), ok=ok, refused=refused, broken=len(broken))
    banner = Banner("pass", "✓", "No bound is broken", reason)
    if broken:
        banner = Banner("fail", "✗", f"{plural(len(broken), 'case')} broken", f"{', '.join(broken)}; {reason}")
    facts = (("Took", f"{sum(case.seconds for case in cases):.0f} s of computing"),)
    return Page("Numerical stability", "Numerically hard cases", banner, facts, (), ())


def _figure(caption: str, cases: Sequence[CaseResult], plot: str) -> Figure:
    def draw() -> str:
        from cbsr_qa.studies.hard_cases import figures  # loads matplotlib

        svg: str = getattr(figures, plot)(cases)
        return svg

    return Figure(caption, _ALTERNATIVE.format(cases=plural(len(cases), "case")), draw)


def _area(area: str, cases: Sequence[CaseResult]) -> Iterator[Block]:
    area_cases = [case for case in cases if case.area == area]
    answered = [case for case in area_cases if case.unit is not None]
    if answered:
        yield _figure(_ERRORS, answered, "errors_svg")
    columns = ("case", "error", "bound", "unit", "condition", "outcome")
    yield text_table(f"{area.capitalize()}: cases", columns, [_row(case) for case in area_cases], (1, 2, 4))
    for case in area_cases:
        if case.outcome is not Ending.OK:
            text = _ENDED.format(name=case.name, outcome=_WORDS[case.outcome], reason=case.reason)
            text += _REMEDY.format(remedy=case.remedy) if case.remedy else ""
            yield Paragraph(text, "warning" if case.outcome is Ending.BROKEN else "plain")


def _row(case: CaseResult) -> tuple[str | Cell, ...]:
    missing = _NONE if case.unit is None else "no number"
    error, bound = (missing if value is None else number(value, 2) for value in (case.error, case.bound))
    condition = _NONE if case.condition is None else number(case.condition, 2)
    outcome = Cell(_WORDS[case.outcome], _CELLS[case.outcome])
    return case.name, error, bound, unit_shown(case.unit or "1"), condition, outcome
