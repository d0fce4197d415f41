"""The page of a calibration certificate: two sides of A4 in one self-contained HTML file."""

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import groupby
from typing import Final

from jinja2 import Template
from markupsafe import Markup

from cbsr_qa.domain.plan.standards import StandardRole
from cbsr_qa.domain.results.certificate import NOT_MEASURED, NOT_STATED, Certificate, CheckedLoad
from cbsr_qa.domain.results.expanded_force import ExpandedForce, list_missing
from cbsr_qa.report.certificate_texts import (
    ABOUT_ERRORS,
    ABOUT_UNCERTAINTIES,
    ITEM,
    PROCEDURE,
    SCOPE,
    describe_checked,
    describe_day,
    describe_place,
    describe_replaced,
    describe_results,
    describe_rule,
    describe_signature,
    describe_traceability,
    describe_use,
    describe_validity,
    format_value,
    list_remarks,
    name_place,
    state_conformity,
)
from cbsr_qa.report.render import make_environment, read_style
from cbsr_qa.report.tables import format_dof

#: Most checked loads in the table: more do not fit on the page. Those nearest to their limit are shown.
_MOST_LOADS: Final = 8
#: Characters of the texts of any length on the first side, above which its letters are smaller.
_MOST_TEXT: Final = 900
#: Characters of the remarks, above which the letters of the second side are smaller.
_MOST_REMARKS: Final = 500
#: The same in the table of loads.
_DECISIONS: Final = {
    "pass": "conforms",
    "conditionalPass": "within T by < U",
    "conditionalFail": "beyond T by < U",
    "fail": "does not conform",
    "": "",
}


def render_certificate(certificate: Certificate, fingerprint: str) -> str:
    """Render a certificate: the same content gives the same bytes, all text escaped.

    Parameters
    ----------
    fingerprint : of the key that signs the file beside it; empty if it is not signed.
    """
    remarks = list_remarks(certificate)
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
        about_the_day=describe_day(certificate),
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
        remarks=remarks,
        dense_results=sum(map(len, remarks)) > _MOST_REMARKS,
    )


@cache  # compiling it takes a tenth of a certificate of a batch
def _read_template() -> Template:
    return make_environment().get_template("certificate.html.j2")


@cache
def _read_style() -> Markup:
    return Markup(read_style("certificate.css"))


def format_with_uncertainty(value: float, expanded: float) -> tuple[str, str]:
    """Return a value and U: U with two significant digits, the value to the same decimal (JCGM 100, 7.2.6)."""
    last_digit = 1 - int(f"{expanded:.1e}".partition("e")[2])
    value_text, expanded_text = (f"{round(x, last_digit):z.{max(last_digit, 0)}f}" for x in (value, expanded))
    return value_text.replace("-", "−"), expanded_text


def choose_loads(checked: Sequence[CheckedLoad]) -> list[CheckedLoad]:
    """Return the loads that are listed: all, or those nearest to their limit, else of the largest errors."""
    nearest = sorted(checked, key=lambda load: (load.max_error_N or 0.0) - abs(load.error_N))[:_MOST_LOADS]
    return [load for load in checked if load in nearest]


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
    texts += [settings.laboratory, settings.street, settings.post_code, settings.city, settings.email or ""]
    texts += [settings.place, customer.name, customer.address]
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
        yield name_place(place_mm), cells


def _load(load: CheckedLoad) -> tuple[str, ...]:
    error, expanded = format_with_uncertainty(load.error_N, load.expanded.U_N)
    reference, _ = format_with_uncertainty(load.reference_N, load.expanded.U_N)
    indicated, _ = format_with_uncertainty(load.indicated_N, load.expanded.U_N)
    limit = "" if load.max_error_N is None else format_with_uncertainty(load.max_error_N, load.expanded.U_N)[0]
    place = name_place(load.expanded.place_mm)
    k = f"{load.expanded.k:.2f}"
    return place, reference, indicated, error, expanded, k, limit, _DECISIONS[load.outcome]
