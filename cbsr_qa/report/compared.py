"""Printed numbers and ours as words."""

from cbsr_qa.domain.published import Ours, Printed
from cbsr_qa.report.numbers import number, with_uncertainty


def printed_text(printed: Printed) -> str:
    """Write what is printed, as it is printed: ``18.1 ± 9.8``, ``0.6``, or both ranges."""
    if printed.ranges:
        return " / ".join(f"{low:g}–{high:g}" for _, low, high in printed.ranges)
    if printed.value is None:
        return "–"
    if printed.deviation is None:
        return f"{printed.value:g}"
    decimals = max(len(f"{one:g}".partition(".")[2]) for one in (printed.value, printed.deviation))
    return f"{printed.value:.{decimals or 1}f} ± {printed.deviation:.{decimals or 1}f}"


def ours_text(ours: Ours) -> str:
    """Write our number with its uncertainty; ``–`` where there is none, ``≥`` before a lower bound."""
    if ours.value is None:
        return "–"
    sign = "≥ " if ours.at_least else ""
    spread = ours.uncertainty
    if spread is None:
        return f"{sign}{number(ours.value)}"
    if spread < 5e-4 * abs(ours.value):  # more digits than the printed number has would say nothing
        return f"{sign}{number(ours.value, 4)}"
    return f"{sign}{with_uncertainty(ours.value, spread)}"


def agreement_sign(agrees: bool | None) -> str:
    """Write whether two numbers agree."""
    return {True: "yes", False: "no", None: "–"}[agrees]
