"""Sentences of a calibration certificate, the same on its page and in its XML."""

from collections import Counter
from collections.abc import Iterator
from itertools import chain
from math import ceil, floor, isfinite, log10
from typing import Final

from cbsr_qa.domain.plan.standards import IN_USE_YEARS, StandardRole, find_standard
from cbsr_qa.domain.results.certificate import NOT_STATED, Certificate, Replacement
from cbsr_qa.domain.results.expanded_force import GAIN_DRIFT, MonteCarlo, list_missing
from cbsr_qa.report.tables import plural

#: Sentences of page and XML that are the same in every certificate.
ITEM: Final = "Soft pressure sensor, read by electrical impedance tomography"
PROCEDURE: Final = (
    "A flat head presses the sheet at known places. Its force is measured by a load cell and its readings by the"
    " electronics of the station; from these loads the calibration is learned that turns readings into force. Other"
    " loads, which it was not learned from, check it."
)
ABOUT_UNCERTAINTIES: Final = (
    "U = k·u for a coverage probability of about 95 % (JCGM 100:2008); k is of Student's distribution with the"
    " effective degrees of freedom ν."
)
ABOUT_ERRORS: Final = (
    "Error: force indicated by the last frame of the hold, minus reference force. U is that of the error"
)
SCOPE: Final = (
    "The results relate only to the item named above, as it was when it was calibrated. The customer's name and"
    " address are as the customer stated them. This certificate may be reproduced only in full, unless the laboratory"
    " agrees in writing."
)
#: Most reductions of the range that are written out.
_MOST_REDUCED: Final = 5
#: Most lines of deviations that are written out, and characters of a line: more do not fit on the page.
_MOST_LINES: Final = 8
_LINE: Final = 120
#: Where sensors are calibrated, for people.
_PERFORMED: Final = {
    "laboratory": "at the laboratory",
    "laboratoryBranch": "at a branch of the laboratory",
    "customer": "at the customer's",
    "customerBranch": "at a branch of the customer's",
    "other": "elsewhere",
}
_OUTCOMES: Final = {
    "pass": "conforms",
    "conditionalPass": "within the limit by less than U (not decided)",
    "conditionalFail": "beyond the limit by less than U (not decided)",
    "fail": "does not conform",
    "": "",
}
#: What a specific risk supposes: where errors are known to be small, more loads conform than it says.
_KNOWING: Final = "by the inputs that are stated, with nothing known before"


def format_value(value: float, digits: int) -> str:
    """Return a number with some significant digits, without an exponent."""
    if value == 0 or not isfinite(value):
        return "0" if value == 0 else "∞"
    return f"{value:.{max(digits - 1 - floor(log10(abs(value))), 0)}f}"


def describe_place(certificate: Certificate) -> str:
    """Return where the sensor was calibrated."""
    settings = certificate.settings
    return f"{settings.place}, {_PERFORMED[settings.performed_at]}"


def describe_validity(certificate: Certificate) -> str:
    """Return the last day of validity; whether the customer agreed to it (ISO/IEC 17025, 7.8.4.3) is not known."""
    return NOT_STATED if certificate.valid_until is None else f"valid until {certificate.valid_until}"


def describe_replaced(replaced: Replacement) -> str:
    """Return which certificate this one replaces, what became of it before, and why (ISO/IEC 17025, 7.8.8.3)."""
    before = f"was {replaced.revoked}" if replaced.revoked else "is no longer valid"
    return (
        f"This certificate replaces certificate {replaced.number}, which {before}. Reason of the replacement:"
        f" {replaced.why}"
    )


def describe_signature(fingerprint: str) -> str:
    """Return who signed the file of page or XML."""
    if not fingerprint:
        return "This file is not signed electronically."
    return (
        f"This file is signed electronically (Ed25519) beside it, by the key {fingerprint}; cbsr-qa certificate"
        " verify checks it."
    )


def describe_results(certificate: Certificate) -> str:
    """Return of which loads the results are."""
    least_N, most_N = certificate.range_N
    return (
        f"For one frame of one load of the head ({certificate.head}) at a known place,"
        f" {format_value(certificate.forces[0].settling_s, 3)} s after the press, from {least_N:.3g} N to"
        f" {most_N:.3g} N within {certificate.radius_mm:.3g} mm of the sheet's centre."
    )


def state_conformity(certificate: Certificate) -> str:
    """Return the statement of conformity in words (ISO/IEC 17025:2017, 7.8.6.2), or the reason why none is made."""
    loads = certificate.checked
    if not certificate.settings.judges:
        return "No statement of conformity is made: no maximum permissible error was stated."
    if not certificate.is_judged:
        return (
            "No statement of conformity is made: the certificate of the load cell is not stated, so that U does not"
            " include its error."
        )
    if not loads:
        return (
            "No statement of conformity is made: the run has no load within the range that the calibration was not"
            " learned from."
        )
    risks = [1 - load.conformance for load in loads if load.outcome == "pass" and load.conformance is not None]
    kept = [load.conformance for load in loads if load.outcome == "fail" and load.conformance is not None]
    accepted = f" Largest specific risk of false acceptance {_KNOWING}: {_percent(max(risks))}." if risks else ""
    rejected = f" Largest specific risk of false rejection {_KNOWING}: {_percent(max(kept))}." if kept else ""
    counts = {word: sum(load.outcome == word for load in loads) for word in _OUTCOMES if word}
    several = {"pass": "conform", "fail": "do not conform"}
    verdict = {
        "pass": "The indicated force conforms with the maximum permissible error",
        "conditionalPass": "Conformity with the maximum permissible error is not decided",
        "conditionalFail": "Conformity with the maximum permissible error is not decided",
        "fail": "The indicated force does not conform with the maximum permissible error",
    }[certificate.outcome]
    told = ", ".join(
        f"{count} {several.get(word, _OUTCOMES[word]) if count > 1 else _OUTCOMES[word]}"
        for word, count in counts.items()
        if count
    )
    return f"{verdict}: of {len(loads)} checked loads, {told}.{accepted}{rejected}"


def _percent(share: float) -> str:
    return "below 0.01 %" if share < 1e-4 else f"{100 * share:.2g} %"


def describe_rule(certificate: Certificate) -> str:
    """Return requirement and decision rule in words (JCGM 106, 8); empty without a requirement."""
    settings = certificate.settings
    if not certificate.is_judged:
        return ""
    parts = [f"{settings.max_error_N:g} N"] if settings.max_error_N else []
    parts += [f"{settings.max_error_percent:g} % of the force"] if settings.max_error_percent else []
    requirement = f"Maximum permissible error T = {' + '.join(parts)}."
    if settings.decision == "simple":
        return f"{requirement} Simple acceptance (JCGM 106:2012, 8.2): |error| ≤ T conforms; w = 0."
    return (
        f"{requirement} Guarded acceptance and rejection with the guard band w = U (JCGM 106:2012, 8.3):"
        " |error| ≤ T − U conforms, |error| > T + U does not conform, between them nothing is decided."
    )


def is_traceable(certificate: Certificate) -> bool:
    """Whether forces are traceable to the SI: measured, by a load cell whose certificate is stated."""
    measured = not certificate.identity.simulated
    return measured and find_standard(certificate.standards, StandardRole.LOAD_CELL) is not None


def describe_traceability(certificate: Certificate) -> str:
    """Return what forces are traceable to: no more than what was stated."""
    if certificate.identity.simulated:
        return "The calibration was simulated: no traceability to the SI is claimed."
    if not is_traceable(certificate):
        return "The load cell is not stated: no traceability of force to the SI is claimed."
    return (
        "Forces are traceable to the SI through the certificate of the load cell; for standards that are not stated,"
        " no traceability is claimed."
    )


def list_remarks(certificate: Certificate) -> list[str]:
    """Return the remarks; the first says what was simulated."""
    simulated = "; ".join(certificate.identity.simulated)
    remarks = [f"Simulated: {simulated}." if simulated else "Nothing was simulated."]
    remarks += _compare_with_random_numbers(certificate)
    remarks += _list_deviations(certificate)
    reduced = certificate.reduced
    remarks += [f"{reason[:1].upper()}{reason[1:]}." for reason in reduced[:_MOST_REDUCED]]
    if len(reduced) > _MOST_REDUCED:
        remarks.append(f"{len(reduced) - _MOST_REDUCED} more limitations stand in the calibration file.")
    remarks.append("The sensor was not adjusted: the calibration file converts its readings to forces.")
    return remarks


def _list_deviations(certificate: Certificate) -> Iterator[str]:
    """Yield the deviations that fit on the page, whole, and how many more there are."""
    room, more = _MOST_LINES, 0
    for warning in certificate.deviations:
        text = "".join(letter if letter.isprintable() else " " for letter in warning)  # as a plugin wrote it
        lines = ceil(len(text) / _LINE)
        if lines > room:
            more += 1
            continue
        room -= lines
        yield f"{text[:1].upper()}{text[1:]}."
    if more:
        yield f"Further deviations and warnings, which the report of the run lists: {more}."


def describe_day(certificate: Certificate) -> str:
    """Return what U is of; on the day, what temperature did is in the scatter of loads, measured or not."""
    unknown = "" if certificate.temperature_C else ", which was not measured"
    return f"U is that of the day of calibration, at its temperature{unknown}."


def describe_use(certificate: Certificate) -> str:
    """Return what U in use has beyond that of the day of calibration, and until when it holds."""
    names = {component.name for force in certificate.forces_in_use for component in force.components}
    parts = [f"a drift of the readings' gains over {IN_USE_YEARS:g} year"] if GAIN_DRIFT in names else []
    parts += ["the temperatures named above"] if "temperature" in names else []
    with_more = f"with {' and '.join(parts)}" if parts else "of which no further input is stated"
    if GAIN_DRIFT in list_missing(certificate.forces_in_use):
        return f"U in use is that of a later force, {with_more}; until when is unknown: no drift of gains is stated."
    until = "" if certificate.valid_until is None else f", until {certificate.valid_until}"
    return f"U in use is that of a later force{until}, {with_more}."


def describe_checked(certificate: Certificate) -> str:
    """Return how many held-out loads are checked, and what became of the others, in words."""
    left_out = certificate.left_out
    held_out = len(certificate.checked) + len(left_out)
    parts = [f"{len(certificate.checked)} of {held_out} held-out loads are checked"]
    outside = [load for load in left_out if not load.why]
    errors = {load: load.error_N for load in outside if load.error_N is not None}
    if outside:
        lie = "lie" if len(outside) > 1 else "lies"
        parts.append(f"{len(outside)} {lie} outside the range, which ends at loads that calibrated or agreed")
    if errors:
        worst = max(errors, key=lambda load: abs(errors[load]))
        at = f"at {worst.reference_N:.3g} N, {name_place(worst.place_mm)} mm"
        parts[-1] += f": largest error {errors[worst]:+.3g} N {at}".replace("-", "−")
    if silent := len(outside) - len(errors):
        parts.append(f"of {silent} of these the calibration tells no force")
    for why, count in Counter(load.why for load in left_out if load.why).items():
        parts.append(f"of {count} there is no error: {why}")
    return f"{'; '.join(parts)}."


def _compare_with_random_numbers(certificate: Certificate) -> Iterator[str]:
    """Yield how far intervals by random numbers exceed k u, and why the law of propagation may not do."""
    checked = (load.expanded for load in certificate.checked)
    forces = chain(certificate.forces, certificate.forces_in_use, checked)
    compared: list[tuple[float, MonteCarlo]] = [
        (force.budget.expanded, force.monte_carlo) for force in forces if force.monte_carlo is not None
    ]
    if compared:
        counts = Counter(simulated.why for _, simulated in compared)
        reasons = "; where ".join(f"{why} ({plural(count, 'value')} of U)" for why, count in counts.items())
        widest = max(simulated.half_width / expanded_N for expanded_N, simulated in compared)
        outcome = (
            f"where half of their 95 % interval exceeds k u, it is U (at most {widest:.2f} k u), and k is U/u"
            if widest > 1
            else "nowhere does half of their 95 % interval exceed k u"
        )
        yield f"The law of propagation was compared with random numbers (JCGM 101:2008) where {reasons}: {outcome}."


def name_place(place_mm: tuple[float, float]) -> str:
    """Return a place from the centre of the sheet [mm], e.g. ``(−12.5, 3.0)``."""
    x_mm, y_mm = place_mm
    return f"({x_mm:z.1f}, {y_mm:z.1f})".replace("-", "−")
