"""A certificate as a digital calibration certificate (DCC 3.2.1 of PTB, values in D-SI 2.1.0), an XML document.

It says all that the page says. It holds no XML signature.
"""

from collections.abc import Iterator
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from cbsr_qa.domain.results.certificate import NOT_STATED, Certificate
from cbsr_qa.report.certificate_texts import (
    ITEM,
    SCOPE,
    describe_place,
    describe_replaced,
    describe_rule,
    describe_signature,
    describe_traceability,
    describe_validity,
    is_traceable,
    list_remarks,
    state_conformity,
)
from cbsr_qa.report.dcc_elements import DCC, LANGUAGE, SI, add_element, add_identifications, add_text, add_word
from cbsr_qa.report.dcc_results import add_results

_VERSION: Final = "3.2.1"


def render_dcc(certificate: Certificate, fingerprint: str) -> bytes:
    """Render a certificate as XML, UTF-8; numbers with all their digits.

    Parameters
    ----------
    fingerprint : of the key that signs the file beside it; empty if it is not signed.
    """
    ElementTree.register_namespace("dcc", DCC)
    ElementTree.register_namespace("si", SI)
    root = Element(f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": _VERSION})
    _add_administration(add_element(root, "administrativeData"), certificate, fingerprint)
    add_results(add_element(add_element(root, "measurementResults"), "measurementResult"), certificate)
    ElementTree.indent(root)
    document: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return document + b"\n"


def _add_administration(data: Element, certificate: Certificate, fingerprint: str) -> None:
    software = add_element(add_element(data, "dccSoftware"), "software")
    name, version = certificate.identity.software[0]
    add_text(software, "name", name)
    add_element(software, "release", version)
    _add_core(add_element(data, "coreData"), certificate)
    _add_item(add_element(data, "items"), certificate)
    settings = certificate.settings
    contact = add_element(add_element(data, "calibrationLaboratory"), "contact")
    add_text(contact, "name", settings.laboratory)
    if settings.email:
        add_element(contact, "eMail", settings.email)
    location = add_element(contact, "location")
    for part, text in (("street", settings.street), ("postCode", settings.post_code), ("city", settings.city)):
        add_element(location, part, text)
    add_element(location, "countryCode", settings.country)
    person = add_element(add_element(data, "respPersons"), "respPerson")
    add_text(add_element(person, "person"), "name", settings.signatory)
    add_element(person, "role", settings.function)
    add_element(person, "mainSigner", "true")
    customer = add_element(data, "customer")
    add_text(customer, "name", certificate.customer.name or NOT_STATED)
    add_text(add_element(customer, "location"), "further", certificate.customer.address or NOT_STATED)
    _add_statements(add_element(data, "statements"), certificate, fingerprint)


def _add_core(core: Element, certificate: Certificate) -> None:
    add_element(core, "countryCodeISO3166_1", certificate.settings.country)
    add_element(core, "usedLangCodeISO639_1", LANGUAGE)
    add_element(core, "mandatoryLangCodeISO639_1", LANGUAGE)
    add_element(core, "uniqueIdentifier", certificate.number)
    run, digest = certificate.identity.run, certificate.calibration_digest
    named = [("run", run), ("calibration", certificate.calibration), ("SHA-256 of the calibration", digest)]
    add_identifications(core, "calibrationLaboratory", named)
    add_element(core, "beginPerformanceDate", certificate.performed[0].isoformat())
    add_element(core, "endPerformanceDate", certificate.performed[1].isoformat())
    add_element(core, "performanceLocation", certificate.settings.performed_at)
    add_element(core, "issueDate", certificate.issued_at.date().isoformat())
    if certificate.replaced is not None:
        change = add_element(core, "reportAmendedSubstituted")
        add_element(change, "typeOfChange", "substituted")
        add_element(change, "replacedUniqueIdentifier", certificate.replaced.number)
        previous = add_element(core, "previousReport")
        add_text(previous, "referral", "the certificate that this one replaces, as XML")
        add_element(previous, "referralID", certificate.replaced.number)
        add_element(previous, "procedure", "SHA-256")
        add_element(previous, "value", certificate.replaced.dcc_sha256)


def _add_item(items: Element, certificate: Certificate) -> None:
    """Add the sensor; nothing states who gave it its numbers."""
    identity = certificate.identity
    item = add_element(items, "item")
    add_text(item, "name", ITEM)
    unstated = [name for name, stated in (("batch", identity.sensor.batch), ("parts", identity.parts)) if not stated]
    add_text(item, "description", "; ".join([certificate.sensor, *(f"{name} {NOT_STATED}" for name in unstated)]))
    add_element(item, "model", identity.sensor.sensor_type)
    named = [("serial number", identity.sensor.serial)]
    named += [("batch", identity.sensor.batch)] if identity.sensor.batch else []
    add_identifications(item, "other", [*named, *((part.name, str(part)) for part in identity.parts)])


def _add_statements(statements: Element, certificate: Certificate, fingerprint: str) -> None:
    """Add what was simulated, also as a word for machines, and every other sentence of the page."""
    simulation, *remarks = list_remarks(certificate)
    data = add_element(_add_statement(statements, "simulation", simulation), "data")
    add_word(data, "simulated", "true" if certificate.identity.simulated else "false")
    for remark in remarks:
        _add_statement(statements, "remark", remark)
    for name, text in _list_facts(certificate):
        _add_statement(statements, name, text)
    validity = _add_statement(statements, "validity", describe_validity(certificate))
    if certificate.valid_until is not None:
        add_element(validity, "date", certificate.valid_until.isoformat())
    traceability = add_element(statements, "statement")
    add_text(traceability, "name", "traceability")
    add_element(traceability, "traceable", "true" if is_traceable(certificate) else "false")
    add_text(traceability, "declaration", describe_traceability(certificate))
    conformity = add_element(statements, "statement")
    add_text(conformity, "name", "conformity")
    if rule := describe_rule(certificate):
        add_element(conformity, "norm", "JCGM 106:2012")
        add_text(conformity, "declaration", f"{rule} {state_conformity(certificate)}")
    else:
        add_text(conformity, "declaration", state_conformity(certificate))
    if certificate.outcome:
        add_element(conformity, "conformity", certificate.outcome)
    _add_statement(statements, "scope", SCOPE)
    _add_statement(statements, "authorisation", describe_signature(fingerprint))


def _list_facts(certificate: Certificate) -> Iterator[tuple[str, str]]:
    """Yield name and text of what the page states in its tables, and no element of the DCC is for."""
    yield "condition", certificate.condition
    yield "place of calibration", describe_place(certificate)
    yield "station", certificate.identity.station
    yield "operator", certificate.identity.operator or NOT_STATED
    if certificate.replaced is not None:
        yield "replacement", describe_replaced(certificate.replaced)


def _add_statement(statements: Element, name: str, text: str) -> Element:
    statement = add_element(statements, "statement")
    add_text(statement, "name", name)
    add_text(statement, "declaration", text)
    return statement
