"""The page of a calibration certificate: two sides of A4 in one self-contained HTML file."""

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import chain, groupby
from math import floor, inf, isfinite, log10
from typing import Final

from jinja2 import Template
from markupsafe import Markup

from cbsr_qa.domain.plan.standards import StandardRole, find_standard
from cbsr_qa.domain.results.certificate import NOT_MEASURED, NOT_STATED, Certificate, CheckedLoad, Replacement
from cbsr_qa.domain.results.expanded_force import (
    GAIN_DRIFT,
    IN_USE_YEARS,
    ExpandedForce,
    MonteCarlo,
    list_missing,
)
from cbsr_qa.report.render import make_environment, read_style

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
ABOUT_THE_DAY: Final = "U is that of the day of calibration."
ABOUT_ERRORS: Final = (
    "Error: force indicated by the last frame of the hold, minus reference force. U is that of the error"
)
SCOPE: Final = (
    "The results relate only to the item named above, as it was when it was calibrated. The customer's name and"
    " address are as the customer stated them. This certificate may be reproduced only in full, unless the laboratory"
    " agrees in writing."
)
#: Most checked loads in the table: more do not fit on the page. Those nearest to their limit are shown.
_MOST_LOADS: Final = 8
#: Most reductions of the range that are written out.
_MOST_REDUCED: Final = 5
#: Characters of the texts of any length on the first side, above which its letters are smaller.
_MOST_TEXT: Final = 900
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
#: The same in the table of loads.
_DECISIONS: Final = {
    "pass": "conforms",
    "conditionalPass": "within T by < U",
    "conditionalFail": "beyond T by < U",
    "fail": "does not conform",
    "": "",
}
#: What a specific risk supposes: where errors are known to be small, more loads conform than it says.
_KNOWING: Final = "by the inputs that are stated, with nothing known before"
#: Degrees of freedom above which k is that of infinitely many, within 0.003.
_MANY: Final = 999


def render_certificate(certificate: Certificate, fingerprint: str) -> str:
    """Render a certificate: the same content gives the same bytes, all text escaped.

    Parameters
    ----------
    fingerprint : of the key that signs the file beside it; empty if it is not signed.
    """
    return _read_template().render(
        c=certificate,
        style=_read_style(),
        not_stated=NOT_STATED,
        not_measured=NOT_MEASURED,
        item=ITEM,
        place=describe_place(certificate),
        replaced="" if certificate.replaced is None else describe_replaced(certificate.replaced),
        validity=describe_validity(certificate),
        procedure=PROCEDURE,
        traceability=describe_traceability(certificate),
        about_results=describe_results(certificate),
        about_uncertainties=ABOUT_UNCERTAINTIES,
        about_the_day=ABOUT_THE_DAY,
        about_errors=ABOUT_ERRORS,
        scope=SCOPE,
        signature=describe_signature(fingerprint),
        standards=list(_standards(certificate)),
        dense=_count_long_texts(certificate) > _MOST_TEXT,
        forces_N=[format_value(force.force_N, 3) for force in _row(certificate.forces)],
        places=list(_places(certificate)),
        in_use=describe_use(certificate),
        missing=list_missing(certificate.forces),
        missing_in_use=list_missing(certificate.forces_in_use),
        missing_of_errors=list_missing([load.expanded for load in certificate.checked]),
        checked=describe_checked(certificate),
        loads=[_load(load) for load in choose_loads(certificate.checked)],
        statement=state_conformity(certificate),
        rule=describe_rule(certificate),
        remarks=list_remarks(certificate),
    )


@cache  # compiling it takes a tenth of a certificate of a batch
def _read_template() -> Template:
    return make_environment().get_template("certificate.html.j2")


@cache
def _read_style() -> Markup:
    return Markup(read_style("certificate.css"))


def format_value(value: float, digits: int) -> str:
    """Return a number with some significant digits, without an exponent."""
    if value == 0 or not isfinite(value):
        return "0" if value == 0 else "∞"
    return f"{value:.{max(digits - 1 - floor(log10(abs(value))), 0)}f}"


def format_with_uncertainty(value: float, expanded: float) -> tuple[str, str]:
    """Return a value and U: U with two significant digits, the value to the same decimal (JCGM 100, 7.2.6)."""
    decimals = max(1 - floor(log10(expanded)), 0)
    return f"{value:.{decimals}f}".replace("-", "−"), f"{expanded:.{decimals}f}"


def format_dof(dof: float) -> str:
    """Return degrees of freedom, truncated as k is (JCGM 100, G.6.4)."""
    if dof == inf:
        return "∞"
    return f">{_MANY}" if dof > _MANY else str(floor(dof))


def choose_loads(checked: Sequence[CheckedLoad]) -> list[CheckedLoad]:
    """Return the loads that are listed: all, or those nearest to their limit, else of the largest errors."""
    nearest = sorted(checked, key=lambda load: (load.max_error_N or 0.0) - abs(load.error_N))[:_MOST_LOADS]
    return [load for load in checked if load in nearest]


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
    plain = {"pass": "conform", "fail": "do not conform"} if len(loads) > 1 else {}
    verdict = {
        "pass": "The indicated force conforms with the maximum permissible error",
        "conditionalPass": "Conformity with the maximum permissible error is not decided",
        "conditionalFail": "Conformity with the maximum permissible error is not decided",
        "fail": "The indicated force does not conform with the maximum permissible error",
    }[certificate.outcome]
    told = ", ".join(f"{count} {plain.get(word, _OUTCOMES[word])}" for word, count in counts.items() if count)
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
    reduced = certificate.reduced
    remarks += [f"{reason[:1].upper()}{reason[1:]}." for reason in reduced[:_MOST_REDUCED]]
    if len(reduced) > _MOST_REDUCED:
        remarks.append(f"{len(reduced) - _MOST_REDUCED} more limitations stand in the calibration file.")
    remarks.append("The sensor was not adjusted: the calibration file converts its readings to forces.")
    return remarks


def describe_use(certificate: Certificate) -> str:
    """Return what U in use has beyond that of the day of calibration."""
    until = "" if certificate.valid_until is None else f", until {certificate.valid_until}"
    names = {component.name for force in certificate.forces_in_use for component in force.components}
    parts = [f"a drift of the readings' gains over {IN_USE_YEARS:g} year"] if GAIN_DRIFT in names else []
    parts += ["the temperatures named above"] if "temperature" in names else []
    with_more = f"with {' and '.join(parts)}" if parts else "of which no further input is stated"
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
        at = f"at {worst.reference_N:.3g} N, {_place(worst.place_mm)} mm"
        parts[-1] += f": largest error {errors[worst]:+.3g} N {at}".replace("-", "−")
    if silent := len(outside) - len(errors):
        parts.append(f"of {silent} of these the calibration tells no force")
    for why, count in Counter(load.why for load in left_out if load.why).items():
        parts.append(f"of {count} there is no error: {why}")
    return f"{'; '.join(parts)}."


def _compare_with_random_numbers(certificate: Certificate) -> Iterator[str]:
    """Yield how far intervals by random numbers reach beyond U, and why the law of propagation may not do."""
    checked = (load.expanded for load in certificate.checked)
    forces = chain(certificate.forces, certificate.forces_in_use, checked)
    compared: list[tuple[float, MonteCarlo]] = [
        (force.U_N, force.monte_carlo) for force in forces if force.monte_carlo is not None
    ]
    if compared:
        reasons = Counter(simulated.why for _, simulated in compared)
        largest = max(simulated.half_width / U_N for U_N, simulated in compared)
        yield (
            f"U was compared with random numbers (JCGM 101:2008) where"
            f" {'; where '.join(f'{why} ({count} of U)' for why, count in reasons.items())}:"
            f" half their interval of 95 % is at most {largest:.2f} U."
        )


def _standards(certificate: Certificate) -> Iterator[tuple[str, str]]:
    stated = {standard.role: standard for standard in certificate.standards}
    for role in StandardRole:
        standard = stated.pop(str(role), None)
        yield str(role).replace("_", " "), NOT_STATED if standard is None else standard.all_words()


def _count_long_texts(certificate: Certificate) -> int:
    """Return the characters of texts on the first side that may be long."""
    identity, settings, customer = certificate.identity, certificate.settings, certificate.customer
    texts = [text for _, text in _standards(certificate)]
    texts += [f"{one.role}: {one.model}, serial number {one.serial}; " for one in identity.instruments]
    texts += [str(part) for part in identity.parts]
    texts += [settings.laboratory, settings.street, settings.place, customer.name, customer.address]
    texts += [] if certificate.replaced is None else [describe_replaced(certificate.replaced)]
    return sum(map(len, texts))


def _row(forces: Sequence[ExpandedForce]) -> list[ExpandedForce]:
    """Return the forces of the first place: all places have the same."""
    return [force for force in forces if force.place_mm == forces[0].place_mm]


def _places(certificate: Certificate) -> Iterator[tuple[str, list[str]]]:
    """Yield place, and of each of its forces U, k and degrees of freedom on the day, and U and k in use."""
    both = zip(certificate.forces, certificate.forces_in_use, strict=True)
    for place_mm, group in groupby(both, key=lambda pair: pair[0].place_mm):
        cells: list[str] = []
        for day, use in group:
            U_day, U_use = (format_with_uncertainty(one.force_N, one.U_N)[1] for one in (day, use))
            cells += [U_day, f"{day.k:.2f}", format_dof(day.dof), U_use, f"{use.k:.2f}"]
        yield _place(place_mm), cells


def _place(place_mm: tuple[float, float]) -> str:
    return "({:.1f}, {:.1f})".format(*place_mm).replace("-", "−")


def _load(load: CheckedLoad) -> tuple[str, ...]:
    error, expanded = format_with_uncertainty(load.error_N, load.expanded.U_N)
    reference, _ = format_with_uncertainty(load.reference_N, load.expanded.U_N)
    indicated, _ = format_with_uncertainty(load.indicated_N, load.expanded.U_N)
    limit = "" if load.max_error_N is None else format_with_uncertainty(load.max_error_N, load.expanded.U_N)[0]
    place = _place(load.expanded.place_mm)
    k = f"{load.expanded.k:.2f}"
    return place, reference, indicated, error, expanded, k, limit, _DECISIONS[load.outcome]
