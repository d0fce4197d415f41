"""What a person reads of numerically hard cases: what came of each, by area, and how to read that."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Final

from cbsr_qa.domain.results import Banner, Block, Cell, CommandOutcome, Figure, Outcome, Page, Paragraph, Section
from cbsr_qa.report import number, plural, text_table, unit_shown
from cbsr_qa.studies.hard_cases.case import CaseResult, Ending
from cbsr_qa.studies.hard_cases.stability import Stability

_NONE: Final = "–"
_READING: Final = (
    "A sensor's force comes from long chains of arithmetic with numbers of sixteen digits. Some inputs cost "
    "digits: contacts a billion times too poor, a load a hundred million times the sheet's conductance, readings "
    "that lie on an offset a million times as large. This page lists such cases. Each is computed as any measurement "
    "would be, and compared with a truth found in another way: a formula, the same equations in fifty digits, or an "
    "identity that must hold exactly.",
    "The error is what the answer is off by, relative where no unit is given. The bound is what it may be off by. "
    "The condition number says how much the problem itself magnifies a last digit: no method can do better than "
    "condition × 2.2 × 10⁻¹⁶, and a bound that rests on it allows a hundred times that. Where truth is continuous "
    "and the answer comes from a mesh, the bound is of the mesh, and says so.",
    "A case may also end in a refusal: the program says what it found and what to do, and gives no number. That is "
    "right where a number would be rounding, and wrong anywhere else. A case that is out of its bound, gives no "
    "number or raises a warning is broken, and the command ends with exit code 1.",
)
_CELLS: Final = {Ending.OK: Outcome.PASS, Ending.REFUSED: Outcome.NOT_JUDGED, Ending.BROKEN: Outcome.FAIL}
_WORDS: Final = {Ending.OK: "within its bound", Ending.REFUSED: "refused", Ending.BROKEN: "BROKEN"}

# Sentences, in the order they are read.
_COUNTS: Final = "{cases}: {ok} within their bound, {refused} refused as they must be, {broken} broken"
_ENDED: Final = "{name}, {outcome}: {reason}."
_REMEDY: Final = " What to do: {remedy}."
_CONDITIONS: Final = (
    "Relative errors against what the problem's condition number makes of one rounding (hollow: exactly zero). Above "
    "the upper line digits would be lost for no reason; cases whose bound is of a mesh or of a limit may lie above "
    "it, and say so."
)
_ERRORS: Final = (
    "Error of every case with a number (dot; hollow where it is exactly zero) and the bound it may not pass (bar). A "
    "red dot is out of its bound."
)
_ALTERNATIVE: Final = "Errors of {cases}; the tables have the numbers."


def stability_outcome(found: Stability) -> CommandOutcome[Stability]:
    """Lay results out; the exit code is 1 where a case is broken."""
    broken = any(one.outcome is Ending.BROKEN for one in found.cases)
    areas = dict.fromkeys(one.area for one in found.cases)
    columns = ("case", "area", "what is hard", "compared with", "note")
    cases = text_table("Cases", columns, [(x.name, x.area, x.hard, x.truth, x.note or _NONE) for x in found.cases])
    sections = (
        Section("How to read this page", tuple(_how_to_read(found.cases)), page_only=True),
        *(Section(_headed(area), tuple(_area(area, found.cases))) for area in areas),
        Section("What is hard in each case", (cases,), page_only=True),
    )
    return CommandOutcome(found, _page(found.cases), sections, 1 if broken else 0)


def _page(cases: Sequence[CaseResult]) -> Page:
    counts = Counter(one.outcome for one in cases)
    broken = [one.name for one in cases if one.outcome is Ending.BROKEN]
    ok, refused = counts[Ending.OK], counts[Ending.REFUSED]
    reason = _COUNTS.format(cases=plural(len(cases), "case"), ok=ok, refused=refused, broken=len(broken))
    banner = Banner("pass", "✓", "No bound is broken", reason)
    if broken:
        banner = Banner("fail", "✗", f"{plural(len(broken), 'case')} broken", f"{', '.join(broken)}; {reason}")
    facts = (("Took", f"{sum(one.seconds for one in cases):.0f} s of computing"),)
    return Page("Numerical stability", "Numerically hard cases", banner, facts, (), ())


def _how_to_read(cases: Sequence[CaseResult]) -> Iterator[Block]:
    yield from map(Paragraph, _READING)
    if any(one.condition is not None for one in cases):

        def draw() -> str:
            # matplotlib is loaded only where something is drawn
            from cbsr_qa.studies.hard_cases.figures import conditions_svg

            return conditions_svg(cases)

        yield Figure(_CONDITIONS, _ALTERNATIVE.format(cases=plural(len(cases), "case")), draw)


def _area(area: str, cases: Sequence[CaseResult]) -> Iterator[Block]:
    own = [one for one in cases if one.area == area]
    drawn = [one for one in own if one.unit is not None]
    if drawn:

        def draw() -> str:
            from cbsr_qa.studies.hard_cases.figures import errors_svg

            return errors_svg(drawn)

        yield Figure(_ERRORS, _ALTERNATIVE.format(cases=plural(len(drawn), "case")), draw)
    columns = ("case", "error", "bound", "unit", "condition", "outcome")
    yield text_table(f"Cases of the area {area}", columns, [_row(one) for one in own], (1, 2, 4))
    for one in own:
        if one.outcome is not Ending.OK:
            words = _ENDED.format(name=one.name, outcome=_WORDS[one.outcome], reason=one.reason)
            words += _REMEDY.format(remedy=one.remedy) if one.remedy else ""
            yield Paragraph(words, "warning" if one.outcome is Ending.BROKEN else "plain")


def _row(one: CaseResult) -> tuple[str | Cell, ...]:
    missing = _NONE if one.unit is None else "no number"
    error, bound = (missing if value is None else number(value, 2) for value in (one.error, one.bound))
    condition = _NONE if one.condition is None else number(one.condition, 2)
    outcome = Cell(_WORDS[one.outcome], _CELLS[one.outcome])
    return one.name, error, bound, unit_shown(one.unit or "1"), condition, outcome


def _headed(area: str) -> str:
    return f"{area[0].upper()}{area[1:]}"
