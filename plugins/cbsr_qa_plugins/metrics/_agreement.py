"""What is said of two relaxations that were compared."""

from cbsr_qa.analysis.run_agreement import DirectedAgreement
from cbsr_qa.calibrate.relaxation_agreement import SHAPE_MARGIN, TIME_MARGIN, Agreement
from cbsr_qa.report.numbers import plural

_WORDS = {
    Agreement.EQUIVALENT: "equivalent within",
    Agreement.DIFFERENT: "different by more than",
    Agreement.UNDECIDED: "undecided at a margin of",
}


def said_of_shape(one: DirectedAgreement) -> str:
    """Whether the curves are equivalent, and where they differ most; or why they were not compared."""
    found = one.found
    if found.why:
        return _not_compared(one)
    said = f"{_WORDS[found.shape]} {SHAPE_MARGIN:g} of the change: at most {found.shape_reach:.2g} apart"
    return f"{said}, most at {found.at_s:.3g} s; {plural(one.loads, 'load')}"


def said_of_time(one: DirectedAgreement) -> str:
    """Whether the settling times are equivalent; or why they were not compared."""
    found = one.found
    if found.why:
        return _not_compared(one)
    if found.time_ratio is None:
        return "one of them has no settling time within its window"
    return f"{_WORDS[found.time]} {TIME_MARGIN:.0%} of the settling time; {plural(one.loads, 'load')}"


def _not_compared(one: DirectedAgreement) -> str:
    about = (
        f" (the first is of the {one.first})" if "the first" in one.found.why or "the second" in one.found.why else ""
    )
    return f"not compared: {one.found.why}{about}"
